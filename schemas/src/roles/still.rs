//! Frames that never move, though topics of moving transforms have them: many logs say on `/tf`, again and again, where
//! cameras are mounted.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry::{Occupied, Vacant};

use crate::roles::mounts::apart;
use crate::roles::transforms::{self, Transform};
use crate::roles::{FromMessage, Message, frame_names};
use crate::{Pose, Stamp, record};

record! {
    /// A transform as it was sent.
    #[layer("sent_transforms", key(parent, child, log_time))]
    pub struct SentTransform {
        /// When it was recorded.
        log_time: Stamp ["ns"],
        /// Frame that points come out in.
        parent: String,
        /// Frame that points are given in.
        child: String,
        /// The transform.
        parent_from_child: Pose,
        /// Whether its topic is one of fixed transforms.
        fixed: bool,
    }
}

impl FromMessage for SentTransform {
    const MEMBERS: &'static [&'static str] = Transform::MEMBERS;

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        // What makes no sense is the business of the role that reads it.
        let transforms = transforms::all(message).unwrap_or_default();
        let sent = |found: Transform| Self {
            log_time: message.log_time,
            parent: found.parent,
            child: found.child,
            parent_from_child: found.parent_from_child,
            fixed: found.fixed,
        };
        Ok(transforms.into_iter().flatten().map(sent).collect())
    }
}

/// Frames that are remembered; others are taken to move. So are frames of so many bytes.
const MOST: usize = 10_000;
const LONGEST: usize = 1000;

/// Whether a frame is one that vehicles move in (REP 105): what stands still in it does so for a while.
fn is_world(frame: &str) -> bool {
    let (_, name) = frame_names::split(frame);
    ["map", "world", "earth"].contains(&name) || name.contains("odom")
}

/// The frames of a session that are where they are whenever a transform says so, and that no topic of fixed transforms
/// has: mounts that are sent again and again. Not those of vehicles, which may stand.
#[derive(Debug, Clone, Default)]
pub struct StillFrames {
    frames: BTreeMap<String, FrameMotion>,
}

/// What was heard of a frame.
#[derive(Debug, Clone)]
enum FrameMotion {
    /// The same, whenever it was sent.
    Still {
        parent: String,
        pose: Pose,
        since: Stamp,
    },
    /// That it moves, or is fixed.
    Otherwise,
}

impl StillFrames {
    /// Adds a transform of the session.
    pub fn add(&mut self, sent: SentTransform) {
        if sent.parent.len().max(sent.child.len()) > LONGEST {
            return;
        }
        let is_otherwise = sent.fixed || is_world(&sent.parent);
        let has_room = self.frames.len() < MOST;
        let mut known = match self.frames.entry(sent.child) {
            Occupied(known) => known,
            Vacant(place) => {
                let still = FrameMotion::Still {
                    parent: sent.parent,
                    pose: sent.parent_from_child,
                    since: sent.log_time,
                };
                if has_room {
                    place.insert(if is_otherwise {
                        FrameMotion::Otherwise
                    } else {
                        still
                    });
                }
                return;
            }
        };
        if let FrameMotion::Still {
            parent,
            pose,
            since,
        } = known.get_mut()
        {
            *since = (*since).min(sent.log_time);
            let is_same = *parent == sent.parent && apart(pose, &sent.parent_from_child).is_none();
            if is_otherwise || !is_same {
                known.insert(FrameMotion::Otherwise);
            }
        }
    }

    /// Whether transforms that are still to come may change which of the frames heard of are still.
    pub fn is_open(&self) -> bool {
        let mut heard = self.frames.values();
        heard.any(|heard| matches!(heard, FrameMotion::Still { .. }))
    }

    /// A row of a message of this log time: of a frame that is still the first one alone, as a fixed transform.
    pub(super) fn settled(&self, row: Transform, log_time: Stamp) -> Option<Transform> {
        match self.frames.get(&row.child) {
            Some(FrameMotion::Still { since, .. }) if !row.fixed => {
                (*since == log_time).then_some(Transform { fixed: true, ..row })
            }
            _ => Some(row),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(log_time: i64, [parent, child]: [&str; 2], x: f64) -> SentTransform {
        SentTransform {
            log_time: Stamp(log_time),
            parent: parent.to_owned(),
            child: child.to_owned(),
            parent_from_child: Pose {
                x,
                ..Pose::IDENTITY
            },
            fixed: false,
        }
    }

    /// What becomes of a row of a frame at an instant: whether it is fixed; `None` where it is left out.
    fn settled(still: &StillFrames, child: &str, log_time: i64) -> Option<bool> {
        let row = Transform {
            site: "lot".into(),
            session: "a".into(),
            stamp: Stamp(0),
            parent: "base_link".into(),
            child: child.into(),
            parent_from_child: Pose::IDENTITY,
            fixed: false,
        };
        still.settled(row, Stamp(log_time)).map(|row| row.fixed)
    }

    #[test]
    fn what_never_moves_is_fixed_once_and_what_moves_once_is_not() {
        let mut still = StillFrames::default();
        assert!(!still.is_open());
        for at in [7, 5, 6] {
            still.add(sent(at, ["base_link", "left"], 1.0));
            let step = if at == 6 { 0.001 } else { 0.0 };
            still.add(sent(at, ["base_link", "steering"], 2.0 + step));
            let mount = if at == 6 { "mast" } else { "base_link" };
            still.add(sent(at, [mount, "right"], 3.0));
        }
        assert!(still.is_open());
        assert_eq!(settled(&still, "left", 5), Some(true));
        assert_eq!(settled(&still, "left", 6), None);
        for moving in ["steering", "right", "never_heard_of"] {
            assert_eq!(settled(&still, moving, 6), Some(false), "{moving}");
        }
        still.add(sent(8, ["base_link", "steering"], 2.0));
        assert_eq!(settled(&still, "steering", 8), Some(false));
    }

    #[test]
    fn vehicles_that_stand_and_frames_that_are_fixed_otherwise_are_as_they_were() {
        let mut still = StillFrames::default();
        for at in 0..3 {
            for parent in ["odom", "a/map", "vio_odom", "world"] {
                still.add(sent(at, [parent, &format!("of_{parent}")], 0.0));
            }
            still.add(sent(at, ["base_link", "left"], 1.0));
        }
        let fixed = SentTransform {
            fixed: true,
            ..sent(1, ["base_link", "left"], 1.0)
        };
        assert!(still.is_open());
        still.add(fixed);
        assert!(!still.is_open());
        for frame in ["of_odom", "of_a/map", "of_vio_odom", "of_world", "left"] {
            assert_eq!(settled(&still, frame, 0), Some(false), "{frame}");
        }
    }

    #[test]
    fn no_more_frames_are_remembered_than_there_is_room_for() {
        let mut still = StillFrames::default();
        for frame in 0..MOST + 10 {
            still.add(sent(0, ["base_link", &frame.to_string()], 0.0));
        }
        still.add(sent(0, ["base_link", &"x".repeat(LONGEST + 1)], 0.0));
        assert_eq!(still.frames.len(), MOST);
        assert_eq!(settled(&still, &(MOST + 5).to_string(), 0), Some(false));
    }
}
