//! Sessions: one drive each, one MCAP file or the ordered parts of a split recording.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use arrow::datatypes::{DataType, FieldRef, Fields};
use datafusion::execution::object_store::ObjectStoreUrl;
use evermap_messages::{MessageType, SchemaError};
use evermap_schemas::Fault;
use evermap_schemas::roles::UNTYPED;
use futures::StreamExt;
use object_store::{ObjectMeta, ObjectStore};

use crate::fault::{changed, store_fault};
use crate::log::checksum::Checksum;
use crate::log::definition::LogChannel;
use crate::log::index::{DataSum, LogIndex};
use crate::log::tally::Tally;
use crate::log::window::get;
use crate::losses::{Entry, FileLosses, Loss, LossLedger, Reason};
use crate::manifest::{Roles, TopicBits, Vehicle};
use crate::stores::LogFile;

/// One drive.
#[derive(Debug, Clone)]
pub struct Session {
    /// Name, unique within a dataset.
    pub name: Arc<str>,
    /// Site that was driven: its own name where nobody says one.
    pub site: Arc<str>,
    /// Its files, in time order. Part `i` of an image reference is `parts[i]`.
    pub parts: Vec<Arc<LogPart>>,
    /// Which of its topics play which part.
    pub roles: Roles,
    /// Bits of samples of raw images by topic of pictures, where the manifest says them.
    pub bits: TopicBits,
    /// The vehicle, as far as the manifest names it and rows depend on it.
    pub vehicle: Vehicle,
}

impl Session {
    /// Topics of all parts, ascending.
    pub fn topics(&self) -> BTreeSet<String> {
        self.parts
            .iter()
            .flat_map(|part| part.index.channels.values())
            .map(|channel| channel.topic.clone())
            .collect()
    }

    /// Earliest and latest log time, ns; `None` where there are no messages.
    pub fn time_range(&self) -> Option<(i64, i64)> {
        let ranges = self.parts.iter().filter_map(|part| part.index.time_range());
        ranges.reduce(|(start, end), (from, to)| (start.min(from), end.max(to)))
    }

    /// The roles that topics with messages play.
    pub fn played(&self) -> BTreeSet<String> {
        let roles = self.roles.to_manifest().into_keys();
        let played = |role: &String| {
            let mut topics = self.roles.topics(role).iter();
            topics.any(|topic| !self.is_silent(topic))
        };
        roles.filter(played).collect()
    }

    /// Whether a topic is known to have no message.
    pub fn is_silent(&self, topic: &str) -> bool {
        self.parts.iter().all(|part| {
            let messages = |channel: &Arc<LogChannel>| part.index.channel_messages(channel.id);
            part.channels_of(topic)
                .all(|channel| messages(channel) == Some(0))
        })
    }

    /// What keeps a topic from playing a role: any, or those that are read by fields.
    pub fn unfit(&self, topic: &str) -> Option<&'static str> {
        let untyped = || {
            self.parts.iter().any(|part| {
                let mut channels = part.channels_of(topic);
                channels.any(|channel| part.index.is_untyped(channel))
            })
        };
        match self.is_silent(topic) {
            true => Some("no messages"),
            false => untyped().then_some(UNTYPED),
        }
    }

    /// Message types of its topics, as their logs spell them.
    pub fn message_types(&self) -> BTreeMap<String, String> {
        let typed = self.parts.iter().flat_map(|part| {
            part.index.channels.values().map(|channel| {
                let schema = part.index.schema_of(channel);
                let name =
                    schema.map_or_else(|| "no schema".to_owned(), |found| found.name.clone());
                (channel.topic.clone(), name)
            })
        });
        typed.collect()
    }

    /// The digest of its bytes: BLAKE3 over the contents of its files in order, each preceded by its length. Of a file that
    /// grows it is that of as much as there was when it was opened. `read` counts the bytes as they come. Of files whose
    /// checksum of all data nobody has compared, it is.
    ///
    /// # Errors
    /// A resource fault when a file cannot be read, or is shorter than it was.
    pub async fn fingerprint(&self, read: &AtomicU64) -> Result<blake3::Hash, Fault> {
        let mut hasher = blake3::Hasher::new();
        for part in &self.parts {
            hasher.update(&part.meta.size.to_le_bytes());
            let object = get(&part.store, &part.meta, 0..part.meta.size).await;
            let object = object.map_err(|error| store_fault(&error).at(&part.url))?;
            let (mut stream, mut missing) = (object.into_stream(), part.meta.size);
            let mut sum = part.index.sum.map(|sum| (sum, Checksum::default()));
            while let Some(bytes) = stream.next().await {
                let bytes = bytes.map_err(|error| store_fault(&error).at(&part.url))?;
                hasher.update(&bytes);
                if let Some((sum, checksum)) = &mut sum {
                    let left = sum.bytes.saturating_sub(checksum.hashed());
                    checksum.add(&bytes[..bytes.len().min(left as usize)]);
                }
                read.fetch_add(bytes.len() as u64, Ordering::Relaxed);
                missing = missing.saturating_sub(bytes.len() as u64);
            }
            if missing > 0 {
                return Err(changed().at(&part.url));
            }
            if let Some((sum, checksum)) = sum {
                part.compare(&sum, checksum.finish());
            }
        }
        Ok(hasher.finalize())
    }
}

/// One file of a session, with its index.
pub struct LogPart {
    /// Session that it belongs to.
    pub session: Arc<str>,
    /// Site of the session.
    pub site: Arc<str>,
    /// Which of the session's files it is, counted from 0.
    pub part: u32,
    /// Where it is, for people.
    pub url: String,
    /// Store that holds it.
    pub store: Arc<dyn ObjectStore>,
    /// The store's name in DataFusion's registry.
    pub store_url: ObjectStoreUrl,
    /// Path and size in the store.
    pub meta: ObjectMeta,
    /// What it holds and where.
    pub index: LogIndex,
    /// Where its losses are noted.
    pub losses: FileLosses,
    /// What was read of it by now, in messages.
    pub(crate) tally: Tally,
    /// What comparing the checksum of all data came to, once that was done.
    compared: OnceLock<Option<Entry>>,
    /// Channels by topic.
    topics: BTreeMap<String, Vec<u16>>,
    /// Message types by channel: one for those that share a schema.
    types: BTreeMap<u16, Arc<OnceLock<Result<MessageType, SchemaError>>>>,
    /// Columns that further message types may have.
    columns_left: AtomicUsize,
}

/// Columns that all message types of a log may have together: a thousand types of two hundred each.
const LOG_COLUMNS: usize = 200_000;

impl std::fmt::Debug for LogPart {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LogPart")
            .field("session", &self.session)
            .field("part", &self.part)
            .field("url", &self.url)
            .finish_non_exhaustive()
    }
}

impl LogPart {
    /// Opens a part of a session, with the index that is known or else the file's own.
    ///
    /// # Errors
    /// As [`LogIndex::read`].
    pub(crate) async fn open(
        file: LogFile,
        session: Arc<str>,
        site: Arc<str>,
        ledger: &LossLedger,
    ) -> Result<Self, Fault> {
        if let Some(fault) = file.refused {
            return Err(fault);
        }
        let url = file.url();
        let known = file.index.filter(|index| index.fits(file.meta.size));
        let index = match known {
            Some(index) => index,
            None => LogIndex::read(&file.store, &file.meta)
                .await
                .map_err(|mut fault| {
                    if fault.place == file.meta.location.as_ref() {
                        fault.place.clone_from(&url);
                    }
                    fault
                })?,
        };
        let losses = ledger.of_file(url.as_str());
        index.losses.iter().for_each(|lost| losses.note_again(lost));
        let mut topics = BTreeMap::<String, Vec<u16>>::new();
        let mut types = BTreeMap::new();
        let mut shared = BTreeMap::<_, Arc<OnceLock<_>>>::new();
        for channel in index.channels.values() {
            let of_topic = topics.entry(channel.topic.clone()).or_default();
            of_topic.push(channel.id);
            let schema = index.schema_of(channel).map(Arc::as_ptr);
            let key = (channel.message_encoding.as_str(), schema);
            types.insert(channel.id, shared.entry(key).or_default().clone());
        }
        Ok(Self {
            session,
            site,
            part: 0,
            url,
            store: file.store,
            store_url: file.store_url,
            meta: file.meta,
            index,
            losses,
            tally: Tally::default(),
            compared: OnceLock::new(),
            topics,
            types,
            columns_left: AtomicUsize::new(LOG_COLUMNS),
        })
    }

    /// Compares the checksum of all data with that of the bytes that were read, and notes that it is another one.
    fn compare(&self, sum: &DataSum, found: u32) {
        let mismatch = sum.mismatch(found).map(|detail| Entry {
            file: self.meta.location.to_string().into(),
            reason: Reason::BadData,
            topic: String::new(),
            offset: sum.bytes,
            loss: Loss::one(0),
            detail,
        });
        if let Some(entry) = &mismatch {
            self.losses.note_again(entry);
        }
        // Who was first found the same.
        let _ = self.compared.set(mismatch);
    }

    /// Its index, with what was found since by who read all of it.
    pub fn index_since(&self) -> LogIndex {
        let mut index = self.index.clone();
        if let Some(compared) = self.compared.get() {
            index.sum = None;
            index.losses.extend(compared.clone());
        }
        index
    }

    /// Channels of a topic.
    pub fn channels_of(&self, topic: &str) -> impl Iterator<Item = &Arc<LogChannel>> {
        let channels = self.topics.get(topic).into_iter().flatten();
        channels.filter_map(|id| self.index.channels.get(id))
    }

    /// Whether it has messages of one of these topics.
    pub(crate) fn has_any(&self, topics: &[String]) -> bool {
        topics.iter().any(|topic| self.topics.contains_key(topic))
    }

    /// Reads the whole file, and notes what is damaged, and which schemas are unsound: what it really holds.
    ///
    /// # Errors
    /// A resource fault when the store fails.
    pub async fn survey(&self) -> Result<Cow<'_, LogIndex>, Fault> {
        let (store, meta) = (&self.store, &self.meta);
        let found = self.index.survey(store, meta, &self.losses).await?;
        for channel in self.index.channels.values() {
            if let Some(Err(error)) = self.message_type(channel.id)
                && !matches!(error, SchemaError::Unsupported { .. })
            {
                self.lose_topic(channel, error.to_string());
            }
        }
        Ok(found.map_or(Cow::Borrowed(&self.index), Cow::Owned))
    }

    /// Notes that the messages of a channel cannot be decoded.
    pub(crate) fn lose_topic(&self, channel: &LogChannel, why: String) {
        let count = self.index.channel_messages(channel.id).unwrap_or(1).max(1);
        let (topic, place) = (&channel.topic, u64::from(channel.id));
        let loss = Loss { count, bytes: 0 };
        let losses = &self.losses;
        losses.note_topic(Reason::BadSchema, topic, place, loss, why);
    }

    /// The columns of a topic's messages on one of its channels.
    ///
    /// # Errors
    /// A data fault with the topic when they cannot be decoded.
    pub(crate) fn decodable(&self, channel: &LogChannel) -> Result<&MessageType, Fault> {
        match self.message_type(channel.id) {
            Some(Ok(message_type)) => Ok(message_type),
            Some(Err(error)) => Err(Fault::data(error.to_string())
                .at(format!("topic {}", channel.topic))
                .at(&self.url)),
            None => Err(Fault::bug(format!(
                "channel {} is of another log",
                channel.id
            ))),
        }
    }

    /// The columns of a channel's messages, or why there are none. `None` for a channel that the log does not have.
    pub fn message_type(&self, channel: u16) -> Option<&Result<MessageType, SchemaError>> {
        let known = self.index.channels.get(&channel)?;
        let made = self.types.get(&channel)?;
        Some(made.get_or_init(|| self.make_type(known)))
    }

    fn make_type(&self, channel: &LogChannel) -> Result<MessageType, SchemaError> {
        let schema = self.index.schema_of(channel);
        let (encoding, name, data) = match schema {
            Some(schema) => (&*schema.encoding, &*schema.name, &*schema.data),
            None => ("", "", &[][..]),
        };
        let made = MessageType::parse(&channel.message_encoding, encoding, name, data)?;
        let columns = columns(made.fields());
        let left = |left: usize| left.checked_sub(columns);
        let order = Ordering::Relaxed;
        match self.columns_left.fetch_update(order, order, left) {
            Ok(_) => Ok(made),
            Err(_) => Err(SchemaError::Refused {
                schema: name.to_owned(),
                reason: format!(
                    "expected at most {LOG_COLUMNS} columns over all message types of a log, found more"
                ),
            }),
        }
    }
}

/// Columns and columns within them.
fn columns(fields: &Fields) -> usize {
    let within = |field: &FieldRef| match field.data_type() {
        DataType::Struct(fields) => columns(fields),
        DataType::List(item) | DataType::FixedSizeList(item, _) => match item.data_type() {
            DataType::Struct(fields) => columns(fields),
            _ => 0,
        },
        _ => 0,
    };
    fields.iter().map(|field| 1 + within(field)).sum()
}

/// A file's name without its last extension.
pub(crate) fn stem(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, _)) if !stem.is_empty() => stem,
        _ => name,
    }
}
