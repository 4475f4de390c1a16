//! The tables that are known once the indexes are read: `sessions` and `channels`.

use std::sync::Arc;

use arrow::array::{
    ArrayRef, BinaryBuilder, ListBuilder, RecordBatch, StringBuilder, TimestampNanosecondBuilder,
    UInt32Builder, UInt64Builder,
};
use arrow::datatypes::{DataType, Field, Schema};
use datafusion::catalog::TableProvider;
use datafusion::datasource::MemTable;
use evermap_schemas::Fault;

use crate::scan::{append_map, fault_of, text_map_builder, text_map_type, timestamp};
use crate::session::Session;

fn table(fields: Vec<Field>, columns: Vec<ArrayRef>) -> Result<Arc<dyn TableProvider>, Fault> {
    let schema = Arc::new(Schema::new(fields));
    let batch = RecordBatch::try_new(schema.clone(), columns)?;
    let table = MemTable::try_new(schema, vec![vec![batch]]).map_err(|e| fault_of(&e))?;
    Ok(Arc::new(table))
}

/// One row per session: `session, site, files, bytes, start_time, end_time, messages`. Times are those of the first
/// and last message, null where there is none; `messages` is null where a file's index does not say it.
pub(crate) fn sessions(sessions: &[Session]) -> Result<Arc<dyn TableProvider>, Fault> {
    let mut names = StringBuilder::new();
    let mut sites = StringBuilder::new();
    let mut files = ListBuilder::new(StringBuilder::new());
    let mut bytes = UInt64Builder::new();
    let mut starts = TimestampNanosecondBuilder::new().with_timezone("UTC");
    let mut ends = TimestampNanosecondBuilder::new().with_timezone("UTC");
    let mut messages = UInt64Builder::new();
    for session in sessions {
        let parts = &session.parts;
        names.append_value(&session.name);
        sites.append_value(&session.site);
        parts
            .iter()
            .for_each(|part| files.values().append_value(&part.url));
        files.append(true);
        bytes.append_value(parts.iter().map(|part| part.meta.size).sum());
        let ranges = || parts.iter().filter_map(|part| part.index.time_range());
        starts.append_option(ranges().map(|(start, _)| start).min());
        ends.append_option(ranges().map(|(_, end)| end).max());
        messages.append_option(parts.iter().map(|part| part.index.message_count()).sum());
    }
    let files: ArrayRef = Arc::new(files.finish());
    table(
        vec![
            Field::new("session", DataType::Utf8, false),
            Field::new("site", DataType::Utf8, false),
            Field::new("files", files.data_type().clone(), false),
            Field::new("bytes", DataType::UInt64, false),
            Field::new("start_time", timestamp(), true),
            Field::new("end_time", timestamp(), true),
            Field::new("messages", DataType::UInt64, true),
        ],
        vec![
            Arc::new(names.finish()),
            Arc::new(sites.finish()),
            files,
            Arc::new(bytes.finish()),
            Arc::new(starts.finish()),
            Arc::new(ends.finish()),
            Arc::new(messages.finish()),
        ],
    )
}

/// One row per channel of each file: `session, part, channel, topic, message_encoding, schema_name, schema_encoding,
/// schema, messages, refused, metadata`. `refused` says why the payloads cannot be decoded, and is null where they can.
pub(crate) fn channels(sessions: &[Session]) -> Result<Arc<dyn TableProvider>, Fault> {
    let mut texts: [StringBuilder; 6] = Default::default();
    let mut parts = UInt32Builder::new();
    let mut ids = UInt32Builder::new();
    let mut schemas = BinaryBuilder::new();
    let mut messages = UInt64Builder::new();
    let mut metadata = text_map_builder();
    for part in sessions.iter().flat_map(|session| &session.parts) {
        for channel in part.index.channels.values() {
            let schema = channel.schema.as_deref();
            let [session, topic, encoding, name, schema_encoding, refused] = &mut texts;
            session.append_value(&part.session);
            parts.append_value(part.part);
            ids.append_value(u32::from(channel.id));
            topic.append_value(&channel.topic);
            encoding.append_value(&channel.message_encoding);
            name.append_option(schema.map(|schema| &schema.name));
            schema_encoding.append_option(schema.map(|schema| &schema.encoding));
            schemas.append_option(schema.map(|schema| &schema.data));
            messages.append_option(part.index.channel_messages(channel.id));
            let error = part.message_type(channel.id).and_then(|t| t.as_ref().err());
            refused.append_option(error.map(ToString::to_string));
            append_map(&mut metadata, &channel.metadata)?;
        }
    }
    let [session, topic, encoding, name, schema_encoding, refused] = &mut texts;
    table(
        vec![
            Field::new("session", DataType::Utf8, false),
            Field::new("part", DataType::UInt32, false),
            Field::new("channel", DataType::UInt32, false),
            Field::new("topic", DataType::Utf8, false),
            Field::new("message_encoding", DataType::Utf8, false),
            Field::new("schema_name", DataType::Utf8, true),
            Field::new("schema_encoding", DataType::Utf8, true),
            Field::new("schema", DataType::Binary, true),
            Field::new("messages", DataType::UInt64, true),
            Field::new("refused", DataType::Utf8, true),
            Field::new("metadata", text_map_type(), false),
        ],
        vec![
            Arc::new(session.finish()),
            Arc::new(parts.finish()),
            Arc::new(ids.finish()),
            Arc::new(topic.finish()),
            Arc::new(encoding.finish()),
            Arc::new(name.finish()),
            Arc::new(schema_encoding.finish()),
            Arc::new(schemas.finish()),
            Arc::new(messages.finish()),
            Arc::new(refused.finish()),
            Arc::new(metadata.finish()),
        ],
    )
}
