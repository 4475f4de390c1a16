//! Logs that are others but for their odometry.

use std::collections::BTreeMap;
use std::path::Path;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::StampedPose;
use serde_json::{Value, json};

use crate::json_log::JsonLog;
use crate::trajectories::pose;
use crate::{POSE_SCHEMA, rows_of_log};

/// How a log tells where the vehicle is.
#[derive(Debug, Clone, Copy)]
pub enum Told {
    /// `/odom`, foxglove.PoseInFrame.
    Poses,
    /// `/tf` from `odom` to `base_link`, foxglove.FrameTransform, between the transforms of other frames.
    Transforms,
}

/// The odometry of a log.
///
/// # Panics
/// Where it cannot be read.
pub fn odometry(log: &Path) -> Vec<StampedPose> {
    let sql = "SELECT CAST(stamp AS BIGINT) AS stamp_ns, odom_from_vehicle AS pose FROM odometry ORDER BY stamp";
    let rows = rows_of_log(log, sql);
    let rows = rows.as_array().expect("rows are a list");
    let row = |row: &Value| StampedPose {
        stamp_ns: row["stamp_ns"].as_i64().expect("a stamp is a number"),
        pose: pose(&row["pose"]),
    };
    rows.iter().map(row).collect()
}

/// Writes a log that says what another one says, but for its topic `/odom`: in its place it has these poses.
///
/// # Panics
/// Where one cannot be read or the other not be written.
pub fn with_odometry(source: &Path, target: &Path, poses: &[StampedPose], told: Told) {
    let bytes = std::fs::read(source).expect("a log can be read");
    let mut log = JsonLog::new(target);
    let (topic, schema, definition) = match told {
        Told::Poses => ("/odom", "foxglove.PoseInFrame", POSE_SCHEMA),
        Told::Transforms => ("/tf", "foxglove.FrameTransform", TRANSFORM_SCHEMA),
    };
    let topic = log.topic(topic, schema, definition.as_bytes());
    let mut channels = BTreeMap::new();
    let mut sequence = 0;
    let mut send = |log: &mut JsonLog, stamp_ns: i64, message: &Value| {
        log.send(topic, sequence, stamp_ns as u64, message);
        sequence += 1;
    };
    let mut poses = poses.iter().peekable();
    for message in mcap::MessageStream::new(&bytes).expect("a log is MCAP") {
        let message = message.expect("a log is whole");
        while let Some(next) = poses.next_if(|next| next.stamp_ns as u64 <= message.log_time) {
            match told {
                Told::Poses => send(&mut log, next.stamp_ns, &pose_message(next)),
                Told::Transforms => {
                    let wheel = Pose::from_yaw(1.0, 0.8, 0.0);
                    let wheel = transform_message(next.stamp_ns, ["base_link", "wheel"], &wheel);
                    send(&mut log, next.stamp_ns, &wheel);
                    let odom = transform_message(next.stamp_ns, ["odom", "base_link"], &next.pose);
                    send(&mut log, next.stamp_ns, &odom);
                }
            }
        }
        if message.channel.topic != "/odom" {
            let of = &message.channel;
            let copied = channels.entry(of.id).or_insert_with(|| {
                let schema = of.schema.as_ref().expect("messages have a schema");
                let schema = log
                    .0
                    .add_schema(&schema.name, &schema.encoding, &schema.data);
                let schema = schema.expect("a schema fits");
                let encoding = &of.message_encoding;
                let channel = log.0.add_channel(schema, &of.topic, encoding, &of.metadata);
                channel.expect("a channel fits")
            });
            let header = mcap::records::MessageHeader {
                channel_id: *copied,
                sequence: message.sequence,
                log_time: message.log_time,
                publish_time: message.publish_time,
            };
            let written = log.0.write_to_known_channel(&header, &message.data);
            written.expect("a message fits");
        }
    }
    log.finish();
}

fn stamp(stamp_ns: i64) -> Value {
    json!({ "sec": stamp_ns / 1_000_000_000, "nsec": stamp_ns % 1_000_000_000 })
}

fn parts(pose: &Pose) -> (Value, Value) {
    let [x, y, z, qx, qy, qz, qw] = pose.to_array();
    (
        json!({ "x": x, "y": y, "z": z }),
        json!({ "x": qx, "y": qy, "z": qz, "w": qw }),
    )
}

fn pose_message(at: &StampedPose) -> Value {
    let (position, orientation) = parts(&at.pose);
    json!({
        "timestamp": stamp(at.stamp_ns),
        "frame_id": "odom",
        "pose": { "position": position, "orientation": orientation },
    })
}

fn transform_message(stamp_ns: i64, [parent, child]: [&str; 2], pose: &Pose) -> Value {
    let (translation, rotation) = parts(pose);
    json!({
        "timestamp": stamp(stamp_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": translation,
        "rotation": rotation,
    })
}

const TRANSFORM_SCHEMA: &str = r#"{
  "type": "object",
  "properties": {
    "timestamp": { "type": "object", "properties": { "sec": { "type": "integer" }, "nsec": { "type": "integer" } } },
    "parent_frame_id": { "type": "string" },
    "child_frame_id": { "type": "string" },
    "translation": {
      "type": "object",
      "properties": { "x": { "type": "number" }, "y": { "type": "number" }, "z": { "type": "number" } }
    },
    "rotation": {
      "type": "object",
      "properties": {
        "x": { "type": "number" }, "y": { "type": "number" }, "z": { "type": "number" }, "w": { "type": "number" }
      }
    }
  }
}"#;
