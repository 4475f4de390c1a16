//! Sessions: one drive each, one MCAP file or the ordered parts of a split recording.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, OnceLock};

use datafusion::execution::object_store::ObjectStoreUrl;
use evermap_messages::{MessageType, SchemaError};
use evermap_schemas::Fault;
use futures::StreamExt;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt};

use crate::log::index::{LogChannel, LogIndex};
use crate::log::window::store_fault;
use crate::losses::{FileLosses, LossLedger};
use crate::manifest::Roles;
use crate::stores::LogFile;

/// Site of a session whose manifest names none.
pub const DEFAULT_SITE: &str = "default";

/// One drive.
#[derive(Debug, Clone)]
pub struct Session {
    /// Name, unique within a dataset.
    pub name: Arc<str>,
    /// Site that was driven.
    pub site: Arc<str>,
    /// Its files, in time order. Part `i` of an image reference is `parts[i]`.
    pub parts: Vec<Arc<LogPart>>,
    /// Which of its topics play which part.
    pub roles: Roles,
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

    /// The digest of its bytes: BLAKE3 over the contents of its files in order, each preceded by its length.
    ///
    /// # Errors
    /// A resource fault when a file cannot be read.
    pub async fn fingerprint(&self) -> Result<blake3::Hash, Fault> {
        let mut hasher = blake3::Hasher::new();
        for part in &self.parts {
            hasher.update(&part.meta.size.to_le_bytes());
            let object = part.store.get(&part.meta.location).await;
            let object = object.map_err(|error| store_fault(&error).at(&part.url))?;
            let mut stream = object.into_stream();
            while let Some(bytes) = stream.next().await {
                let bytes = bytes.map_err(|error| store_fault(&error).at(&part.url))?;
                hasher.update(&bytes);
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
    types: OnceLock<ChannelTypes>,
}

type ChannelTypes = BTreeMap<u16, Result<MessageType, SchemaError>>;

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
            types: OnceLock::new(),
        })
    }

    /// Whether it has messages of one of these topics.
    pub(crate) fn has_any(&self, topics: &[String]) -> bool {
        let mut channels = self.index.channels.values();
        channels.any(|channel| topics.contains(&channel.topic))
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
        let types = self.types.get_or_init(|| {
            let channels = self.index.channels.values();
            channels
                .map(|channel| (channel.id, message_type(channel)))
                .collect()
        });
        types.get(&channel)
    }
}

fn message_type(channel: &LogChannel) -> Result<MessageType, SchemaError> {
    match &channel.schema {
        Some(schema) => MessageType::parse(
            &channel.message_encoding,
            &schema.encoding,
            &schema.name,
            &schema.data,
        ),
        None => MessageType::parse(&channel.message_encoding, "", "", &[]),
    }
}

/// A file's name without its last extension.
pub(crate) fn stem(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, _)) if !stem.is_empty() => stem,
        _ => name,
    }
}
