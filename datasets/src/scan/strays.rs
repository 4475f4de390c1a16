//! What the index of a file does not say of its chunks.

use std::sync::Arc;

use crate::log::definition::Definition;
use crate::log::index::Unit;
use crate::log::record::MessageHead;
use crate::log::tally::Short;
use crate::losses::{Loss, Reason};
use crate::session::LogPart;

/// What contradicts the index in a unit that is read. What is read is told; what the index hides altogether, `inspect`
/// finds, as it reads everything.
pub(crate) struct Strays {
    part: Arc<LogPart>,
    unit: Unit,
    /// Messages, by channel.
    found: Vec<u64>,
    /// The last channel that was seen to be known.
    known: Option<u16>,
    /// Messages of channels that are described nowhere.
    unknown: u64,
    /// Messages of channels that the index does not list here.
    unlisted: u64,
    /// Messages at other times than the index says.
    elsewhen: u64,
    /// Messages whose log time no [`i64`] holds.
    late: u64,
    /// Definitions other than those of the index, and one of them in words.
    redefined: (u64, String),
}

impl Strays {
    /// None yet.
    pub fn new(part: &Arc<LogPart>, unit: &Unit) -> Self {
        Self {
            part: Arc::clone(part),
            unit: unit.clone(),
            found: Vec::new(),
            known: None,
            unknown: 0,
            unlisted: 0,
            elsewhen: 0,
            late: 0,
            redefined: (0, String::new()),
        }
    }

    /// Takes a message.
    pub fn see(&mut self, head: &MessageHead) {
        let channel = usize::from(head.channel);
        if channel >= self.found.len() {
            self.found.resize(channel + 1, 0);
        }
        self.found[channel] += 1;
        let said = self.unit.start_time..=self.unit.end_time;
        self.elsewhen += u64::from(!said.contains(&head.log_time));
        self.late += u64::from(head.is_late());
        if self.known == Some(head.channel) {
            return;
        }
        if !self.part.index.channels.contains_key(&head.channel) {
            self.unknown += 1;
        } else if !self.unit.may_hold(head.channel) {
            self.unlisted += 1;
        } else {
            self.known = Some(head.channel);
        }
    }

    /// Takes a schema or channel record.
    pub fn define(&mut self, opcode: u8, body: &[u8]) {
        let known = Definition::parse(opcode, body).and_then(|found| self.part.index.has(&found));
        if let Err(detail) = known {
            self.redefined.0 += 1;
            self.redefined.1 = detail;
        }
    }

    /// Notes how many there were; and of a unit that is `whole`, nothing of it lost, what the file is short of by now.
    pub fn note(&self, whole: bool) {
        if whole {
            self.note_short();
        }
        let note = |reason, count, detail: &str| {
            if count > 0 {
                let loss = Loss { count, bytes: 0 };
                self.part
                    .losses
                    .note(reason, self.unit.offset, loss, detail);
            }
        };
        note(Reason::Senseless, self.late, MessageHead::LATE);
        // An index that was made by reading the file has told of the rest already.
        if self.part.index.indexed {
            let detail = "expected messages of the channels in the summary, found others";
            note(Reason::UnknownChannel, self.unknown, detail);
            note(Reason::BadRecord, self.redefined.0, &self.redefined.1);
        }
        let detail =
            "expected messages of the channels that the summary lists for the chunk, found others";
        note(Reason::BadSummary, self.unlisted, detail);
        let detail =
            "expected messages of the times that the summary says of the chunk, found others";
        note(Reason::BadSummary, self.elsewhen, detail);
    }
    fn note_short(&self) {
        let part = &self.part;
        let found = self.found.iter().enumerate();
        let found = found.filter(|(_, messages)| **messages > 0);
        let found =
            found.filter_map(|(channel, messages)| Some((u16::try_from(channel).ok()?, *messages)));
        for short in part.tally.add(&part.index, &self.unit, found) {
            let Short {
                channel,
                said,
                found,
            } = short;
            let known = channel.and_then(|channel| part.index.channels.get(&channel));
            let topic = known.map_or("", |channel| channel.topic.as_str());
            let place = channel.map_or(part.meta.size, u64::from);
            let detail = format!("expected {said} messages as the summary says, found {found}");
            let loss = Loss::one(0);
            part.losses
                .note_topic(Reason::BadSummary, topic, place, loss, detail);
        }
    }
}
