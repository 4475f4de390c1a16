//! Foxglove's messages, from what layers hold.

use evermap_datasets::ros2;
use evermap_schemas::{Fault, Pose as Placed};
use foxglove::messages::line_primitive::Type as LineType;
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    Color, KeyValuePair, LinePrimitive, PackedElementField, Point3, Pose, Quaternion, SceneEntity,
    Timestamp, Vector3,
};
use foxglove::{Encode, Schema};

use super::{MessageKind, Payload};

/// The frame of the map.
pub(super) const MAP: &str = "map";

/// The kind of a message of Foxglove's.
pub(super) fn kind<M: Encode>() -> Result<MessageKind, Fault> {
    let schema: Option<Schema> = M::get_schema();
    Ok(MessageKind {
        schema: schema.ok_or_else(|| Fault::bug("a message has no schema"))?,
        encoding: "protobuf",
    })
}

/// A message as bytes, with its schema.
pub(super) fn encoded<M: Encode>(message: &M) -> Result<Payload, Fault> {
    let mut bytes = Vec::with_capacity(message.encoded_len().unwrap_or_default());
    let encoded = message.encode(&mut bytes);
    encoded.map_err(|error| Fault::bug(format!("a message is not encoded: {error}")))?;
    Ok(Payload {
        kind: kind::<M>()?,
        bytes,
    })
}

/// A message of ROS 2 as bytes, with its schema.
pub(super) fn encoded_ros<M: ros2::Message>(message: &M) -> Payload {
    Payload {
        kind: MessageKind {
            schema: Schema::new(M::NAME, "ros2msg", M::DEFINITION.as_bytes()),
            encoding: "cdr",
        },
        bytes: message.encode(),
    }
}

/// An instant, ns since the epoch.
pub(super) fn time(stamp: i64) -> Option<Timestamp> {
    let nanoseconds = stamp.max(0) as u64;
    let seconds = u32::try_from(nanoseconds / 1_000_000_000).ok()?;
    Timestamp::new_checked(seconds, (nanoseconds % 1_000_000_000) as u32)
}

pub(super) fn vector(x: f64, y: f64, z: f64) -> Option<Vector3> {
    Some(Vector3 { x, y, z })
}

pub(super) fn rotation(pose: &Placed) -> Option<Quaternion> {
    Some(Quaternion {
        x: pose.qx,
        y: pose.qy,
        z: pose.qz,
        w: pose.qw,
    })
}

pub(super) fn pose(of: &Placed) -> Pose {
    Pose {
        position: vector(of.x, of.y, of.z),
        orientation: rotation(of),
    }
}

/// A place without a heading, m.
pub(super) fn place(x: f64, y: f64, z: f64) -> Pose {
    pose(&Placed {
        x,
        y,
        z,
        ..Placed::IDENTITY
    })
}

/// Colours that everybody tells apart (Okabe and Ito 2008).
pub(super) const ORANGE: [f64; 3] = [0.902, 0.624, 0.0];
pub(super) const GREEN: [f64; 3] = [0.0, 0.62, 0.451];
pub(super) const VERMILION: [f64; 3] = [0.835, 0.369, 0.0];
pub(super) const PURPLE: [f64; 3] = [0.8, 0.475, 0.655];

pub(super) fn color([r, g, b]: [f64; 3], a: f64) -> Option<Color> {
    Some(Color { r, g, b, a })
}

/// A field of packed elements.
pub(super) fn field(name: &str, offset: u32, kind: NumericType) -> PackedElementField {
    PackedElementField {
        name: name.to_owned(),
        offset,
        r#type: kind as i32,
    }
}

/// A line through points of the map, closed where it ends where it begins.
pub(super) fn line(points: &[[f64; 3]], closed: bool, of: [f64; 3], width_m: f64) -> LinePrimitive {
    let kind = match closed {
        true => LineType::LineLoop,
        false => LineType::LineStrip,
    };
    LinePrimitive {
        r#type: kind as i32,
        pose: Some(place(0.0, 0.0, 0.0)),
        thickness: width_m,
        points: points.iter().map(|&[x, y, z]| Point3 { x, y, z }).collect(),
        color: color(of, 1.0),
        ..LinePrimitive::default()
    }
}

/// A thing of the map, with what is known of it.
pub(super) fn entity(stamp: i64, id: String, known: &[(&str, String)]) -> SceneEntity {
    let pair = |(key, value): &(&str, String)| KeyValuePair {
        key: (*key).to_owned(),
        value: value.clone(),
    };
    SceneEntity {
        timestamp: time(stamp),
        frame_id: MAP.to_owned(),
        id,
        metadata: known.iter().map(pair).collect(),
        ..SceneEntity::default()
    }
}
