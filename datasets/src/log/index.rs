//! What a log holds and where: read from the file's summary where it has a sound one, else found by reading the file
//! from its start.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::Fault;
use mcap::records::ChunkIndex;
use object_store::{ObjectMeta, ObjectStore};
use serde::{Deserialize, Serialize};

use crate::log::definition::{Definition, LogChannel, LogSchema};
use crate::log::linear::{self, Summarised};
use crate::log::pace::Pace;
use crate::log::record::{MAGIC, nanoseconds};
use crate::log::summary::{self, TrailingSummary};
use crate::losses::{Entry, LossLedger, Reason};

/// Where a JSON Schema names fields.
const PROPERTIES: &[u8] = b"\"properties\"";
/// A schema that names no fields has nothing to say that is longer (bytes).
const LONGEST_WITHOUT_FIELDS: usize = 1024;

/// A stretch of the file that is read at once.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Unit {
    /// What it is.
    pub kind: UnitKind,
    /// Offset in the file of its first record.
    pub offset: u64,
    /// Bytes in the file.
    pub length: u64,
    /// Bytes after decompression.
    pub size: u64,
    /// Channels of its messages, ascending; `None` where the index does not say.
    pub channels: Option<Vec<u16>>,
    /// Earliest log time, ns.
    pub start_time: i64,
    /// Latest log time, ns.
    pub end_time: i64,
}

/// What a [`Unit`] is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum UnitKind {
    /// One chunk record.
    Chunk,
    /// Records outside any chunk, messages among them.
    Loose,
    /// One attachment record.
    Attachment,
    /// One metadata record.
    Metadata,
}

impl Unit {
    /// Whether it may hold messages of this channel.
    pub fn may_hold(&self, channel: u16) -> bool {
        self.channels
            .as_ref()
            .is_none_or(|channels| channels.binary_search(&channel).is_ok())
    }

    /// Behind its last byte.
    pub fn end(&self) -> u64 {
        self.offset.saturating_add(self.length)
    }

    /// The first bytes of it, as one to read.
    pub(crate) fn first(&self, bytes: u64) -> Self {
        Self {
            length: self.length.min(bytes),
            size: self.size.min(bytes),
            ..self.clone()
        }
    }

    pub(crate) fn of_chunk(chunk: &ChunkIndex) -> Self {
        let channels = (!chunk.message_index_offsets.is_empty())
            .then(|| chunk.message_index_offsets.keys().copied().collect());
        Self {
            kind: UnitKind::Chunk,
            offset: chunk.chunk_start_offset,
            length: chunk.chunk_length,
            size: chunk.uncompressed_size,
            channels,
            start_time: nanoseconds(chunk.message_start_time),
            end_time: nanoseconds(chunk.message_end_time),
        }
    }

    pub(crate) fn of_record(kind: UnitKind, offset: u64, length: u64, time: i64) -> Self {
        Self {
            kind,
            offset,
            length,
            size: length,
            channels: Some(Vec::new()),
            start_time: time,
            end_time: time,
        }
    }
}

/// How many messages a log has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// In all.
    pub messages: u64,
    /// By channel; `None` where the recorder did not tell them apart.
    pub channels: Option<BTreeMap<u16, u64>>,
}

/// The checksum that a recorder made of the first bytes of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataSum {
    /// So many bytes, to the record that ends the data.
    pub bytes: u64,
    /// CRC-32 of them.
    pub expected: u32,
}

impl DataSum {
    /// In words, that it is not that of the bytes; `None` where it is.
    pub(crate) fn mismatch(&self, found: u32) -> Option<String> {
        let Self { bytes, expected } = self;
        (found != *expected).then(|| {
            format!("expected the checksum {expected:08x} of the {bytes} B before the end record, found {found:08x}")
        })
    }
}

/// The index of one file of a log. It can be kept, and spares whoever opens the file again to read it: see
/// [`LogIndex::fits`].
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogIndex {
    /// Bytes of the file.
    pub size: u64,
    /// Profile of the header: `ros2`, `ros1`, or empty.
    pub profile: String,
    /// Library that wrote the file.
    pub library: String,
    /// Schemas by number.
    pub schemas: BTreeMap<u16, Arc<LogSchema>>,
    /// Channels by number.
    pub channels: BTreeMap<u16, Arc<LogChannel>>,
    /// Stretches that hold messages, in file order.
    pub units: Vec<Unit>,
    /// Attachment records, in file order.
    pub attachments: Vec<Unit>,
    /// Metadata records, in file order.
    pub metadata: Vec<Unit>,
    /// Messages, as the recorder counted them or, where there is no sound summary, as they were found; `None` where
    /// nobody counted.
    pub counts: Option<Counts>,
    /// When messages came, by channel, where the whole file was read.
    #[serde(default)]
    pub paces: BTreeMap<u16, Pace>,
    /// Messages outside of chunks that were held to no checksum, where the whole file was read.
    #[serde(default)]
    pub unchecked: u64,
    /// The checksum of all data, where messages are outside of chunks and nobody has read what it is of.
    #[serde(default)]
    pub sum: Option<DataSum>,
    /// Whether the file's own summary was used.
    pub indexed: bool,
    /// Whether the file has a summary that was not: it is damaged, or contradicts the file.
    #[serde(default)]
    pub unbelieved: bool,
    /// What was lost while the index was read.
    pub losses: Vec<Entry>,
}

impl LogIndex {
    /// Raised where the same file gives another index, or other losses: what was kept before is then read anew.
    pub const VERSION: u32 = 6;

    /// Reads the index of the file at `meta.location`: the summary where there is a sound one, else the whole file, one
    /// record at a time.
    ///
    /// # Errors
    /// A data fault when the file is empty or no MCAP file at all, a resource fault when the store fails. Damage
    /// behind the file's first bytes is no error: it is among the index's losses.
    pub async fn read(store: &Arc<dyn ObjectStore>, meta: &ObjectMeta) -> Result<Self, Fault> {
        check_kind(store, meta).await?;
        let ledger = LossLedger::new();
        let losses = ledger.of_file(meta.location.as_ref());
        let (indexed, unbelieved) = match summary::read(store, meta).await? {
            TrailingSummary::Sound(found) => {
                let index = match linear::with_gaps(store, meta, *found, &losses).await? {
                    Summarised::Whole(index) => Some(index),
                    Summarised::Contradicted => None,
                    Summarised::Cut(index) => {
                        if let Some(whole) = Self::from_start(store, meta).await? {
                            return Ok(whole);
                        }
                        Some(index)
                    }
                };
                (index, true)
            }
            TrailingSummary::Unbelieved => (None, true),
            TrailingSummary::Nothing => (None, false),
        };
        let index = match indexed {
            Some(index) => index,
            None => Self {
                unbelieved,
                ..linear::read(store, meta, &losses).await?
            },
        };
        Ok(Self {
            size: meta.size,
            losses: ledger.entries(),
            ..index
        })
    }

    /// The index of a file whose summary is not believed, if its records follow each other from its start to their end: behind
    /// one that is damaged, the summary finds more.
    async fn from_start(
        store: &Arc<dyn ObjectStore>,
        meta: &ObjectMeta,
    ) -> Result<Option<Self>, Fault> {
        let ledger = LossLedger::new();
        let losses = ledger.of_file(meta.location.as_ref());
        let index = linear::read(store, meta, &losses).await?;
        let losses = ledger.entries();
        let is_torn = losses.iter().any(|lost| lost.reason == Reason::Torn);
        Ok((!is_torn).then(|| Self {
            size: meta.size,
            unbelieved: true,
            losses,
            ..index
        }))
    }

    /// Whether it can be the index of a file of this size, as far as it says itself: it was read from one, its
    /// stretches lie inside one behind the other, and what is sorted in an index is sorted. For an index that does not
    /// come from the file right now.
    pub fn fits(&self, size: u64) -> bool {
        let inside = |units: &[Unit]| {
            let sorted = units.is_sorted_by(|one, next| one.end() <= next.offset);
            let whole = |unit: &Unit| unit.offset >= MAGIC.len() as u64 && unit.end() <= size;
            sorted && units.iter().all(whole)
        };
        let ascending = |unit: &Unit| {
            let channels = unit.channels.as_deref().unwrap_or_default();
            channels.is_sorted_by(|one, next| one < next)
        };
        self.size == size
            && [&self.units, &self.attachments, &self.metadata]
                .into_iter()
                .all(|units| inside(units))
            && self.units.iter().all(ascending)
            && self.channels.iter().all(|(id, channel)| *id == channel.id)
    }

    /// Earliest and latest log time, ns; `None` where there are no messages.
    pub fn time_range(&self) -> Option<(i64, i64)> {
        let units = self.units.iter().filter(|unit| match &unit.channels {
            Some(channels) => !channels.is_empty(),
            None => unit.end_time != 0,
        });
        units
            .map(|unit| (unit.start_time, unit.end_time))
            .reduce(|(start, end), (from, to)| (start.min(from), end.max(to)))
    }

    /// Whether it has this schema or channel.
    ///
    /// # Errors
    /// In words, where it has another one of this number.
    pub(crate) fn has(&self, definition: &Definition) -> Result<bool, String> {
        let (kind, id, same) = match definition {
            Definition::Schema(id, schema) => {
                let known = self.schemas.get(id);
                ("schema", id, known.map(|known| **known == *schema))
            }
            Definition::Channel(channel) => {
                let known = self.channels.get(&channel.id);
                let same = known.map(|known| **known == *channel);
                ("channel", &channel.id, same)
            }
        };
        match same {
            Some(false) => Err(format!(
                "expected one definition of {kind} {id}, found two that differ"
            )),
            known => Ok(known.is_some()),
        }
    }

    /// The schema of a channel of this file; `None` where it has none.
    pub fn schema_of(&self, channel: &LogChannel) -> Option<&Arc<LogSchema>> {
        self.schemas.get(&channel.schema_id)
    }

    /// Whether a channel's messages are JSON of which no schema names the fields.
    pub fn is_untyped(&self, channel: &LogChannel) -> bool {
        let names_fields = |schema: &Arc<LogSchema>| {
            let data = &schema.data;
            let named = |word: &[u8]| word == PROPERTIES;
            data.len() > LONGEST_WITHOUT_FIELDS || data.windows(PROPERTIES.len()).any(named)
        };
        channel.message_encoding == "json" && !self.schema_of(channel).is_some_and(names_fields)
    }

    /// Number of messages, where it is known.
    pub fn message_count(&self) -> Option<u64> {
        self.counts.as_ref().map(|counts| counts.messages)
    }

    /// Number of messages of one channel, where it is known.
    pub fn channel_messages(&self, channel: u16) -> Option<u64> {
        let channels = self.counts.as_ref()?.channels.as_ref()?;
        Some(channels.get(&channel).copied().unwrap_or(0))
    }
}

/// Refuses what is no MCAP file, and says what to do instead.
async fn check_kind(store: &Arc<dyn ObjectStore>, meta: &ObjectMeta) -> Result<(), Fault> {
    let path = &meta.location;
    if meta.size == 0 {
        return Err(Fault::data("expected an MCAP log, found an empty file").at(path));
    }
    let head = super::window::fetch(store, meta, 0..meta.size.min(16)).await?;
    if head.starts_with(MAGIC) {
        return Ok(());
    }
    let fault = if head.starts_with(b"#ROSBAG V") {
        Fault::data("expected an MCAP log, found a ROS 1 bag")
            .next("convert it: mcap convert IN.bag OUT.mcap, or rosbags-convert --src IN.bag --dst OUT --dst-storage mcap")
    } else if head.starts_with(b"SQLite format 3") {
        Fault::data("expected an MCAP log, found a SQLite file, as rosbag2 writes (.db3)")
            .next("convert it: ros2 bag convert -i IN.db3 -o out.yaml with `storage_id: mcap` in out.yaml, or mcap convert IN.db3 OUT.mcap")
    } else if MAGIC.starts_with(&head) {
        Fault::data(format!(
            "expected an MCAP log, found only the first {} B of one",
            meta.size
        ))
    } else {
        let fault = Fault::data("expected an MCAP log, found a file that does not start like one");
        match path.extension() {
            Some("yaml" | "yml") => fault.next("a manifest is given with `--manifest FILE`"),
            _ => fault,
        }
    };
    Err(fault.at(path))
}
