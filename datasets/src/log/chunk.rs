//! Chunks: compressed runs of records, the unit in which a log is read.

use std::io::Read;

use bytes::Bytes;
use mcap::records::{ChunkHeader, Record, op};

use crate::log::record::{FRAME, MESSAGE_HEAD, MessageHead, frame, parse, split};
use crate::losses::Reason;

/// Chunks that claim to be larger than this after decompression are not believed.
pub const LARGEST_CHUNK: u64 = 2 << 30;

/// First bytes of a zstd frame.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// A decompressed chunk, or a run of records that lie outside any chunk.
#[derive(Debug, Clone)]
pub struct Block {
    /// The records.
    pub bytes: Bytes,
    /// Where the compressed bytes lie in the file; for records outside chunks, where the block lies.
    pub file_offset: u64,
    /// What the block was before it was decompressed; `None` for records outside chunks.
    pub packing: Option<Packing>,
    /// Whether a place in the block can be told by a file offset and one decompression.
    pub addressable: bool,
}

/// How a chunk lies in its file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packing {
    /// `zstd`, `lz4` or empty.
    pub compression: String,
    /// Bytes in the file.
    pub compressed_size: u64,
}

/// Why a chunk cannot be used, and one sentence about it.
pub type Damage = (Reason, String);

impl Block {
    /// Opens a chunk record that starts at `offset` of its file: checks it, decompresses it, compares its checksum.
    ///
    /// # Errors
    /// When the bytes are no chunk record, do not decompress, or fail their checksum.
    pub fn open(record: &Bytes, offset: u64) -> Result<Self, Damage> {
        let (header, data, data_start) = chunk_parts(record)?;
        let bytes = decompress(&header.compression, data, header.uncompressed_size)?;
        if header.uncompressed_crc != 0 {
            let found = crc32fast::hash(&bytes);
            if found != header.uncompressed_crc {
                let detail = format!(
                    "expected the checksum {:08x}, found {found:08x}",
                    header.uncompressed_crc
                );
                return Err((Reason::BadChecksum, detail));
            }
        }
        Ok(Self {
            bytes,
            file_offset: offset + data_start as u64,
            packing: Some(Packing {
                compression: header.compression,
                compressed_size: header.compressed_size,
            }),
            addressable: true,
        })
    }

    /// A run of records outside any chunk.
    pub fn loose(bytes: Bytes, offset: u64) -> Self {
        Self {
            bytes,
            file_offset: offset,
            packing: None,
            addressable: true,
        }
    }

    /// The payload of a message that was compressed on its own (rosbag2's `compression_mode: MESSAGE`), as a block.
    /// `None` where it is not: no CDR payload starts like a zstd frame.
    ///
    /// # Errors
    /// When it does not decompress.
    pub fn unpack(&self, message: &Message) -> Result<Option<Self>, String> {
        let payload = &self.bytes[message.start..message.end];
        if !payload.starts_with(&ZSTD_MAGIC) {
            return Ok(None);
        }
        let mut bytes = Vec::new();
        zstd::Decoder::new(payload)
            .and_then(|zstd| zstd.take(LARGEST_CHUNK).read_to_end(&mut bytes))
            .map_err(|error| format!("a payload that does not decompress: {error}"))?;
        let plain = self
            .packing
            .as_ref()
            .is_none_or(|p| p.compression.is_empty());
        Ok(Some(Self {
            bytes: bytes.into(),
            file_offset: self.file_offset + message.start as u64,
            packing: Some(Packing {
                compression: "zstd".to_owned(),
                compressed_size: payload.len() as u64,
            }),
            addressable: plain,
        }))
    }

    /// The records, as far as they are complete.
    pub fn records(&self) -> Records<'_> {
        Records {
            bytes: &self.bytes,
            offset: 0,
        }
    }

    /// The messages of the channels that `wanted` says yes to, ordered by log time; equal times keep the order of
    /// the file. Beside them, the number of bytes at the end that are no complete record.
    pub fn messages(&self, mut wanted: impl FnMut(u16) -> bool) -> (Vec<Message>, u64) {
        let mut messages = Vec::new();
        let mut records = self.records();
        for (opcode, start, body) in records.by_ref() {
            if opcode != op::MESSAGE {
                continue;
            }
            let Some(head) = MessageHead::parse(body) else {
                continue;
            };
            if wanted(head.channel) {
                messages.push(Message {
                    head,
                    start: start + FRAME as usize + MESSAGE_HEAD,
                    end: start + FRAME as usize + body.len(),
                });
            }
        }
        let rest = (self.bytes.len() - records.offset) as u64;
        if !messages.is_sorted_by_key(|message| message.head.log_time) {
            messages.sort_by_key(|message| message.head.log_time);
        }
        (messages, rest)
    }
}

/// A message within a block.
#[derive(Debug, Clone, Copy)]
pub struct Message {
    /// Channel and times.
    pub head: MessageHead,
    /// First byte of the payload, in the block.
    pub start: usize,
    /// Behind the last byte of the payload.
    pub end: usize,
}

/// Iterates over (opcode, offset, body); ends before the first record that is not complete.
pub struct Records<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl<'a> Iterator for Records<'a> {
    type Item = (u8, usize, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let start = self.offset;
        let (opcode, body, used) = split(self.bytes.get(start..)?)?;
        if opcode == 0 {
            return None;
        }
        self.offset += used;
        Some((opcode, start, body))
    }
}

fn chunk_parts(record: &Bytes) -> Result<(ChunkHeader, Bytes, usize), Damage> {
    let no_chunk = |detail: &str| (Reason::BadIndex, detail.to_owned());
    if frame(record).is_none_or(|(opcode, _)| opcode != op::CHUNK) {
        return Err(no_chunk("expected a chunk record, found something else"));
    }
    let (opcode, body, _) = split(record).ok_or_else(|| no_chunk("a chunk record that is cut"))?;
    match parse(opcode, body) {
        Ok(Record::Chunk { header, .. }) => {
            let data_start = FRAME as usize + 8 + 8 + 8 + 4 + 4 + header.compression.len() + 8;
            let data_end = usize::try_from(header.compressed_size)
                .ok()
                .and_then(|size| size.checked_add(data_start))
                .filter(|end| *end <= record.len())
                .ok_or_else(|| no_chunk("a chunk longer than its record"))?;
            Ok((header, record.slice(data_start..data_end), data_start))
        }
        Ok(_) => Err(no_chunk("expected a chunk record")),
        Err(detail) => Err((Reason::BadCompression, detail)),
    }
}

/// Decompresses a chunk's data to exactly `size` bytes. An uncompressed chunk is not copied.
///
/// # Errors
/// When the compression is not known, the data are damaged, or the size is wrong.
pub fn decompress(compression: &str, data: Bytes, size: u64) -> Result<Bytes, Damage> {
    let bad = |detail: String| (Reason::BadCompression, detail);
    if size > LARGEST_CHUNK {
        return Err(bad(format!("a chunk that claims to hold {size} B")));
    }
    let bytes = match compression {
        "" => data,
        "zstd" | "lz4" => unpack(compression, &data, size as usize)
            .map_err(|error| bad(error.to_string()))?
            .into(),
        other => return Err(bad(format!("the unknown compression {other:?}"))),
    };
    if bytes.len() as u64 != size {
        return Err(bad(format!(
            "expected {size} B after decompression, found {}",
            bytes.len()
        )));
    }
    Ok(bytes)
}

fn unpack(compression: &str, data: &[u8], size: usize) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(size)?;
    if compression == "zstd" {
        zstd::bulk::Decompressor::new()?.decompress_to_buffer(data, &mut bytes)?;
    } else {
        let lz4 = lz4_flex::frame::FrameDecoder::new(data);
        lz4.take(size as u64 + 1).read_to_end(&mut bytes)?;
    }
    Ok(bytes)
}
