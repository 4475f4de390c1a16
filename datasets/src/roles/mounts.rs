//! What the messages of a session say of frames that are fixed: each to one other, in one way and in no circle, or it is
//! counted.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use evermap_schemas::roles::Mount;

use crate::losses::{FileLosses, Loss, Reason};

/// Frames of a session that are remembered; what is said of others is not compared.
const MOST: usize = 10_000;

/// Bytes of a frame's name at most, of those that are remembered.
const LONGEST: usize = 1_000;

/// Frames of a circle at most that is noticed: no chain of mounts is as long.
const LONGEST_CIRCLE: usize = 100;

/// Frames of a topic that a person is told by name.
const NAMED: usize = 3;

/// What a session has said so far.
#[derive(Debug)]
pub(crate) struct Mounts {
    losses: FileLosses,
    heard: Mutex<MountStatements>,
}

#[derive(Debug, Default)]
struct MountStatements {
    /// By frame: the topic and what it said first.
    first: BTreeMap<String, (String, Mount)>,
    /// By topic, and frame: how it says otherwise.
    otherwise: BTreeMap<String, BTreeMap<String, String>>,
    /// By topic, and first frame: how a circle goes.
    circles: BTreeMap<String, BTreeMap<String, String>>,
}

impl Mounts {
    /// Nothing yet; contradictions are noted as losses of a file of the session.
    pub fn new(losses: FileLosses) -> Self {
        Self {
            losses,
            heard: Mutex::default(),
        }
    }

    /// Compares with what was said before. Whatever order messages come in, the same is counted.
    pub fn hear(&self, topic: &str, mount: Mount) {
        if mount.frame.len().max(mount.to.len()) > LONGEST {
            return;
        }
        let mut heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        let MountStatements {
            first,
            otherwise,
            circles,
        } = &mut *heard;
        let Some((known_topic, known)) = first.get(&mount.frame) else {
            if first.len() < MOST {
                let frame = mount.frame.clone();
                first.insert(frame.clone(), (topic.to_owned(), mount));
                if let Some((topic, frame, how)) = circle(first, &frame) {
                    self.note(Reason::Circle, circles, &topic, frame, how);
                }
            }
            return;
        };
        let Some(how) = mount.contradiction(known) else {
            return;
        };
        let topic = topic.max(known_topic.as_str());
        self.note(Reason::Contradiction, otherwise, topic, mount.frame, how);
    }

    /// Notes what is said of a frame of a topic, once, with all that was said of others before.
    fn note(
        &self,
        reason: Reason,
        said: &mut BTreeMap<String, BTreeMap<String, String>>,
        topic: &str,
        frame: String,
        how: String,
    ) {
        let frames = said.entry(topic.to_owned()).or_default();
        if frames.contains_key(&frame) {
            return;
        }
        frames.insert(frame, how);
        let loss = Loss {
            count: frames.len() as u64,
            bytes: 0,
        };
        let said = told(frames);
        self.losses.note_topic(reason, topic, 0, loss, said);
    }
}

/// The circle that a frame is on, whichever of its frames came last: the last of its topics, its first frame, and how it
/// goes.
fn circle(
    mounts: &BTreeMap<String, (String, Mount)>,
    frame: &str,
) -> Option<(String, String, String)> {
    let mut circle = Vec::new();
    let mut next = frame;
    loop {
        let (topic, mount) = mounts.get(next)?;
        circle.push((mount.frame.as_str(), topic));
        next = &mount.to;
        if next == frame {
            break;
        }
        if circle.len() == LONGEST_CIRCLE {
            return None;
        }
    }
    let first = circle.iter().map(|(frame, _)| *frame).min()?;
    let topic = circle.iter().map(|(_, topic)| *topic).max()?;
    let begins = circle.iter().position(|(frame, _)| *frame == first)?;
    circle.rotate_left(begins);
    let frames = circle.iter().map(|(frame, _)| *frame).chain([first]);
    let named: Vec<String> = frames.map(|frame| format!("`{frame}`")).collect();
    let how = named.join(" is fixed to ");
    Some((topic.clone(), first.to_owned(), how))
}

fn told(frames: &BTreeMap<String, String>) -> String {
    let named: Vec<&str> = frames.values().take(NAMED).map(String::as_str).collect();
    let named = named.join("; ");
    match frames.len().saturating_sub(NAMED) {
        0 => named,
        more => format!("{named}; and {more} more"),
    }
}
