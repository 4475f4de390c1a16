//! From features to acts: only what is new is said.

use evermap_algorithms::labels::shapes::Outline;
use evermap_datasets::annotations::{Anchor, Annotation, Geometry};
use evermap_engine::digest::digest_of;
use evermap_schemas::layers::PlacedLabel;
use evermap_schemas::{Fault, Pose, Stamp, roles};
use nalgebra::Vector3;

use super::Losses;
use super::features::Feature;
use super::state::{State, without_poses};

/// A label has moved where a point of it has by more than this, m.
const MOVED_M: f64 = 1e-3;

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
pub struct Said {
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
    features: &[Feature],
    state: &State,
    speaker: &Speaker,
    losses: &mut Losses,
) -> Result<Said, Fault> {
    if !state.has_poses {
        return Err(without_poses());
    }
    let mut said = Said::default();
    let mut names = std::collections::BTreeSet::new();
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
    feature: &Feature,
    state: &State,
    speaker: &Speaker,
    losses: &mut Losses,
) -> Result<Result<Vec<Annotation>, &'static str>, Fault> {
    let ground = |at| state.holds.ground(at);
    let outline = match feature.geometry.as_ref().map(|drawn| drawn.outline(ground)) {
        Some(Ok(outline)) => Some(outline),
        Some(Err(reason)) => return Ok(Err(reason)),
        None => None,
    };
    let named = match (&feature.label, &outline) {
        (Some(label), _) => Some(label.clone()),
        (None, Some((shape, outline))) => Some(name(shape, outline)?),
        (None, None) => None,
    };
    let Some(label) = named else {
        return Ok(Err("feature that neither names a label nor has a geometry"));
    };
    let known = state.labels.get(&label);
    let kind = match kind(feature, state, speaker) {
        Ok(kind) => kind.or(known.map(|known| &known.kind)),
        Err(reason) => return Ok(Err(reason)),
    };
    let Some(kind) = kind else {
        return Ok(Err("feature without a kind"));
    };
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
    let mut placed = |(shape, outline): &(&'static str, Outline)| {
        let place = held(shape, outline, state);
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
        (Some(known), Some(outline)) if standing == Some("drawn") && known.standing != "drawn" => {
            vec![act("drawn", Some(placed(outline)))]
        }
        (Some(known), outline) => {
            let same = |outline: &&_| known.kind == *kind && !differs(known, outline);
            let anew = outline.as_ref().filter(|outline| !same(outline));
            let mut acts = Vec::new();
            acts.extend(anew.map(|outline| act("moved", Some(placed(outline)))));
            let judged = standing.filter(|word| *word != "drawn" && *word != known.standing);
            acts.extend(judged.map(|word| act(word, None)));
            acts
        }
    }))
}

/// What a feature marks. Its own kind goes first, and so does a category that is a kind of the map; what other categories
/// mean, the speaker may say.
///
/// # Errors
/// In words, for a feature of another kind than the speaker's: it is not renamed.
fn kind<'a>(
    feature: &'a Feature,
    state: &State,
    speaker: &'a Speaker,
) -> Result<Option<&'a String>, &'static str> {
    let category = feature.category.as_ref();
    let own = feature.kind.as_ref();
    let own = own.or(category.filter(|category| state.has_kind(category)));
    match (own, &speaker.kind) {
        (Some(own), Some(kind)) if own != kind => Err("feature of another kind than --kind"),
        (Some(own), _) => Ok(Some(own)),
        (None, Some(kind)) => Ok(Some(kind)),
        (None, None) => Ok(category),
    }
}

const STANDINGS: [&str; 4] = ["drawn", "accepted", "rejected", "removed"];

/// A name made of what was drawn, so that the same file says the same labels again.
fn name(shape: &str, outline: &Outline) -> Result<String, Fault> {
    let whole = (shape, &outline.points, outline.map_from_label.to_array());
    Ok(digest_of(&whole)?.chars().take(16).collect())
}

/// The geometry of an outline, and the pose that it is tied to.
fn held(shape: &str, outline: &Outline, state: &State) -> (Geometry, Option<Anchor>) {
    let map_from_label = outline.map_from_label.to_array();
    let anchor = state.holds.anchor(&Pose::from_array(map_from_label));
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

/// Whether an outline is not the label's, seen from above. Of a box, corners may be written in any order.
fn differs(known: &PlacedLabel, (shape, outline): &(&'static str, Outline)) -> bool {
    let drawn: Vec<[f64; 3]> = outline
        .points
        .iter()
        .map(|point| {
            let point = outline.map_from_label.transform(&Vector3::from(*point));
            point.into()
        })
        .collect();
    let near = |a: &[f64; 3], b: &[f64; 3]| (a[0] - b[0]).hypot(a[1] - b[1]) <= MOVED_M;
    let in_order = || drawn.iter().zip(&known.points).all(|(a, b)| near(a, b));
    let in_any = || {
        drawn
            .iter()
            .all(|a| known.points.iter().any(|b| near(a, b)))
    };
    let same = match *shape {
        "box" => in_any(),
        _ => in_order(),
    };
    known.shape != *shape || known.points.len() != drawn.len() || !same
}
