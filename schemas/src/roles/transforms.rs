//! Transforms between frames, as `/tf` and `/tf_static` publish them.

use crate::roles::{
    Fields, FromMessage, Message, Messages, Mount, Role, SentTransform, frame_names,
};
use crate::{Pose, Stamp, record};

record! {
    /// One transform between two frames, as `/tf` and `/tf_static` publish them.
    #[layer("transforms", key(site, session, parent, child, stamp))]
    pub struct Transform {
        /// Site that the session belongs to.
        site: String,
        /// Session that the transform belongs to.
        session: String,
        /// Instant of the transform.
        stamp: Stamp ["ns"],
        /// Frame that points come out in.
        parent: String,
        /// Frame that points are given in.
        child: String,
        /// The transform.
        parent_from_child: Pose,
        /// True where it holds for all time: on `/tf_static`, or of a frame that no transform of the session moves, which
        /// then has its first row alone.
        fixed: bool,
    }
}

/// Topics with transforms.
pub const ROLE: Role = Role::of::<Transform>(Messages {
    lasting: true,
    mounts: Some(mounts),
    still: Some(&SENT),
    ..Messages::of::<Transform>(TYPES)
});

const SENT: Messages = Messages::of::<SentTransform>(TYPES);

/// The member of a message that has several transforms, each with a header of its own.
pub(super) const TRANSFORMS: &str = "transforms";

/// Message types of transforms.
pub(super) const TYPES: &[&str] = &[
    "tf2_msgs/TFMessage",
    "tf/tfMessage",
    "foxglove.FrameTransform",
    "foxglove.FrameTransforms",
];

/// Whether transforms of this topic hold for all time.
pub(super) fn is_static(topic: &str) -> bool {
    topic.ends_with("tf_static")
}

impl FromMessage for Transform {
    const MEMBERS: &'static [&'static str] = &[
        TRANSFORMS,
        "timestamp",
        "parent_frame_id",
        "child_frame_id",
        "translation",
        "rotation",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let all = all(message).ok_or("expected a transform")?;
        let rows: Vec<Self> = all.into_iter().collect::<Result<_, _>>()?;
        let Some(still) = message.still else {
            return Ok(rows);
        };
        let settled = |row| still.settled(row, message.log_time);
        Ok(rows.into_iter().filter_map(settled).collect())
    }
}

/// What a message says of frames that are fixed.
fn mounts(message: &Message<'_>) -> Vec<Mount> {
    if !is_static(message.topic) {
        return Vec::new();
    }
    // What makes no sense is counted where its rows are read.
    let rows = Transform::from_message(message).unwrap_or_default();
    let mount = |row: Transform| Mount {
        frame: row.child,
        to: row.parent,
        pose: row.parent_from_child,
    };
    rows.into_iter().map(mount).collect()
}

/// The transforms of a message, or why they make no sense; `None` where it is no message of transforms.
pub(super) fn all(message: &Message<'_>) -> Option<Vec<Result<Transform, String>>> {
    if let Some(list) = message.fields.list(TRANSFORMS) {
        let of_list = Fields::all(&list).map(|fields| transform(message, fields));
        return Some(of_list.collect());
    }
    let alone = message.fields.text(&["parent_frame_id"]).is_some();
    alone.then(|| vec![transform(message, message.fields)])
}

/// One transform, as tf2_msgs (`header`, `transform`) or foxglove (`parent_frame_id`, `translation`) spell it.
fn transform(message: &Message<'_>, fields: Fields<'_>) -> Result<Transform, String> {
    let (parent, pose) = match fields.text(&["header", "frame_id"]) {
        Some(parent) => {
            let paths = [["transform", "translation"], ["transform", "rotation"]];
            (Some(parent), fields.pose(&paths[0], &paths[1]))
        }
        None => (
            fields.text(&["parent_frame_id"]),
            fields.pose(&["translation"], &["rotation"]),
        ),
    };
    let child = fields.text(&["child_frame_id"]);
    let named = |frame: Option<String>, which: &str| match frame {
        Some(frame) => Ok(frame_names::plain(&frame).to_owned()),
        None => Err(format!("expected the name of the {which} frame")),
    };
    Ok(Transform {
        site: message.site.to_owned(),
        session: message.session.to_owned(),
        // Several senders share a topic, and those of fixed transforms often leave the stamp: zero says nothing of others.
        stamp: message.time_of(fields.stamp()?),
        parent: named(parent, "parent")?,
        child: named(child, "child")?,
        parent_from_child: pose?,
        fixed: is_static(message.topic),
    })
}
