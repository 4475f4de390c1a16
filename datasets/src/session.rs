//! Sessions: one drive each, one MCAP file or the ordered parts of a split recording.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use datafusion::execution::object_store::ObjectStoreUrl;
use evermap_messages::{MessageType, SchemaError};
use evermap_schemas::Fault;
use object_store::{ObjectMeta, ObjectStore};

use crate::log::index::{LogChannel, LogIndex};
use crate::losses::{FileLosses, LossLedger};
use crate::manifest::Roles;

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
    pub fn topics(&self) -> std::collections::BTreeSet<String> {
        self.parts
            .iter()
            .flat_map(|part| part.index.channels.values())
            .map(|channel| channel.topic.clone())
            .collect()
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
    /// Reads the file's index. The session is named after the file until somebody says otherwise.
    ///
    /// # Errors
    /// As [`LogIndex::read`].
    pub async fn open(
        store: Arc<dyn ObjectStore>,
        store_url: ObjectStoreUrl,
        meta: ObjectMeta,
        ledger: &LossLedger,
    ) -> Result<Self, Fault> {
        let url = display_url(&store_url, &meta);
        let losses = ledger.of_file(url.as_str());
        let index = LogIndex::read(&store, &meta, &losses)
            .await
            .map_err(|mut fault| {
                if fault.place == meta.location.as_ref() {
                    fault.place.clone_from(&url);
                }
                fault
            })?;
        let stem = stem(meta.location.filename().unwrap_or_default());
        Ok(Self {
            session: stem.into(),
            site: DEFAULT_SITE.into(),
            part: 0,
            url,
            store,
            store_url,
            meta,
            index,
            losses,
            types: OnceLock::new(),
        })
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

fn display_url(store_url: &ObjectStoreUrl, meta: &ObjectMeta) -> String {
    match store_url.as_str() {
        "file:///" => format!("/{}", meta.location),
        url => format!("{}/{}", url.trim_end_matches('/'), meta.location),
    }
}
