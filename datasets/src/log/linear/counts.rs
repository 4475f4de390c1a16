//! Comparing what the recorder counted with what a file holds, where all of it is read.

use evermap_schemas::Fault;
use mcap::records::{Record, Statistics, op};

use super::Scan;
use crate::log::record::parse;
use crate::losses::{Loss, Reason};

impl Scan<'_> {
    /// Keeps what the recorder counted.
    pub(super) async fn statistics(&mut self, offset: u64, length: u64) -> Result<(), Fault> {
        let body = self.body(op::STATISTICS, offset, length).await?;
        match parse(op::STATISTICS, &body) {
            Ok(Record::Statistics(statistics)) => self.said = Some(statistics),
            _ => {
                let detail = "expected statistics, found a record that is cut or malformed";
                self.bad_record(detail, offset, length);
            }
        }
        Ok(())
    }

    /// Says what a file of this size is short of: fewer messages than were counted, in all or else of a channel, and
    /// messages of channels that nobody describes. Where there are more than were counted, nothing is lost.
    pub(super) fn compare_counts(&self, size: u64) {
        let Some(said) = &self.said else { return };
        let found = self.messages();
        let short = found < said.message_count;
        if short {
            let detail = as_said(said.message_count, found);
            self.losses
                .note(Reason::BadSummary, size, Loss::one(0), detail);
        }
        self.compare_channels(said, short);
    }

    /// As [`Self::compare_counts`] by channel; where it was said that there are too few in all, of channels alone that nobody
    /// describes.
    fn compare_channels(&self, said: &Statistics, short: bool) {
        for (id, said) in &said.channel_message_counts {
            let found = self.paces.get(id).map_or(0, |pace| pace.messages);
            let channel = self.collector.index.channels.get(id);
            if found >= *said || (short && channel.is_some()) {
                continue;
            }
            let (topic, detail) = match channel {
                Some(channel) => (channel.topic.as_str(), as_said(*said, found)),
                None => {
                    let detail = as_said(*said, found);
                    (
                        "",
                        format!("channel {id}, which nobody describes: {detail}"),
                    )
                }
            };
            let place = u64::from(*id);
            self.losses
                .note_topic(Reason::BadSummary, topic, place, Loss::one(0), detail);
        }
    }
}

/// That a file holds another number of messages than its summary says.
pub(in crate::log) fn as_said(said: u64, found: u64) -> String {
    format!("expected {said} messages as the summary says, found {found}")
}
