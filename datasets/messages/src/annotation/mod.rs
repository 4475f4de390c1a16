//! What people say about a map, as JSON that describes itself: any MCAP reader shows it.

use serde_json::{Map, Value, json};

use crate::ros2::Pose;

/// Name of the messages' schema.
pub const NAME: &str = "evermap.Annotation";
/// Their JSON Schema, which says what each member means.
pub const SCHEMA: &str = include_str!("Annotation.json");

/// One act of annotation.
#[derive(Debug, Clone, PartialEq)]
pub struct Annotation {
    /// When it was said, ns since the epoch.
    pub stamp_ns: u64,
    /// Who said it.
    pub author: String,
    /// Order of what an author said at one instant.
    pub sequence: u64,
    /// The label that it is about.
    pub id: String,
    /// What the label marks.
    pub kind: String,
    /// `drawn`, `accepted`, `rejected`, `moved` or `removed`.
    pub act: String,
    /// The version of the map that was looked at.
    pub map_version: Option<u64>,
    /// The label's geometry, which acts other than `drawn` and `moved` need not give.
    pub geometry: Option<Geometry>,
    /// The vehicle pose that the label is tied to.
    pub anchor: Option<Anchor>,
    /// The image that it is on; one in the map has none.
    pub image: Option<OnImage>,
}

/// Where a label is, and its outline.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// `box`, `polygon` or `polyline`.
    pub shape: String,
    /// Points in the label's frame, m.
    pub points: Vec<[f64; 3]>,
    /// The label's frame in the map.
    pub map_from_label: Pose,
}

/// The vehicle pose that a label is tied to.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    /// Session that was driven.
    pub session: String,
    /// Instant of the pose, ns since the epoch.
    pub stamp_ns: u64,
    /// Camera that sees the label from there.
    pub camera: Option<String>,
    /// The label's frame in the vehicle's.
    pub vehicle_from_label: Pose,
}

/// The image whose pixels a label is of, and which pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct OnImage {
    /// Session that was driven.
    pub session: String,
    /// Exposure instant, ns since the epoch.
    pub stamp_ns: u64,
    /// Camera that took it.
    pub camera: String,
    /// What was drawn; `None` where the label is removed.
    pub drawn: Option<DrawnPixels>,
}

/// Pixels that were drawn on.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnPixels {
    /// `polygon` or `polyline`.
    pub shape: String,
    /// Columns and rows from the upper left corner, px.
    pub points: Vec<[f64; 2]>,
    /// Diameter of the brush, of a polyline.
    pub brush_px: Option<f64>,
}

impl Annotation {
    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut message = Map::new();
        let mut set = |name: &str, value: Value| message.insert(name.to_owned(), value);
        set("timestamp", time(self.stamp_ns));
        set("author", self.author.as_str().into());
        set("sequence", self.sequence.into());
        set("id", self.id.as_str().into());
        set("kind", self.kind.as_str().into());
        set("act", self.act.as_str().into());
        if let Some(version) = self.map_version {
            set("map_version", version.into());
        }
        if let Some(geometry) = &self.geometry {
            set("shape", geometry.shape.as_str().into());
            set("points", geometry.points.iter().map(point).collect());
            set("map_from_label", pose(&geometry.map_from_label));
        }
        if let Some(anchor) = &self.anchor {
            set("anchor", anchor.json());
        }
        if let Some(image) = &self.image {
            set("image", image.json());
        }
        if let Some(drawn) = self.image.as_ref().and_then(|image| image.drawn.as_ref()) {
            set("shape", drawn.shape.as_str().into());
            let points = drawn.points.iter().map(|[x, y]| point(&[*x, *y, 0.0]));
            set("points", points.collect());
        }
        Value::Object(message).to_string().into_bytes()
    }
}

impl Anchor {
    fn json(&self) -> Value {
        let mut value = json!({
            "session": self.session,
            "stamp": time(self.stamp_ns),
            "vehicle_from_label": pose(&self.vehicle_from_label),
        });
        if let Some(camera) = &self.camera {
            value["camera"] = camera.as_str().into();
        }
        value
    }
}

impl OnImage {
    fn json(&self) -> Value {
        let mut value = json!({
            "session": self.session,
            "stamp": time(self.stamp_ns),
            "camera": self.camera,
        });
        if let Some(brush_px) = self.drawn.as_ref().and_then(|drawn| drawn.brush_px) {
            value["brush_px"] = brush_px.into();
        }
        value
    }
}

fn time(stamp_ns: u64) -> Value {
    json!({ "sec": stamp_ns / 1_000_000_000, "nsec": stamp_ns % 1_000_000_000 })
}

fn point([x, y, z]: &[f64; 3]) -> Value {
    json!({ "x": x, "y": y, "z": z })
}

fn pose([x, y, z, qx, qy, qz, qw]: &Pose) -> Value {
    json!({ "position": point(&[*x, *y, *z]), "orientation": { "x": qx, "y": qy, "z": qz, "w": qw } })
}
