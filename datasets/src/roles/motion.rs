//! Odometry and transforms.

use evermap_messages::MessageType;
use evermap_schemas::Pose;
use evermap_schemas::roles::{OdometryPose, Transform};

use crate::roles::columns::Columns;
use crate::roles::rows::{Decoded, FromMessages, plain_frame};
use crate::scan::MessageAt;

impl FromMessages for OdometryPose {
    const MEMBERS: &'static [&'static str] = &["header", "timestamp", "pose", "twist"];
    type Note = ();

    fn note(_: &MessageType, _: &MessageAt<'_>) -> Result<(), String> {
        Ok(())
    }

    fn rows(message: Decoded<'_>, (): ()) -> Result<Vec<Self>, String> {
        let (columns, row) = (message.columns, message.row);
        // nav_msgs/Odometry has a pose with covariance, PoseStamped and PoseInFrame a plain one.
        let nested = columns
            .number(&["pose", "pose", "position", "x"], row)
            .is_some();
        let pose = match nested {
            true => columns.pose(
                &["pose", "pose", "position"],
                &["pose", "pose", "orientation"],
                row,
            ),
            false => columns.pose(&["pose", "position"], &["pose", "orientation"], row),
        };
        let twist = |[kind, axis]: [&str; 2]| {
            let covariant = columns.number(&["twist", "twist", kind, axis], row);
            let found = covariant.or_else(|| columns.number(&["twist", kind, axis], row));
            found.filter(|number| number.is_finite())
        };
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp(),
            topic: message.topic.to_owned(),
            odom_from_vehicle: pose?,
            speed_mps: twist(["linear", "x"]),
            yaw_rate_radps: twist(["angular", "z"]),
        }])
    }
}

impl FromMessages for Transform {
    const MEMBERS: &'static [&'static str] = &[
        "transforms",
        "timestamp",
        "parent_frame_id",
        "child_frame_id",
        "translation",
        "rotation",
    ];
    type Note = ();

    fn note(_: &MessageType, _: &MessageAt<'_>) -> Result<(), String> {
        Ok(())
    }

    fn rows(message: Decoded<'_>, (): ()) -> Result<Vec<Self>, String> {
        match message.columns.list("transforms", message.row) {
            Some(list) => (0..list.len())
                .map(|row| transform(&message, &list, row))
                .collect(),
            None => Ok(vec![transform(&message, message.columns, message.row)?]),
        }
    }
}

/// One transform, as tf2_msgs (`header`, `transform`) or foxglove (`parent_frame_id`, `translation`) spell it.
fn transform(message: &Decoded<'_>, columns: &Columns, row: usize) -> Result<Transform, String> {
    let tf = columns.text(&["header", "frame_id"], row);
    let (parent, pose): (Option<String>, Result<Pose, String>) = match tf {
        Some(parent) => (
            Some(parent),
            columns.pose(
                &["transform", "translation"],
                &["transform", "rotation"],
                row,
            ),
        ),
        None => (
            columns.text(&["parent_frame_id"], row),
            columns.pose(&["translation"], &["rotation"], row),
        ),
    };
    let stamp = columns
        .stamp(&["header", "stamp"], row)
        .or_else(|| columns.stamp(&["timestamp"], row));
    let child = columns.text(&["child_frame_id"], row);
    Ok(Transform {
        site: message.site.to_owned(),
        session: message.session.to_owned(),
        stamp: stamp.unwrap_or(message.log_time),
        parent: plain_frame(&parent.ok_or("expected the name of the parent frame")?),
        child: plain_frame(&child.ok_or("expected the name of the child frame")?),
        parent_from_child: pose?,
        fixed: message.topic.ends_with("tf_static"),
    })
}
