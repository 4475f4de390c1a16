//! The conformance suite of the MCAP project: each file's records are exactly those that the JSON beside it lists.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::collections::BTreeMap;

use crate::common::{files, shared};
use bytes::Bytes;
use evermap_datasets::log::chunk::Block;
use evermap_datasets::log::record::{MAGIC, parse, split};
use mcap::records::{Record, op};
use serde_json::{Value, json};

fn bytes(data: &[u8]) -> Value {
    data.iter().map(|byte| byte.to_string()).collect()
}

fn map<K: ToString, V: ToString>(map: &BTreeMap<K, V>) -> Value {
    let entries = map
        .iter()
        .map(|(k, v)| (k.to_string(), Value::from(v.to_string())));
    Value::Object(entries.collect())
}

/// The fields of a record as the suite writes them; `None` for records that it leaves out.
fn fields(record: &Record<'_>) -> Option<(&'static str, Vec<(&'static str, Value)>)> {
    let text = |value: &dyn ToString| Value::from(value.to_string());
    Some(match record {
        Record::Header(r) => (
            "Header",
            vec![("library", text(&r.library)), ("profile", text(&r.profile))],
        ),
        Record::Footer(r) => (
            "Footer",
            vec![
                ("summary_crc", text(&r.summary_crc)),
                ("summary_offset_start", text(&r.summary_offset_start)),
                ("summary_start", text(&r.summary_start)),
            ],
        ),
        Record::Schema { header, data } => (
            "Schema",
            vec![
                ("data", bytes(data)),
                ("encoding", text(&header.encoding)),
                ("id", text(&header.id)),
                ("name", text(&header.name)),
            ],
        ),
        Record::Channel(r) => (
            "Channel",
            vec![
                ("id", text(&r.id)),
                ("message_encoding", text(&r.message_encoding)),
                ("metadata", map(&r.metadata)),
                ("schema_id", text(&r.schema_id)),
                ("topic", text(&r.topic)),
            ],
        ),
        Record::Message { header, data } => (
            "Message",
            vec![
                ("channel_id", text(&header.channel_id)),
                ("data", bytes(data)),
                ("log_time", text(&header.log_time)),
                ("publish_time", text(&header.publish_time)),
                ("sequence", text(&header.sequence)),
            ],
        ),
        Record::Attachment { header, data, .. } => (
            "Attachment",
            vec![
                ("create_time", text(&header.create_time)),
                ("data", bytes(data)),
                ("log_time", text(&header.log_time)),
                ("media_type", text(&header.media_type)),
                ("name", text(&header.name)),
            ],
        ),
        Record::AttachmentIndex(r) => (
            "AttachmentIndex",
            vec![
                ("create_time", text(&r.create_time)),
                ("data_size", text(&r.data_size)),
                ("length", text(&r.length)),
                ("log_time", text(&r.log_time)),
                ("media_type", text(&r.media_type)),
                ("name", text(&r.name)),
                ("offset", text(&r.offset)),
            ],
        ),
        Record::Metadata(r) => (
            "Metadata",
            vec![("metadata", map(&r.metadata)), ("name", text(&r.name))],
        ),
        Record::MetadataIndex(r) => (
            "MetadataIndex",
            vec![
                ("length", text(&r.length)),
                ("name", text(&r.name)),
                ("offset", text(&r.offset)),
            ],
        ),
        other => return summary_fields(other),
    })
}

fn summary_fields(record: &Record<'_>) -> Option<(&'static str, Vec<(&'static str, Value)>)> {
    let text = |value: &dyn ToString| Value::from(value.to_string());
    Some(match record {
        Record::ChunkIndex(r) => (
            "ChunkIndex",
            vec![
                ("chunk_length", text(&r.chunk_length)),
                ("chunk_start_offset", text(&r.chunk_start_offset)),
                ("compressed_size", text(&r.compressed_size)),
                ("compression", text(&r.compression)),
                ("message_end_time", text(&r.message_end_time)),
                ("message_index_length", text(&r.message_index_length)),
                ("message_index_offsets", map(&r.message_index_offsets)),
                ("message_start_time", text(&r.message_start_time)),
                ("uncompressed_size", text(&r.uncompressed_size)),
            ],
        ),
        Record::Statistics(r) => (
            "Statistics",
            vec![
                ("attachment_count", text(&r.attachment_count)),
                ("channel_count", text(&r.channel_count)),
                ("channel_message_counts", map(&r.channel_message_counts)),
                ("chunk_count", text(&r.chunk_count)),
                ("message_count", text(&r.message_count)),
                ("message_end_time", text(&r.message_end_time)),
                ("message_start_time", text(&r.message_start_time)),
                ("metadata_count", text(&r.metadata_count)),
                ("schema_count", text(&r.schema_count)),
            ],
        ),
        Record::SummaryOffset(r) => (
            "SummaryOffset",
            vec![
                ("group_length", text(&r.group_length)),
                ("group_opcode", text(&r.group_opcode)),
                ("group_start", text(&r.group_start)),
            ],
        ),
        Record::DataEnd(r) => (
            "DataEnd",
            vec![("data_section_crc", text(&r.data_section_crc))],
        ),
        // The suite lists the contents of chunks instead of chunks.
        _ => return None,
    })
}

/// Visits every record of a log in order, those of a chunk after the chunk itself. Returns the number of bytes behind
/// the last complete record; 8, the closing magic, in a log that is whole.
fn each_record(log: &Bytes, mut visit: impl FnMut(Result<Record<'_>, String>)) -> usize {
    let mut offset = MAGIC.len();
    while let Some((opcode, body, used)) = split(&log[offset..]).filter(|record| record.0 != 0) {
        visit(parse(opcode, body));
        if opcode == op::CHUNK {
            let chunk = log.slice(offset..offset + used);
            let block = Block::open(&chunk, offset as u64).unwrap();
            let records = block.records();
            records.for_each(|(opcode, _, body)| visit(parse(opcode, body)));
        }
        offset += used;
    }
    log.len() - offset
}

#[test]
fn all_files_read_to_the_records_that_their_json_expects() {
    let Some(folder) = shared("data/mcap_conformance") else {
        return;
    };
    let logs = files(&folder, "mcap");
    assert_eq!(logs.len(), 416);
    for log in logs {
        let text = std::fs::read_to_string(log.with_extension("json")).unwrap();
        let expected: Value = serde_json::from_str(&text).unwrap();
        let bytes = Bytes::from(std::fs::read(&log).unwrap());
        let mut found = Vec::new();
        let rest = each_record(&bytes, |record| {
            let record = record.unwrap_or_else(|e| panic!("{}: {e}", log.display()));
            if let Some((name, fields)) = fields(&record) {
                found.push(json!({ "type": name, "fields": fields }));
            }
        });
        assert_eq!(rest, 8, "{}", log.display());
        assert_eq!(Value::from(found), expected["records"], "{}", log.display());
    }
}
