//! Annotations: what people, or programs in their place, say about a map. Recorded like anything else. Those on images have
//! the same messages, and are rows of [`image_annotations`](crate::roles::image_annotations).

use crate::roles::{Fields, FromMessage, Message, Messages, Role};
use crate::{Pose, Stamp, record};

record! {
    /// The vehicle pose that a label is tied to. It was chosen when the label was said, and stays.
    pub struct Anchor {
        /// Session that was driven.
        session: String,
        /// Instant of the vehicle pose.
        stamp: Stamp ["ns"],
        /// Camera that sees the label from there; null where none does.
        camera: Option<String>,
        /// The label's frame in the vehicle's.
        vehicle_from_label: Pose ["", "vehicle"],
    }
}

record! {
    /// One act of annotation: a label was drawn, accepted, rejected, moved or removed.
    #[layer("annotations", key(site, session, stamp, author, sequence, id))]
    pub struct Annotation {
        /// Site that the session belongs to.
        site: String,
        /// Session that it was recorded in: the name of the log.
        session: String,
        /// When it was said.
        stamp: Stamp ["ns"],
        /// Who said it.
        author: String,
        /// Order of what an author said at one instant.
        sequence: u64,
        /// The label that it is about; unique within the site.
        id: String,
        /// What the label marks: `parking_space`, `crossing`, any word.
        kind: String,
        /// `drawn`, `accepted`, `rejected`, `moved` or `removed`.
        act: String,
        /// The version of the map that was looked at; null where none was.
        map_version: Option<u64>,
        /// `box`, `polygon` or `polyline`; null where the act gives no geometry.
        shape: Option<String>,
        /// Corners of a box (counter-clockwise from front left, centred on the label's frame, whose x axis lies along its
        /// length), of a polygon (each once), or points of a polyline; empty where the act gives no geometry.
        points: Vec<[f64; 3]> ["m", "label"],
        /// The label's frame in the map that was looked at; null where the act gives no geometry.
        map_from_label: Option<Pose> ["", "map"],
        /// The vehicle pose that the label is tied to; null where none was chosen yet.
        anchor: Option<Anchor>,
    }
}

/// Topics with annotations.
pub const ROLE: Role = Role::of::<Annotation>(Messages {
    shared: true,
    ..Messages::of::<Annotation>(MESSAGES)
});

/// Messages of annotations, in the map and on images.
pub(super) const MESSAGES: &[&str] = &["evermap.Annotation"];

/// What may be said of a label.
pub const ACTS: [&str; 5] = ["drawn", "accepted", "rejected", "moved", "removed"];

/// The shapes of labels, with the least number of points that each needs.
pub const SHAPES: [(&str, usize); 3] = [("box", 4), ("polygon", 3), ("polyline", 2)];

impl FromMessage for Annotation {
    const MEMBERS: &'static [&'static str] = &[
        "timestamp",
        "id",
        "kind",
        "act",
        "author",
        "sequence",
        "map_version",
        "shape",
        "points",
        "map_from_label",
        "anchor",
        "image",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let fields = &message.fields;
        if is_on_image(fields) {
            return Ok(Vec::new());
        }
        let text = |name: &str| text(fields, name);
        let act = one_of("act", &ACTS, text("act")?)?;
        let (shape, points, map_from_label) = match fields.text(&["shape"]) {
            Some(shape) => geometry(fields, shape)?,
            None if ["drawn", "moved"].contains(&act.as_str()) => {
                return Err(format!("expected a geometry of a label that was {act}"));
            }
            None => (None, Vec::new(), None),
        };
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp()?,
            author: text("author")?,
            sequence: fields.number(&["sequence"]).unwrap_or(0.0) as u64,
            id: text("id")?,
            kind: text("kind")?,
            act,
            map_version: fields.number(&["map_version"]).map(|number| number as u64),
            shape,
            points,
            map_from_label,
            anchor: anchor(fields)?,
        }])
    }
}

/// Whether it is an annotation of the pixels of an image.
pub(super) fn is_on_image(fields: &Fields<'_>) -> bool {
    fields.text(&["image", "session"]).is_some()
}

/// Whether a text may say what a label is called, what it marks, or who says so: lines and other control characters have no
/// place in files of other programs.
pub fn is_word(text: &str) -> bool {
    !text.is_empty() && !text.contains(char::is_control)
}

/// A text that is a word.
pub(super) fn text(fields: &Fields<'_>, name: &str) -> Result<String, String> {
    let found = fields.text(&[name]).filter(|text| !text.is_empty());
    let found = found.ok_or_else(|| format!("expected text in {name}"))?;
    match is_word(&found) {
        true => Ok(found),
        false => Err(format!(
            "expected text without control characters in {name}"
        )),
    }
}

/// The word, if it is one of these.
pub(super) fn one_of(what: &str, words: &[&str], found: String) -> Result<String, String> {
    match words.contains(&found.as_str()) {
        true => Ok(found),
        false => Err(format!(
            "expected one of {} in {what}, found {found}",
            words.join(", ")
        )),
    }
}

/// Shape, points and place of a label.
type Geometry = (Option<String>, Vec<[f64; 3]>, Option<Pose>);

fn geometry(fields: &Fields<'_>, shape: String) -> Result<Geometry, String> {
    let shape = one_of("shape", &SHAPES.map(|(name, _)| name), shape)?;
    let least = SHAPES.iter().find(|(name, _)| *name == shape);
    let least = least.map_or(0, |(_, least)| *least);
    let points = points(fields)?;
    let fits = points.len() >= least && (shape != "box" || points.len() == least);
    if !fits {
        return Err(format!(
            "expected {least} points of a {shape}, found {}",
            points.len()
        ));
    }
    let map_from_label = pose(fields, &["map_from_label"])?;
    Ok((Some(shape), points, Some(map_from_label)))
}

pub(super) fn points(fields: &Fields<'_>) -> Result<Vec<[f64; 3]>, String> {
    let Some(list) = fields.list("points") else {
        return Ok(Vec::new());
    };
    let point = |point: Fields<'_>| {
        let [x, y, z] = ["x", "y", "z"].map(|axis| point.number(&[axis]).unwrap_or(f64::NAN));
        let found = [x, y, z];
        let finite = found.iter().all(|number| number.is_finite());
        finite
            .then_some(found)
            .ok_or_else(|| "expected finite points".to_owned())
    };
    Fields::all(&list).map(point).collect()
}

fn pose(fields: &Fields<'_>, path: &[&str]) -> Result<Pose, String> {
    let position = [path, &["position"]].concat();
    let orientation = [path, &["orientation"]].concat();
    fields.pose(&position, &orientation)
}

/// The anchor, where the message has one.
fn anchor(fields: &Fields<'_>) -> Result<Option<Anchor>, String> {
    let Some(session) = fields.text(&["anchor", "session"]) else {
        return Ok(None);
    };
    Ok(Some(Anchor {
        session,
        stamp: fields.stamp_of(&["anchor", "stamp"])?,
        camera: fields.text(&["anchor", "camera"]),
        vehicle_from_label: pose(fields, &["anchor", "vehicle_from_label"])?,
    }))
}
