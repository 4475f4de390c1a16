//! The tables that are known once the indexes are read: `sessions` and `channels`.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::RecordBatch;
use datafusion::catalog::TableProvider;
use datafusion::datasource::MemTable;
use evermap_schemas::{Bytes, Fault, Record, Stamp, record};

use crate::fault::OrFault;
use crate::log::definition::LogChannel;
use crate::scan::{LazyTable, schema_of};
use crate::session::{LogPart, Session};

record! {
    /// One session.
    pub struct SessionRow {
        /// Name.
        session: String,
        /// Site that was driven.
        site: String,
        /// Its files, in time order.
        files: Vec<String>,
        /// Bytes of all files.
        bytes: u64,
        /// Log time of the first message; null where there is none.
        start_time: Option<Stamp>,
        /// Log time of the last message; null where there is none.
        end_time: Option<Stamp>,
        /// Number of messages; null where a file's index does not say it.
        messages: Option<u64>,
    }
}

record! {
    /// One channel of one file.
    pub struct ChannelRow {
        /// Session of the log.
        session: String,
        /// Which of the session's files, counted from 0 in time order.
        part: u32,
        /// Number of the channel in its file.
        channel: u32,
        /// Topic.
        topic: String,
        /// Encoding of the payloads.
        message_encoding: String,
        /// Name of the message type; null where the channel has no schema.
        schema_name: Option<String>,
        /// Encoding of the schema; null where there is none.
        schema_encoding: Option<String>,
        /// The schema; null where there is none.
        schema: Option<Bytes>,
        /// Number of messages; null where the file's index does not say it.
        messages: Option<u64>,
        /// Why the payloads cannot be decoded; null where they can.
        refused: Option<String>,
        /// Whatever the recorder noted.
        metadata: BTreeMap<String, String>,
    }
}

/// Names of the tables.
pub(crate) const NAMES: [&str; 2] = ["sessions", "channels"];

type NamedTable = (&'static str, Arc<dyn TableProvider>);

/// The tables, by name.
pub(crate) fn tables(sessions: &[Session]) -> [NamedTable; 2] {
    let [first, second] = NAMES;
    let sessions: Arc<[Session]> = sessions.into();
    let listed = sessions.clone();
    let rows = move || table(listed.iter().map(session_row).collect());
    let channels = move || {
        let parts = sessions.iter().flat_map(|session| &session.parts);
        let channels = parts.flat_map(|part| {
            let channels = part.index.channels.values();
            channels.map(|channel| channel_row(part, channel))
        });
        table(channels.collect())
    };
    [
        (first, Arc::new(LazyTable::new(rows))),
        (second, Arc::new(LazyTable::new(channels))),
    ]
}

fn table<T: Record>(rows: Vec<T>) -> Result<Arc<dyn TableProvider>, Fault> {
    let schema = schema_of(&T::columns());
    let batch = RecordBatch::try_new(schema.clone(), T::encode_columns(rows)?)?;
    let table = MemTable::try_new(schema, vec![vec![batch]]).or_fault()?;
    Ok(Arc::new(table))
}

fn session_row(session: &Session) -> SessionRow {
    let parts = &session.parts;
    let times = session.time_range();
    SessionRow {
        session: session.name.to_string(),
        site: session.site.to_string(),
        files: parts.iter().map(|part| part.url.clone()).collect(),
        bytes: parts.iter().map(|part| part.meta.size).sum(),
        start_time: times.map(|(start, _)| Stamp(start)),
        end_time: times.map(|(_, end)| Stamp(end)),
        messages: parts.iter().map(|part| part.index.message_count()).sum(),
    }
}

fn channel_row(part: &LogPart, channel: &LogChannel) -> ChannelRow {
    let schema = part.index.schema_of(channel);
    let refused = part.message_type(channel.id).and_then(|t| t.as_ref().err());
    ChannelRow {
        session: part.session.to_string(),
        part: part.part,
        channel: u32::from(channel.id),
        topic: channel.topic.clone(),
        message_encoding: channel.message_encoding.clone(),
        schema_name: schema.map(|schema| schema.name.clone()),
        schema_encoding: schema.map(|schema| schema.encoding.clone()),
        schema: schema.map(|schema| Bytes(schema.data.to_vec())),
        messages: part.index.channel_messages(channel.id),
        refused: refused.map(ToString::to_string),
        metadata: channel.metadata.clone(),
    }
}
