//! What becomes of the records of a file while they go by: its index, as far as there is room.

use mcap::records::Statistics;

use crate::log::definition::{Definition, LogChannel};
use crate::log::index::{Counts, LogIndex, Unit, UnitKind};

/// Bytes that an index may hold: of schemas and channels, and of the places of records. A recording of ten hours with a
/// thousand topics takes a fifth of it.
const INDEX_BYTES: usize = 48 << 20;

/// Bytes that a note of a channel's metadata takes beside its text.
const NOTE_BYTES: usize = 112;

/// Collects what a file holds while its records go by.
#[derive(Debug)]
pub(crate) struct Collector {
    pub index: LogIndex,
    /// What the recorder counted.
    pub statistics: Option<Statistics>,
    /// Bytes that the index may still hold.
    pub room: usize,
    /// Whether something found no room.
    pub full: bool,
}

impl Default for Collector {
    fn default() -> Self {
        Self {
            index: LogIndex::default(),
            statistics: None,
            room: INDEX_BYTES,
            full: false,
        }
    }
}

impl Collector {
    /// Whether there is room for so many bytes; they are taken.
    fn take(&mut self, bytes: usize) -> bool {
        match self.room.checked_sub(bytes) {
            Some(room) => self.room = room,
            None => self.full = true,
        }
        !self.full
    }

    /// Takes a stretch of messages, an attachment or a metadata record.
    pub fn add_unit(&mut self, unit: Unit) {
        let channels = unit.channels.as_ref().map_or(0, Vec::len);
        if !self.take(size_of::<Unit>() + size_of::<u16>() * channels) {
            return;
        }
        let units = match unit.kind {
            UnitKind::Chunk | UnitKind::Loose => &mut self.index.units,
            UnitKind::Attachment => &mut self.index.attachments,
            UnitKind::Metadata => &mut self.index.metadata,
        };
        units.push(unit);
    }

    /// Takes a schema or channel record.
    ///
    /// # Errors
    /// In words, where it is malformed, or says other things than one of its number before.
    pub fn add_definition(&mut self, opcode: u8, body: &[u8]) -> Result<(), String> {
        let definition = Definition::parse(opcode, body)?;
        if self.index.has(&definition)? {
            return Ok(());
        }
        match definition {
            Definition::Schema(id, schema) if self.take(body.len()) => {
                self.index.schemas.insert(id, schema.into());
            }
            Definition::Channel(channel)
                if self.take(2 * body.len() + NOTE_BYTES * channel.metadata.len()) =>
            {
                self.index.channels.insert(channel.id, channel.into());
            }
            _ => {}
        }
        Ok(())
    }

    /// Whether every channel refers to a schema that was seen, and `ids` are all channels that were seen.
    pub fn describes(&self, mut ids: impl Iterator<Item = u16>) -> bool {
        let Self { index, .. } = self;
        let complete =
            |channel: &LogChannel| channel.schema_id == 0 || index.schema_of(channel).is_some();
        let mut channels = index.channels.values();
        channels.all(|channel| complete(channel)) && ids.all(|id| index.channels.contains_key(&id))
    }

    /// The index.
    pub fn finish(mut self) -> LogIndex {
        self.index.counts = self.statistics.map(|statistics| {
            let channels = statistics.channel_message_counts;
            Counts {
                messages: statistics.message_count,
                channels: (!channels.is_empty()).then_some(channels),
            }
        });
        self.index.units.sort_by_key(|unit| unit.offset);
        self.index.attachments.sort_by_key(|unit| unit.offset);
        self.index.metadata.sort_by_key(|unit| unit.offset);
        self.index
    }
}
