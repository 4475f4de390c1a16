//! What the index of a file does not say of its chunks.

use std::sync::Arc;

use crate::log::index::Unit;
use crate::losses::{Loss, Reason};
use crate::session::LogPart;

/// Messages that the index does not know of, in a unit that is read for others.
pub(crate) struct Strays {
    part: Arc<LogPart>,
    unit: Unit,
    /// The last channel that was seen to be known.
    known: Option<u16>,
    /// Messages of channels that are described nowhere.
    unknown: u64,
    /// Messages of channels that the index does not list here.
    unlisted: u64,
}

impl Strays {
    /// None yet.
    pub fn new(part: &Arc<LogPart>, unit: &Unit) -> Self {
        Self {
            part: Arc::clone(part),
            unit: unit.clone(),
            known: None,
            unknown: 0,
            unlisted: 0,
        }
    }

    /// Takes a message of this channel.
    pub fn see(&mut self, channel: u16) {
        if self.known == Some(channel) {
            return;
        }
        if !self.part.index.channels.contains_key(&channel) {
            self.unknown += 1;
        } else if !self.unit.may_hold(channel) {
            self.unlisted += 1;
        } else {
            self.known = Some(channel);
        }
    }

    /// Notes how many there were.
    pub fn note(&self) {
        let (losses, offset) = (&self.part.losses, self.unit.offset);
        let loss = |count| Loss { count, bytes: 0 };
        // An index that was made by reading the file has told of its channels already.
        if self.unknown > 0 && self.part.index.indexed {
            let detail = "expected messages of the channels in the summary, found others";
            losses.note(Reason::UnknownChannel, offset, loss(self.unknown), detail);
        }
        if self.unlisted > 0 {
            let detail = "expected messages of the channels that the summary lists for the chunk, found others";
            losses.note(Reason::BadSummary, offset, loss(self.unlisted), detail);
        }
    }
}
