//! What could not be read, counted.
//!
//! A robot log is often torn: the battery died, the disk filled, a cable flipped a bit. Such logs are read as far as
//! they are sound, and what is missing is counted here, by reason. A program that ends with a ledger that is not
//! empty has *finished with loss*.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry::{Occupied, Vacant};
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};

/// Why something was lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Reason {
    /// The log ends without its end record: the recorder did not finish, or the tail was cut off. Counted once per
    /// file; the bytes are those of the incomplete records at the end.
    Torn,
    /// The file goes on with bytes that are no MCAP record; nothing behind them can be found without an index.
    BadRecord,
    /// A chunk whose contents do not match their checksum.
    BadChecksum,
    /// A chunk that cannot be decompressed.
    BadCompression,
    /// The index names a chunk where there is none.
    BadIndex,
    /// Messages whose channel is described nowhere in the file.
    UnknownChannel,
    /// A message whose payload does not fit its schema.
    Undecodable,
    /// A message that fits its schema but makes no sense: a quaternion of length 0, a pose that is not a number.
    Senseless,
    /// An attachment or metadata record that does not match its checksum, or cannot be parsed.
    BadAttachment,
    /// The summary leaves out what the file holds, or holds what the file does not.
    BadSummary,
    /// Messages of a topic that cannot be decoded, as its schema is unsound or nobody knows its language.
    BadSchema,
    /// Definitions or places of records beyond what an index has room for; what lies behind is not read.
    NoRoom,
    /// A file that is no log at all, or cannot be read, among others that are.
    Unreadable,
    /// A frame that is fixed in two ways: to two frames, or at two places. The latest holds.
    Contradiction,
    /// Frames that are fixed to each other in a circle, and so nowhere.
    Circle,
    /// A topic of transforms that is read for the vehicle's, and moves none.
    NoVehicle,
    /// What lies before a log's end record does not match the checksum there, and no chunk says where: it is read as it is.
    BadData,
    /// Messages with a transform that moves the vehicle in another frame than the one that odometry is read in.
    OtherParent,
    /// Entries of a metadata record that plays a role and whose values make no sense, such as a class of a pixel value that
    /// there is not.
    BadEntry,
    /// A camera whose messages name the frame of another one with pictures, and do not say where it stands beside that one:
    /// neither its images nor its calibrations are read.
    SameCamera,
}

impl Reason {
    /// What was lost, in the plural, for a sentence that starts with a number.
    pub fn text(self) -> &'static str {
        match self {
            Reason::Torn => "logs without an end",
            Reason::BadRecord => "records that are cut or out of place",
            Reason::BadChecksum => "chunks with a wrong checksum",
            Reason::BadCompression => "chunks that do not decompress",
            Reason::BadIndex => "chunks that are not where the index says",
            Reason::UnknownChannel => "messages of channels without a description",
            Reason::Undecodable => "messages that do not fit their schema",
            Reason::Senseless => "messages with invalid values",
            Reason::BadAttachment => "damaged attachments or metadata",
            Reason::BadSummary => "summaries that contradict their file",
            Reason::BadSchema => "messages of topics that cannot be decoded",
            Reason::NoRoom => "logs with more definitions and records than an index holds",
            Reason::Unreadable => "files that cannot be read",
            Reason::Contradiction => "frames with contradicting fixed transforms",
            Reason::Circle => "circles of fixed transforms",
            Reason::NoVehicle => "topics of transforms that move no vehicle",
            Reason::BadData => "logs with a wrong checksum of their data",
            Reason::OtherParent => "transforms that move the vehicle in another frame",
            Reason::BadEntry => "entries of metadata with invalid values",
            Reason::SameCamera => "cameras that name the frame of another one",
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

/// How much was lost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Loss {
    /// Things lost; what kind of thing the [`Reason`] says.
    pub count: u64,
    /// Bytes of the file that were not used.
    pub bytes: u64,
}

impl Loss {
    /// One thing of so many bytes.
    pub fn one(bytes: u64) -> Self {
        Self { count: 1, bytes }
    }

    /// One more, of so many bytes, where there is one.
    pub(crate) fn add(&mut self, bytes: Option<u64>) {
        if let Some(bytes) = bytes {
            self.join(Self::one(bytes));
        }
    }

    /// These too.
    pub(crate) fn join(&mut self, more: Self) {
        self.count = self.count.saturating_add(more.count);
        self.bytes = self.bytes.saturating_add(more.bytes);
    }
}

/// One line of the ledger: all losses of one kind at one place of one file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// Location of the file.
    pub file: Arc<str>,
    /// Why.
    pub reason: Reason,
    /// Topic, where the loss concerns only one; else empty.
    pub topic: String,
    /// Byte offset in the file of the record that was lost or that held what was lost.
    pub offset: u64,
    /// How much.
    pub loss: Loss,
    /// One example of what went wrong, in words.
    pub detail: String,
}

impl fmt::Display for Entry {
    /// `drive.mcap: messages with invalid values on /odom: expected a finite number at pose.position.x`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.file, self.reason)?;
        if !self.topic.is_empty() {
            write!(f, " on {}", self.topic)?;
        }
        match self.detail.is_empty() {
            true => Ok(()),
            false => write!(f, ": {}", self.detail),
        }
    }
}

type Key = (Arc<str>, Reason, String, u64);

/// Places that are told apart. Losses at further places are summed up by file, reason and topic.
const MAX_PLACES: usize = 10_000;

/// Bytes of the names of topics, and of words, of places that are told apart: a log may give a topic a name of a megabyte.
const MAX_TEXT_BYTES: usize = 8 << 20;

/// Characters of a line that a person is told.
const MAX_LINE: usize = 1000;

/// Topics that a person is told by name, of one file and for one reason.
const MAX_TOPICS: usize = 16;

/// The place that stands for all further ones.
const ELSEWHERE: u64 = u64::MAX;

/// The losses of a dataset, shared by all that read it.
///
/// Entries are keyed by place, so a chunk that is read twice is lost once, and the sums do not depend on how a scan
/// was partitioned.
#[derive(Debug, Clone, Default)]
pub struct LossLedger {
    places: Arc<Mutex<Places>>,
}

#[derive(Debug, Default)]
struct Places {
    entries: BTreeMap<Key, Entry>,
    /// Bytes of their texts.
    text_bytes: usize,
}

impl Places {
    /// Whether one more of such texts is told apart from the others.
    fn have_room_for(&self, entry: &Entry) -> bool {
        self.entries.len() < MAX_PLACES && self.text_bytes + text_bytes(entry) <= MAX_TEXT_BYTES
    }
}

/// Bytes of the texts of an entry and its key.
fn text_bytes(entry: &Entry) -> usize {
    2 * entry.topic.len() + entry.detail.len()
}

impl LossLedger {
    /// An empty ledger.
    pub fn new() -> Self {
        Self::default()
    }

    fn lock(&self) -> MutexGuard<'_, Places> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a loss. A second note about the same place keeps the larger numbers, and the words that came with them. (Of more
    /// than 10,000 places that are damaged, or of 8 MiB of texts about them, the sums say how much at least was lost: what is
    /// read twice may count twice.)
    pub fn note(&self, entry: Entry) {
        let (file, topic) = (entry.file.clone(), entry.topic.clone());
        let mut key = (file, entry.reason, topic, entry.offset);
        let Loss { count, bytes } = entry.loss;
        let mut places = self.lock();
        let places = &mut *places;
        if !places.have_room_for(&entry) && !places.entries.contains_key(&key) {
            key.3 = ELSEWHERE;
            if let Some(known) = places.entries.get_mut(&key) {
                known.loss.join(entry.loss);
                return;
            }
        }
        match places.entries.entry(key) {
            Vacant(place) => {
                places.text_bytes += text_bytes(&entry);
                place.insert(entry);
            }
            Occupied(known) => {
                let known = known.into_mut();
                if count > known.loss.count {
                    places.text_bytes += entry.detail.len();
                    places.text_bytes -= known.detail.len();
                    known.detail = entry.detail;
                }
                known.loss.count = known.loss.count.max(count);
                known.loss.bytes = known.loss.bytes.max(bytes);
            }
        }
    }

    /// Whether nothing was lost.
    pub fn is_empty(&self) -> bool {
        self.lock().entries.is_empty()
    }

    /// Every entry, ordered by file, reason, topic and offset.
    pub fn entries(&self) -> Vec<Entry> {
        self.lock().entries.values().cloned().collect()
    }

    /// Sums by reason.
    pub fn losses(&self) -> BTreeMap<Reason, Loss> {
        let mut sums = BTreeMap::<Reason, Loss>::new();
        for entry in self.lock().entries.values() {
            sums.entry(entry.reason).or_default().join(entry.loss);
        }
        sums
    }

    /// Sums as a person is told of them: by file, reason and topic, each with its first example.
    pub fn told(&self) -> BTreeMap<String, u64> {
        let mut told = BTreeMap::new();
        let entries = self.entries();
        for entries in entries.chunk_by(|a, b| a.file == b.file && a.reason == b.reason) {
            let topics = entries.chunk_by(|a, b| a.topic == b.topic);
            for (at, entries) in topics.enumerate() {
                let line = match at < MAX_TOPICS {
                    true => entries[0].to_string(),
                    false => format!("{}: {} on other topics", entries[0].file, entries[0].reason),
                };
                let counts = entries.iter().map(|entry| entry.loss.count);
                let sum = told.entry(shortened(line)).or_insert(0_u64);
                *sum = counts.fold(*sum, u64::saturating_add);
            }
        }
        told
    }

    /// One line per reason, for a report: `3 chunks with a wrong checksum (120 B)`.
    pub fn lines(&self) -> Vec<String> {
        self.losses()
            .iter()
            .map(|(reason, loss)| match loss.bytes {
                0 => format!("{} {reason}", loss.count),
                bytes => format!("{} {reason} ({bytes} B)", loss.count),
            })
            .collect()
    }

    /// The ledger, as seen while reading one file.
    pub fn of_file(&self, file: impl Into<Arc<str>>) -> FileLosses {
        FileLosses {
            ledger: self.clone(),
            file: file.into(),
        }
    }
}

/// A line, cut where it is long.
fn shortened(line: String) -> String {
    match line.char_indices().nth(MAX_LINE) {
        None => line,
        Some((end, _)) => format!("{}…", &line[..end]),
    }
}

/// A ledger with the file filled in.
#[derive(Debug, Clone)]
pub struct FileLosses {
    ledger: LossLedger,
    file: Arc<str>,
}

impl FileLosses {
    /// Notes a loss at a byte offset of this file.
    pub fn note(&self, reason: Reason, offset: u64, loss: Loss, detail: impl Into<String>) {
        self.note_topic(reason, "", offset, loss, detail);
    }

    /// Notes a loss that concerns only one topic.
    pub fn note_topic(
        &self,
        reason: Reason,
        topic: &str,
        offset: u64,
        loss: Loss,
        detail: impl Into<String>,
    ) {
        self.ledger.note(Entry {
            file: self.file.clone(),
            reason,
            topic: topic.to_owned(),
            offset,
            loss,
            detail: detail.into(),
        });
    }

    /// Notes what was noted elsewhere, about this file.
    pub(crate) fn note_again(&self, entry: &Entry) {
        self.ledger.note(Entry {
            file: self.file.clone(),
            ..entry.clone()
        });
    }
}

#[cfg(test)]
mod tests;
