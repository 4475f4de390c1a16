//! What the messages of a session say of frames that are fixed: each to one other, in one way, or it is counted.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry::{Occupied, Vacant};
use std::sync::{Mutex, PoisonError};

use evermap_schemas::roles::Mount;

use crate::losses::{FileLosses, Loss, Reason};

/// Frames of a session that are remembered; what is said of others is not compared.
const MOST: usize = 10_000;

/// Bytes of a frame's name at most, of those that are remembered.
const LONGEST: usize = 1_000;

/// Frames of a topic that a person is told by name.
const NAMED: usize = 3;

/// What a session has said so far.
#[derive(Debug)]
pub(crate) struct Mounts {
    losses: FileLosses,
    heard: Mutex<Heard>,
}

#[derive(Debug, Default)]
struct Heard {
    /// By frame: the topic and what it said first.
    first: BTreeMap<String, (String, Mount)>,
    /// By topic, and frame: how it says otherwise.
    otherwise: BTreeMap<String, BTreeMap<String, String>>,
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
        let Heard { first, otherwise } = &mut *heard;
        let has_room = first.len() < MOST;
        let (known_topic, known) = match first.entry(mount.frame.clone()) {
            Occupied(known) => known.into_mut(),
            Vacant(place) => {
                if has_room {
                    place.insert((topic.to_owned(), mount));
                }
                return;
            }
        };
        let Some(how) = mount.contradiction(known) else {
            return;
        };
        let topic = topic.max(known_topic.as_str());
        let frames = otherwise.entry(topic.to_owned()).or_default();
        if frames.contains_key(&mount.frame) {
            return;
        }
        frames.insert(mount.frame, how);
        let loss = Loss {
            count: frames.len() as u64,
            bytes: 0,
        };
        let said = told(frames);
        let losses = &self.losses;
        losses.note_topic(Reason::Contradiction, topic, 0, loss, said);
    }
}

fn told(frames: &BTreeMap<String, String>) -> String {
    let named: Vec<&str> = frames.values().take(NAMED).map(String::as_str).collect();
    let named = named.join("; ");
    match frames.len().saturating_sub(NAMED) {
        0 => named,
        more => format!("{named}; and {more} more"),
    }
}
