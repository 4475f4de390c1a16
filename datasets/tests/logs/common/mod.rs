//! What the tests of this crate share: where the real logs are, how to open them, how to write small ones.
#![allow(dead_code, clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use arrow::array::RecordBatch;
use datafusion::prelude::{SessionConfig, SessionContext};
use evermap_datasets::Dataset;
use evermap_datasets::log::record::{FRAME, MAGIC, split};
use mcap::records::op;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use url::Url;

pub use evermap_test_data::shared;

/// All files below a folder with this extension, in order.
pub fn files(folder: &std::path::Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path, extension));
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
    found.sort();
    found
}

pub fn context(partitions: usize) -> SessionContext {
    let mut config = SessionConfig::new().with_target_partitions(partitions);
    config.options_mut().optimizer.repartition_file_min_size = 0;
    SessionContext::new_with_config(config)
}

pub async fn rows(context: &SessionContext, sql: &str) -> Vec<RecordBatch> {
    let frame = context
        .sql(sql)
        .await
        .unwrap_or_else(|e| panic!("{sql}: {e}"));
    frame
        .collect()
        .await
        .unwrap_or_else(|e| panic!("{sql}: {e}"))
}

pub async fn count(context: &SessionContext, sql: &str) -> usize {
    rows(context, sql)
        .await
        .iter()
        .map(RecordBatch::num_rows)
        .sum()
}

pub fn text(batches: &[RecordBatch]) -> String {
    arrow::util::pretty::pretty_format_batches(batches)
        .unwrap()
        .to_string()
}

/// A context and the dataset of some local files, registered.
pub async fn open(paths: &[String], partitions: usize) -> (SessionContext, Dataset) {
    let context = context(partitions);
    let dataset = Dataset::open(&context.runtime_env(), paths, None)
        .await
        .unwrap();
    dataset.register(&context).unwrap();
    (context, dataset)
}

/// A store in memory that holds `log.mcap`, under `memory://logs`.
pub async fn in_memory(bytes: &[u8]) -> Arc<dyn ObjectStore> {
    let store = InMemory::new();
    store
        .put(&Path::from("log.mcap"), bytes.to_vec().into())
        .await
        .unwrap();
    Arc::new(store)
}

/// Opens `memory://logs/log.mcap` in the given store.
pub async fn open_in(
    store: Arc<dyn ObjectStore>,
    partitions: usize,
) -> Result<(SessionContext, Dataset), evermap_schemas::Fault> {
    let context = context(partitions);
    let runtime = context.runtime_env();
    runtime.register_object_store(&Url::parse("memory://logs").unwrap(), store);
    let paths = ["memory://logs/log.mcap".to_owned()];
    let dataset = Dataset::open(&runtime, &paths, None).await?;
    dataset.register(&context)?;
    Ok((context, dataset))
}

/// How a small log is written.
pub struct Log {
    pub messages: u32,
    pub payload: usize,
    pub chunk: Option<u64>,
    pub compression: Option<mcap::Compression>,
    pub indexed: bool,
}

impl Default for Log {
    fn default() -> Self {
        Self {
            messages: 60,
            payload: 40,
            chunk: Some(512),
            compression: Some(mcap::Compression::Zstd),
            indexed: true,
        }
    }
}

impl Log {
    /// Messages of two topics in turn: `/text` (CDR strings) and `/blob` (CDR bytes), message `i` at `i` seconds.
    pub fn write(&self) -> Vec<u8> {
        let mut options = mcap::WriteOptions::new()
            .compression(self.compression)
            .use_chunks(self.chunk.is_some())
            .chunk_size(self.chunk);
        if !self.indexed {
            options = options
                .emit_summary_records(false)
                .emit_summary_offsets(false)
                .emit_message_indexes(false);
        }
        let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
        let text = writer
            .add_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
            .unwrap();
        let blob = writer
            .add_schema("test_msgs/msg/Blob", "ros2msg", b"uint8[] data\n")
            .unwrap();
        let none = BTreeMap::new();
        let text = writer.add_channel(text, "/text", "cdr", &none).unwrap();
        let blob = writer.add_channel(blob, "/blob", "cdr", &none).unwrap();
        for i in 0..self.messages {
            let (channel, data) = match i % 2 {
                0 => (text, cdr(format!("message {i:06}\0").as_bytes())),
                _ => (blob, cdr(&noise(i, self.payload))),
            };
            let time = u64::from(i) * 1_000_000_000;
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence: i,
                log_time: time,
                publish_time: time,
            };
            writer.write_to_known_channel(&header, &data).unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }
}

/// A CDR payload of one string or byte sequence.
pub fn cdr(bytes: &[u8]) -> Vec<u8> {
    let mut payload = vec![0, 1, 0, 0];
    payload.extend((bytes.len() as u32).to_le_bytes());
    payload.extend(bytes);
    payload
}

/// Bytes that do not compress.
fn noise(seed: u32, length: usize) -> Vec<u8> {
    let mut state = u64::from(seed) * 2 + 1;
    let mut next = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 56) as u8
    };
    (0..length).map(|_| next()).collect()
}

/// Bytes as a chunk of this compression has them: `zstd`, `lz4` or none.
pub fn packed(compression: &str, bytes: &[u8]) -> Vec<u8> {
    match compression {
        "zstd" => zstd::bulk::compress(bytes, 1).unwrap(),
        "lz4" => {
            let blocks =
                lz4_flex::frame::FrameInfo::new().block_size(lz4_flex::frame::BlockSize::Max64KB);
            let mut lz4 = lz4_flex::frame::FrameEncoder::with_frame_info(blocks, Vec::new());
            std::io::Write::write_all(&mut lz4, bytes).unwrap();
            lz4.finish().unwrap()
        }
        _ => bytes.to_vec(),
    }
}

/// The records of a log outside of chunks: opcode and place.
pub fn record_places(log: &[u8]) -> Vec<(u8, Range<usize>)> {
    let (mut at, mut found) = (MAGIC.len(), Vec::new());
    while let Some((opcode, _, used)) = log.get(at..).and_then(split) {
        found.push((opcode, at..at + used));
        at += used;
    }
    found
}

/// A log without one of its chunks and the indexes of its messages; nothing else is changed.
pub fn without_chunk(log: &[u8], which: usize) -> Vec<u8> {
    let places = record_places(log);
    let mut chunks = (0..places.len()).filter(|at| places[*at].0 == op::CHUNK);
    let chunk = chunks.nth(which).unwrap();
    let mut behind = places[chunk + 1..].iter();
    let behind = behind.find(|(opcode, _)| *opcode != op::MESSAGE_INDEX);
    let (start, end) = (places[chunk].1.start, behind.unwrap().1.start);
    [&log[..start], &log[end..]].concat()
}

/// Messages of a torn log that are complete: those of its whole records, and of a chunk that is cut as many as a plain
/// decoder of its compression gives.
pub fn complete_messages(log: &[u8]) -> usize {
    let (mut offset, mut messages) = (MAGIC.len(), 0);
    while let Some((opcode, body, used)) = log.get(offset..).and_then(split) {
        messages += match opcode {
            op::MESSAGE => 1,
            op::CHUNK => messages_of_chunk(body),
            _ => 0,
        };
        offset += used;
    }
    let cut = log.get(offset..).unwrap_or_default();
    match cut.split_at_checked(FRAME as usize) {
        Some((frame, body)) if frame[0] == op::CHUNK => messages + messages_of_chunk(body),
        _ => messages,
    }
}

/// Complete messages of a chunk's body, whose end may be missing.
fn messages_of_chunk(body: &[u8]) -> usize {
    // Two times, a size and a checksum.
    const BEFORE_NAME: usize = 8 + 8 + 8 + 4;
    let length = body.get(BEFORE_NAME..).and_then(|rest| rest.first_chunk());
    let Some(length) = length.map(|length| u32::from_le_bytes(*length) as usize) else {
        return 0;
    };
    let (start, end) = (BEFORE_NAME + 4, BEFORE_NAME + 4 + length);
    let (Some(name), Some(data)) = (body.get(start..end), body.get(end + 8..)) else {
        return 0;
    };
    let records = unpacked(name, data);
    let (mut rest, mut messages) = (&records[..], 0);
    while let Some((opcode, _, used)) = split(rest) {
        messages += usize::from(opcode == op::MESSAGE);
        rest = &rest[used..];
    }
    messages
}

/// What comes out of data before their decoder ends or fails.
fn unpacked(compression: &[u8], data: &[u8]) -> Vec<u8> {
    let mut decoder: Box<dyn Read + '_> = match compression {
        b"zstd" => Box::new(zstd::Decoder::new(data).unwrap()),
        b"lz4" => Box::new(lz4_flex::frame::FrameDecoder::new(data)),
        _ => Box::new(data),
    };
    let (mut found, mut some) = (Vec::new(), [0; 4096]);
    while let Ok(read @ 1..) = decoder.read(&mut some) {
        found.extend_from_slice(&some[..read]);
    }
    found
}

/// MCAP written by hand, so that it can say what no writer would.
pub mod by_hand {
    use evermap_datasets::log::record::MAGIC;

    /// A text or bytes behind their length.
    pub fn text(bytes: &[u8]) -> Vec<u8> {
        [&(bytes.len() as u32).to_le_bytes(), bytes].concat()
    }

    pub fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
        [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
    }

    pub fn schema(id: u16, name: &str, encoding: &str, data: &[u8]) -> Vec<u8> {
        let (name, encoding) = (text(name.as_bytes()), text(encoding.as_bytes()));
        record(
            3,
            &[&id.to_le_bytes()[..], &name, &encoding, &text(data)].concat(),
        )
    }

    pub fn channel(id: u16, schema: u16, topic: &str, encoding: &str) -> Vec<u8> {
        let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
        let (topic, encoding) = (text(topic.as_bytes()), text(encoding.as_bytes()));
        record(4, &[ids, topic, encoding, text(b"")].concat())
    }

    pub fn message(channel: u16, sequence: u32, data: &[u8]) -> Vec<u8> {
        message_at(channel, sequence, u64::from(sequence + 1), data)
    }

    pub fn message_at(channel: u16, sequence: u32, time: u64, data: &[u8]) -> Vec<u8> {
        let time = time.to_le_bytes();
        let (channel, sequence) = (channel.to_le_bytes(), sequence.to_le_bytes());
        record(5, &[&channel[..], &sequence, &time, &time, data].concat())
    }

    /// The schema of a foxglove.FrameTransform in JSON.
    pub fn transforms(id: u16) -> Vec<u8> {
        let number = serde_json::json!({"type": "number"});
        let numbers = |names: &[&str]| {
            let members = names
                .iter()
                .map(|name| ((*name).to_owned(), number.clone()));
            let members: serde_json::Map<_, _> = members.collect();
            serde_json::json!({"type": "object", "properties": members})
        };
        let fields = serde_json::json!({"type": "object", "properties": {
            "parent_frame_id": {"type": "string"},
            "child_frame_id": {"type": "string"},
            "translation": numbers(&["x", "y", "z"]),
            "rotation": numbers(&["x", "y", "z", "w"]),
        }});
        let fields = fields.to_string();
        schema(
            id,
            "foxglove.FrameTransform",
            "jsonschema",
            fields.as_bytes(),
        )
    }

    /// A message of [`transforms`] that a frame is so many metres along the x axis of another.
    pub fn transform(channel: u16, sequence: u32, [to, frame]: [&str; 2], x: f64) -> Vec<u8> {
        let said = serde_json::json!({
            "parent_frame_id": to,
            "child_frame_id": frame,
            "translation": {"x": x, "y": 0.0, "z": 0.0},
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        });
        message(channel, sequence, said.to_string().as_bytes())
    }

    /// A chunk that claims to hold `size` bytes.
    pub fn chunk(size: u64, compression: &str, data: &[u8]) -> Vec<u8> {
        checked_chunk(size, 0, compression, data)
    }

    /// As [`chunk`], with a checksum.
    pub fn checked_chunk(size: u64, crc: u32, compression: &str, data: &[u8]) -> Vec<u8> {
        let times = [1_u64.to_le_bytes(), 9_u64.to_le_bytes()].concat();
        let head = [&times[..], &size.to_le_bytes(), &crc.to_le_bytes()].concat();
        let packed = (data.len() as u64).to_le_bytes();
        let name = text(compression.as_bytes());
        record(6, &[&head[..], &name, &packed, data].concat())
    }

    /// The entry of the chunk at `offset` in an index, with the channels that it lists.
    pub fn chunk_index(offset: u64, length: u64, size: u64, listed: &[(u16, u64)]) -> Vec<u8> {
        chunk_index_of((1, 9), offset, length, size, listed)
    }

    /// As [`chunk_index`], of a chunk of messages of these times.
    pub fn chunk_index_of(
        times: (u64, u64),
        offset: u64,
        length: u64,
        size: u64,
        listed: &[(u16, u64)],
    ) -> Vec<u8> {
        let number = |n: u64| n.to_le_bytes().to_vec();
        let offsets: Vec<u8> = listed
            .iter()
            .flat_map(|(channel, _)| [channel.to_le_bytes().to_vec(), number(offset)].concat())
            .collect();
        let indexes: u64 = listed.iter().map(|(_, messages)| 15 + 16 * messages).sum();
        let parts = [
            number(times.0),
            number(times.1),
            number(offset),
            number(length),
            text(&offsets),
            number(indexes),
            text(b""),
            number(length),
            number(size),
        ];
        record(8, &parts.concat())
    }

    /// The index of a message of a chunk: so many entries of zeros.
    pub fn message_index(channel: u16, messages: usize) -> Vec<u8> {
        let entries = text(&vec![0; 16 * messages]);
        record(7, &[&channel.to_le_bytes()[..], &entries].concat())
    }

    /// Statistics of so many messages of these times, by channel.
    pub fn statistics(times: (u64, u64), channels: u32, counts: &[(u16, u64)]) -> Vec<u8> {
        let entry = |(id, n): &(u16, u64)| [&id.to_le_bytes()[..], &n.to_le_bytes()].concat();
        let messages: u64 = counts.iter().map(|(_, n)| n).sum();
        let counts: Vec<u8> = counts.iter().flat_map(entry).collect();
        let parts = [
            messages.to_le_bytes().to_vec(),
            vec![1, 0],
            channels.to_le_bytes().to_vec(),
            vec![0; 12],
            times.0.to_le_bytes().to_vec(),
            times.1.to_le_bytes().to_vec(),
            text(&counts),
        ];
        record(11, &parts.concat())
    }

    pub fn footer(summary_start: u64) -> Vec<u8> {
        record(2, &[&summary_start.to_le_bytes()[..], &[0; 12]].concat())
    }

    /// A file of these records, with a summary of those where there are any.
    pub fn file(records: &[Vec<u8>], summary: &[Vec<u8>]) -> Vec<u8> {
        let header = record(1, &[text(b""), text(b"by hand")].concat());
        let end = record(15, &[0; 4]);
        let data = [MAGIC.to_vec(), header, records.concat(), end].concat();
        let start = if summary.is_empty() {
            0
        } else {
            data.len() as u64
        };
        [data, summary.concat(), footer(start), MAGIC.to_vec()].concat()
    }

    /// Bytes before the first record of [`file`].
    pub fn first() -> u64 {
        (MAGIC.len() + 9 + 4 + 4 + 7) as u64
    }
}
