//! From features to acts: only what is new is said.

use std::collections::BTreeSet;

use evermap_algorithms::geometry::pose;
use evermap_algorithms::labels::shapes::Outline;
use evermap_catalog::painted::ImageKey;
use evermap_datasets::annotations::{Anchor, Annotation, Geometry};
use evermap_engine::digest::digest_of;
use evermap_schemas::layers::PlacedLabel;
use evermap_schemas::roles::annotations::is_word;
use evermap_schemas::{Fault, Pose, Stamp, roles};
use nalgebra::Vector3;

use super::Losses;
use super::features::DrawnFeature;
use super::known::KnownLabels;
use super::state::{State, image_of, without_poses};

/// A label that was not drawn on a picture has moved where a point of it has by more than this, m.
const MOVED_M: f64 = 1e-3;
/// No image shows well enough what lies farther from the vehicle that took it, m.
const SEEN_M: f64 = 200.0;

/// Who says, and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Speaker {
    /// Who.
    pub author: String,
    /// When, ns since the epoch.
    pub stamp_ns: u64,
    /// What features mark that do not say so themselves in evermap's words; others must agree.
    pub kind: Option<String>,
}

/// What was said, in order, and how many labels are as they were.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AnnotationBatch {
    /// The acts.
    pub acts: Vec<Annotation>,
    /// Features of labels that are just so already.
    pub unchanged: usize,
}

/// The acts that make the labels of a state as these features have them. Labels that no feature names stay. What makes no
/// sense is noted and left out; a label out of reach of the map is noted and said.
///
/// # Errors
/// A user fault for a map without poses, a bug fault.
pub fn said(
    features: &[DrawnFeature],
    state: &State,
    speaker: &Speaker,
    losses: &mut Losses,
) -> Result<AnnotationBatch, Fault> {
    if !state.has_poses {
        return Err(without_poses());
    }
    let mut said = AnnotationBatch::default();
    let mut names = BTreeSet::new();
    for feature in features {
        match acts(feature, state, speaker, losses)? {
            Ok(acts) if acts.is_empty() => said.unchanged += 1,
            Ok(acts) if names.insert(acts[0].id.clone()) => said.acts.extend(acts),
            Ok(_) => losses.note("feature of a label that the file has twice", &feature.place),
            Err(reason) => losses.note(reason, &feature.place),
        }
    }
    for (sequence, act) in (0..).zip(&mut said.acts) {
        act.sequence = sequence;
    }
    Ok(said)
}

/// What a feature says; nothing where all is so already.
fn acts(
    feature: &DrawnFeature,
    state: &State,
    speaker: &Speaker,
    losses: &mut Losses,
) -> Result<Result<Vec<Annotation>, &'static str>, Fault> {
    let read =
        drawn(feature, state).and_then(|outline| Ok((outline, kind(feature, state, speaker)?)));
    let (outline, kind) = match read {
        Ok(read) => read,
        Err(reason) => return Ok(Err(reason)),
    };
    let image = feature.image.as_ref();
    let Some(label) = label_of(feature, outline.as_ref(), kind, &state.labels)? else {
        return Ok(Err("feature that neither names a label nor has a geometry"));
    };
    let known = state.labels.get(&label);
    // What a label is tied to already, it stays tied to.
    let is_tied = known.is_some_and(|known| is_shown_by(known, image));
    if image.is_some_and(|image| !is_tied && !state.may_have(image)) {
        return Ok(Err(
            "feature of an image that the map does not have: no such camera, or none then",
        ));
    }
    let Some(kind) = kind.or(known.map(|known| &known.kind)) else {
        return Ok(Err("feature without a kind"));
    };
    if !is_word(kind) || !is_word(&label) {
        return Ok(Err(
            "feature of a kind, or a label, whose name has a control character",
        ));
    }
    let standing = feature.standing.as_deref();
    if standing.is_some_and(|word| !STANDINGS.contains(&word)) {
        return Ok(Err("feature of an unknown standing"));
    }
    let act = |act: &str, place: Option<(Geometry, Option<Anchor>)>| {
        let (geometry, anchor) = place.unzip();
        Annotation {
            stamp_ns: speaker.stamp_ns,
            author: speaker.author.clone(),
            sequence: 0,
            id: label.clone(),
            kind: kind.clone(),
            act: act.to_owned(),
            map_version: Some(state.version),
            geometry,
            anchor: anchor.flatten(),
            image: None,
        }
    };
    let mut placed = |(shape, outline): &(&str, Outline)| {
        let place = held(shape, outline, image, state);
        if place.1.is_none() {
            losses.note("label too far from every vehicle pose", &feature.place);
        }
        place
    };
    Ok(Ok(match (known, &outline) {
        (None, _) if standing == Some("removed") => return Ok(Err("label that is not there")),
        (None, None) => return Ok(Err("label that is not there")),
        (None, Some(outline)) => vec![act(standing.unwrap_or("drawn"), Some(placed(outline)))],
        (Some(_), _) if standing == Some("removed") => vec![act("removed", None)],
        (Some(known), None) if known.kind != *kind => {
            return Ok(Err("feature that changes a kind and has no geometry"));
        }
        (Some(known), outline) if standing == Some("drawn") && known.standing != "drawn" => {
            let place = match outline {
                Some(outline) => placed(outline),
                None => placed(&outline_of(known)?),
            };
            vec![act("drawn", Some(place))]
        }
        (Some(known), outline) => {
            let same = |outline: &&_| {
                let is_there = !differs(known, outline, within_m(feature));
                known.kind == *kind && is_there && is_shown_by(known, image)
            };
            let anew = outline.as_ref().filter(|outline| !same(outline));
            let mut acts = Vec::new();
            acts.extend(anew.map(|outline| act("moved", Some(placed(outline)))));
            let judged = standing.filter(|word| *word != "drawn" && *word != known.standing);
            acts.extend(judged.map(|word| act(word, None)));
            acts
        }
    }))
}

/// The outline that a feature draws; `None` where it draws none.
///
/// # Errors
/// In words, for what is no outline, lies where nothing of the map is, or is shown by no image of it. What is removed may lie
/// anywhere.
fn drawn(
    feature: &DrawnFeature,
    state: &State,
) -> Result<Option<(&'static str, Outline)>, &'static str> {
    let ground = |at| state.holds.ground(at);
    let found = feature.geometry.as_ref();
    let found = found.map(|drawn| drawn.outline(ground)).transpose()?;
    let stood = feature.image.as_ref().map(|image| {
        let stood = state.map_from_vehicle(image);
        stood.ok_or("feature of an image that the map has no vehicle pose of")
    });
    let stood = stood.transpose()?;
    let is_removed = feature.standing.as_deref() == Some("removed");
    if let Some((_, outline)) = found.as_ref().filter(|_| !is_removed) {
        let points: Vec<[f64; 3]> = in_map(outline).collect();
        if state.is_far(&points) {
            return Err(
                "feature kilometres from every vehicle pose: expected metres in the map's frame; are these UTM coordinates?",
            );
        }
        let away_m =
            |stood: pose::Pose| (outline.map_from_label.translation - stood.translation).norm();
        if stood.is_some_and(|stood| away_m(stood) > SEEN_M) {
            return Err("feature of an image that was taken hundreds of metres away from it");
        }
    }
    Ok(found)
}

/// What a feature marks. Its own kind goes first, and so does a category that is a kind of the map; what other categories
/// mean, the speaker may say.
///
/// # Errors
/// In words, for a feature of another kind than the speaker's: it is not renamed.
fn kind<'a>(
    feature: &'a DrawnFeature,
    state: &State,
    speaker: &'a Speaker,
) -> Result<Option<&'a String>, &'static str> {
    let category = feature.category.as_ref();
    let own = feature.kind.as_ref();
    let own = own.or(category.filter(|category| state.labels.has_kind(category)));
    match (own, &speaker.kind) {
        (Some(own), Some(kind)) if own != kind => Err("feature of another kind than --kind"),
        (Some(own), _) => Ok(Some(own)),
        (None, Some(kind)) => Ok(Some(kind)),
        (None, None) => Ok(category),
    }
}

const STANDINGS: [&str; 4] = ["drawn", "accepted", "rejected", "removed"];

/// The label that a feature is: the one that it names; without a name the one of its kind that lies just there and was not
/// rejected, or, of an image, whatever was said of it; or a new one. A name that came through another program counts where
/// there is such a label.
fn label_of(
    feature: &DrawnFeature,
    outline: Option<&(&'static str, Outline)>,
    kind: Option<&String>,
    labels: &KnownLabels,
) -> Result<Option<String>, Fault> {
    let is_ours = |label: &&String| feature.within_m.is_none() || labels.get(label).is_some();
    if let Some(label) = feature.label.as_ref().filter(is_ours) {
        return Ok(Some(label.clone()));
    }
    let Some(drawn) = outline else {
        return Ok(None);
    };
    let own = name(drawn.0, &drawn.1, feature.image.as_ref())?;
    let there = match labels.get(&own) {
        Some(_) => None,
        None => lying_there(feature, drawn, kind, labels),
    };
    Ok(Some(there.map_or(own, |known| known.label.clone())))
}

/// The first label, by name, that is what a feature without a name draws.
fn lying_there<'l>(
    feature: &DrawnFeature,
    drawn: &(&str, Outline),
    kind: Option<&String>,
    labels: &'l KnownLabels,
) -> Option<&'l PlacedLabel> {
    let [x, y, _] = in_map(&drawn.1).next()?;
    let mut near = labels.beginning_near([x, y], within_m(feature));
    near.find(|known| lies_there(known, feature, drawn, kind))
}

/// Whether a label is what a feature without a name draws.
fn lies_there(
    known: &PlacedLabel,
    feature: &DrawnFeature,
    drawn: &(&str, Outline),
    kind: Option<&String>,
) -> bool {
    let image = feature.image.as_ref();
    (known.standing != "rejected" || image.is_some())
        && kind.is_none_or(|kind| *kind == known.kind)
        && is_shown_by(known, image)
        && !differs(known, drawn, within_m(feature))
}

/// Whether a label is tied to the image that a feature names, if it names one.
fn is_shown_by(known: &PlacedLabel, image: Option<&ImageKey>) -> bool {
    image.is_none_or(|image| image_of(known).as_ref() == Some(image))
}

/// A label is where it was as long as no point of it has moved by more than this, m.
fn within_m(feature: &DrawnFeature) -> f64 {
    feature.within_m.unwrap_or_default().max(MOVED_M)
}

/// A name made of what was drawn, and of which image, so that the same file says the same labels again.
fn name(shape: &str, outline: &Outline, image: Option<&ImageKey>) -> Result<String, Fault> {
    let whole = (shape, &outline.points, outline.map_from_label.to_array());
    let digest = match image {
        None => digest_of(&whole),
        Some(image) => digest_of(&(whole, image)),
    };
    Ok(digest?.chars().take(16).collect())
}

/// The outline of a label as it is now.
fn outline_of(known: &PlacedLabel) -> Result<(&str, Outline), Fault> {
    let map_from_label = known.map_from_label.to_array();
    let map_from_label = pose::Pose::from_array(map_from_label)
        .map_err(|error| Fault::bug(format!("label {}: {error}", known.label)))?;
    let label_from_map = map_from_label.inverse();
    let own = |point: &[f64; 3]| label_from_map.transform(&Vector3::from(*point)).into();
    let points = known.points.iter().map(own).collect();
    let outline = Outline {
        map_from_label,
        points,
    };
    Ok((&known.shape, outline))
}

/// The geometry of an outline, and the pose that it is tied to: that of its image, where it has one.
fn held(
    shape: &str,
    outline: &Outline,
    image: Option<&ImageKey>,
    state: &State,
) -> (Geometry, Option<Anchor>) {
    let map_from_label = outline.map_from_label.to_array();
    let anchor = match image {
        Some(image) => state.seen_in(image, &outline.map_from_label),
        None => state.holds.anchor(&Pose::from_array(map_from_label)),
    };
    let geometry = Geometry {
        shape: shape.to_owned(),
        points: outline.points.clone(),
        map_from_label,
    };
    (geometry, anchor.map(message))
}

fn message(anchor: roles::Anchor) -> Anchor {
    Anchor {
        session: anchor.session,
        stamp_ns: anchor.stamp.0.max(0) as u64,
        camera: anchor.camera,
        vehicle_from_label: anchor.vehicle_from_label.to_array(),
    }
}

/// An act as a run reads it from the log of a session.
pub fn read_back(act: &Annotation, site: &str, session: &str) -> roles::Annotation {
    let geometry = act.geometry.as_ref();
    let held = |anchor: &Anchor| roles::Anchor {
        session: anchor.session.clone(),
        stamp: Stamp(anchor.stamp_ns as i64),
        camera: anchor.camera.clone(),
        vehicle_from_label: Pose::from_array(anchor.vehicle_from_label),
    };
    roles::Annotation {
        site: site.to_owned(),
        session: session.to_owned(),
        stamp: Stamp(act.stamp_ns as i64),
        author: act.author.clone(),
        sequence: act.sequence,
        id: act.id.clone(),
        kind: act.kind.clone(),
        act: act.act.clone(),
        map_version: act.map_version,
        shape: geometry.map(|geometry| geometry.shape.clone()),
        points: geometry.map_or_else(Vec::new, |geometry| geometry.points.clone()),
        map_from_label: geometry.map(|geometry| Pose::from_array(geometry.map_from_label)),
        anchor: act.anchor.as_ref().map(held),
    }
}

/// Whether an outline is not the label's, seen from above: a point of it is farther away. Of a box, corners may be written in
/// any order.
fn differs(known: &PlacedLabel, (shape, outline): &(&str, Outline), within_m: f64) -> bool {
    if known.shape != *shape || known.points.len() != outline.points.len() {
        return true;
    }
    let near = |a: &[f64; 3], b: &[f64; 3]| (a[0] - b[0]).hypot(a[1] - b[1]) <= within_m;
    let mut drawn = in_map(outline);
    let same = match *shape {
        "box" => drawn.all(|a| known.points.iter().any(|b| near(&a, b))),
        _ => drawn.zip(&known.points).all(|(a, b)| near(&a, b)),
    };
    !same
}

/// The points of an outline in the map, m.
fn in_map(outline: &Outline) -> impl Iterator<Item = [f64; 3]> {
    let place = move |point: &[f64; 3]| -> [f64; 3] {
        let point = Vector3::from(*point);
        outline.map_from_label.transform(&point).into()
    };
    outline.points.iter().map(place)
}

#[cfg(test)]
mod tests;
