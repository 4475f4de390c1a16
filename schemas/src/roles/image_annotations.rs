//! Annotations on images: what people say the pixels of an image are.

use crate::roles::annotations::{MESSAGES, is_on_image, one_of, points, text};
use crate::roles::{FromMessage, Message, Messages, Role};
use crate::{Stamp, record};

record! {
    /// One act on an image: pixels were given a class, or no longer are.
    #[layer("image_annotations", key(site, session, stamp, author, sequence, id))]
    pub struct ImageAnnotation {
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
        /// What the pixels are: `road`, `tree`, any word.
        class: String,
        /// `drawn` or `removed`.
        act: String,
        /// The version of the map that was looked at; null where none was.
        map_version: Option<u64>,
        /// Session of the image.
        image_session: String,
        /// Exposure instant of the image.
        image_stamp: Stamp ["ns"],
        /// Camera that took the image.
        image_camera: String,
        /// `polygon` or `polyline`; null where the label is removed.
        shape: Option<String>,
        /// Corners of a polygon, each once, or points of a polyline: column and row from the upper left corner; empty where
        /// the label is removed.
        points: Vec<[f64; 2]> ["px"],
        /// Diameter of the brush that follows a polyline; null for others.
        brush_px: Option<f64> ["px"],
    }
}

/// Topics with annotations, as far as they are of images.
pub const ROLE: Role = Role::of::<ImageAnnotation>(Messages {
    shared: true,
    ..Messages::of::<ImageAnnotation>(MESSAGES)
});

/// What may be said of pixels.
pub const ACTS: [&str; 2] = ["drawn", "removed"];

/// The shapes that pixels are drawn in.
pub const SHAPES: [&str; 2] = ["polygon", "polyline"];

impl FromMessage for ImageAnnotation {
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
        "image",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let fields = &message.fields;
        if !is_on_image(fields) {
            return Ok(Vec::new());
        }
        let act = one_of("act", &ACTS, text(fields, "act")?)?;
        let is_drawn = act == "drawn";
        let shape = match is_drawn {
            true => Some(one_of("shape", &SHAPES, text(fields, "shape")?)?),
            false => None,
        };
        let points = match is_drawn {
            true => points(fields)?.iter().map(|[x, y, _]| [*x, *y]).collect(),
            false => Vec::new(),
        };
        let brush_px = fields.number(&["image", "brush_px"]);
        let is_line = shape.as_deref() == Some("polyline");
        if is_line && !brush_px.is_some_and(f64::is_finite) {
            return Err("expected image.brush_px of a polyline".to_owned());
        }
        let camera = fields.text(&["image", "camera"]);
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp()?,
            author: text(fields, "author")?,
            sequence: fields.number(&["sequence"]).unwrap_or(0.0) as u64,
            id: text(fields, "id")?,
            class: text(fields, "kind")?,
            act,
            map_version: fields.number(&["map_version"]).map(|number| number as u64),
            image_session: fields.text(&["image", "session"]).unwrap_or_default(),
            image_stamp: fields.stamp_of(&["image", "stamp"])?,
            image_camera: camera.ok_or("expected text in image.camera")?,
            shape,
            points,
            brush_px: brush_px.filter(|_| is_line),
        }])
    }
}
