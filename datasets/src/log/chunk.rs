//! Chunks: compressed runs of records, the unit in which a log is read.

use std::io::Read;
use std::ops::Range;

use bytes::Bytes;
use mcap::records::op;

use crate::log::record::{FRAME, MESSAGE_HEAD, MessageHead, frame, split};
use crate::log::unpack::unpack;
use crate::losses::{Loss, Reason};

/// First bytes of a zstd frame.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Bytes that come out of any message that was compressed on its own, and further ones for each of its bytes: such a
/// message says nothing of its size, so it cannot be reserved.
const MESSAGE_BYTES: u64 = 64 << 20;
const MESSAGE_RATIO: u64 = 64;

/// A decompressed chunk, or a run of records that lie outside any chunk.
#[derive(Debug, Clone)]
pub struct Block {
    /// The records; of a chunk that does not fit into memory, payloads of some of its messages.
    pub bytes: Bytes,
    /// Bytes of all its records.
    pub size: u64,
    /// Where the compressed bytes lie in the file; for records outside chunks, where the block lies.
    pub file_offset: u64,
    /// What the block was before it was decompressed; `None` for records outside chunks.
    pub packing: Option<Packing>,
    /// Whether a place in the block can be told by a file offset and one decompression.
    pub addressable: bool,
    /// What is wrong with the chunk: then the records are those that lie before the damage.
    pub damage: Option<Damage>,
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
    /// Opens a chunk record that starts at `offset` of its file: checks it, decompresses it, compares its checksum. Of
    /// a record that is cut, or does not decompress, the records before the damage are kept.
    ///
    /// # Errors
    /// When the bytes are no chunk record, are compressed in an unknown way, or fail their checksum.
    pub fn open(record: &Bytes, offset: u64) -> Result<Self, Damage> {
        let head = ChunkHead::parse(record)?;
        let (data, wrong) = head.data(record)?;
        let (bytes, damage) = unpack(&head.compression, data, head.size)?;
        let damage = wrong.or(damage);
        if damage.is_none() || bytes.len() as u64 == head.size {
            head.check(crc32fast::hash(&bytes))?;
        }
        let size = bytes.len() as u64;
        Ok(Self {
            bytes,
            size,
            file_offset: offset + head.start as u64,
            packing: Some(head.packing(record.len() as u64)),
            addressable: true,
            damage,
        })
    }

    /// A run of records outside any chunk.
    pub fn loose(bytes: Bytes, offset: u64) -> Self {
        Self {
            size: bytes.len() as u64,
            bytes,
            file_offset: offset,
            packing: None,
            addressable: true,
            damage: None,
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
        let most = MESSAGE_BYTES + MESSAGE_RATIO * payload.len() as u64;
        let mut bytes = Vec::new();
        zstd::Decoder::new(payload)
            .and_then(|zstd| zstd.take(most + 1).read_to_end(&mut bytes))
            .map_err(|error| format!("a payload that does not decompress: {error}"))?;
        if bytes.len() as u64 > most {
            let found = payload.len();
            return Err(format!(
                "expected at most {most} B out of a payload of {found} B, found more"
            ));
        }
        let plain = self
            .packing
            .as_ref()
            .is_none_or(|p| p.compression.is_empty());
        Ok(Some(Self {
            size: bytes.len() as u64,
            bytes: bytes.into(),
            file_offset: self.file_offset + message.at,
            packing: Some(Packing {
                compression: "zstd".to_owned(),
                compressed_size: payload.len() as u64,
            }),
            addressable: plain,
            damage: None,
        }))
    }

    /// The records, as far as they are complete.
    pub fn records(&self) -> Records<'_> {
        Records {
            bytes: &self.bytes,
            offset: 0,
        }
    }

    /// What is in it; of messages, those that `wanted` says yes to.
    pub fn contents(&self, mut wanted: impl FnMut(&MessageHead) -> bool) -> Contents {
        let mut found = Contents::default();
        let mut records = self.records();
        for (opcode, start, body) in records.by_ref() {
            if opcode != op::MESSAGE {
                if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                    let start = start + FRAME as usize;
                    let place = start..start + body.len();
                    found.definitions.push((opcode, place));
                }
                found.lost.add(stray(opcode, body.len() as u64));
                continue;
            }
            let Some(head) = MessageHead::parse(body) else {
                found.lost.add(Some(FRAME + body.len() as u64));
                continue;
            };
            if wanted(&head) {
                let body_start = start + FRAME as usize;
                let start = body_start + MESSAGE_HEAD;
                found.messages.push(Message {
                    head,
                    at: start as u64,
                    start,
                    end: body_start + body.len(),
                });
            }
        }
        let rest = (self.bytes.len() - records.offset) as u64;
        if self.damage.is_none() {
            found.lost.add((rest > 0).then_some(rest));
        }
        sort(&mut found.messages);
        found
    }
}

/// What is in a block.
#[derive(Debug, Default)]
pub struct Contents {
    /// Ordered by log time; equal times keep the order of the file.
    pub messages: Vec<Message>,
    /// Schema and channel records: opcode, and where in the block's bytes the body is.
    pub(crate) definitions: Vec<(u8, Range<usize>)>,
    /// What is no record that can be in a block.
    pub lost: Loss,
}

/// Orders messages by log time; equal times keep their order.
pub(crate) fn sort(messages: &mut [Message]) {
    if !messages.is_sorted_by_key(|message| message.head.log_time) {
        messages.sort_by_key(|message| message.head.log_time);
    }
}

/// Bytes of a record that is skipped though it may not lie in a chunk; none for one that may, or that nobody knows.
pub(crate) fn stray(opcode: u8, length: u64) -> Option<u64> {
    let known = (op::HEADER..=op::DATA_END).contains(&opcode);
    let fits = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE);
    (known && !fits).then_some(FRAME.saturating_add(length))
}

/// A message within a block.
#[derive(Debug, Clone, Copy)]
pub struct Message {
    /// Channel and times.
    pub head: MessageHead,
    /// First byte of the payload, in all records of the block.
    pub at: u64,
    /// First byte of the payload, in the block's bytes.
    pub start: usize,
    /// Behind the last byte of the payload, there.
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

/// What stands before a chunk's data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ChunkHead {
    /// Bytes that it claims to hold.
    pub size: u64,
    /// Checksum of what it holds; 0 for none.
    pub crc: u32,
    /// `zstd`, `lz4` or empty.
    pub compression: String,
    /// Bytes of its data.
    pub packed: u64,
    /// Where its data start in the record.
    pub start: usize,
    /// Bytes that the record claims to have.
    pub claimed: u64,
}

/// Bytes of a chunk record before the name of its compression: frame, two times, size, checksum, length of the name.
const BEFORE_NAME: usize = FRAME as usize + 8 + 8 + 8 + 4 + 4;
/// Bytes of the longest name of a compression that is read.
const LONGEST_NAME: usize = 256;

/// Bytes that certainly hold the head of a chunk.
pub(crate) const HEAD: u64 = (BEFORE_NAME + LONGEST_NAME + 8) as u64;

impl ChunkHead {
    /// Of a chunk record, of which at least the first [`HEAD`] bytes are there, or all.
    ///
    /// # Errors
    /// When it is no chunk record, or cut before its data.
    pub fn parse(record: &[u8]) -> Result<Self, Damage> {
        let bad = |detail: String| (Reason::BadIndex, detail);
        let claimed = match frame(record) {
            Some((op::CHUNK, length)) => length.saturating_add(FRAME),
            Some((opcode, _)) => {
                return Err(bad(format!(
                    "expected a chunk record, found opcode {opcode}"
                )));
            }
            None => return Err(bad("expected a chunk record, found nothing".to_owned())),
        };
        let parsed = || {
            let number = |at: usize| Some(u64::from_le_bytes(*record.get(at..)?.first_chunk()?));
            let short = |at: usize| Some(u32::from_le_bytes(*record.get(at..)?.first_chunk()?));
            let name = short(BEFORE_NAME - 4)? as usize;
            let name = record.get(BEFORE_NAME..)?.get(..name.min(LONGEST_NAME))?;
            let start = BEFORE_NAME + name.len() + 8;
            Some(Self {
                size: number(FRAME as usize + 16)?,
                crc: short(FRAME as usize + 24)?,
                compression: String::from_utf8_lossy(name).into_owned(),
                packed: number(start - 8)?,
                start,
                claimed,
            })
        };
        parsed().ok_or_else(|| {
            let found = record.len();
            bad(format!(
                "expected the head of a chunk record, found {found} B of one"
            ))
        })
    }

    /// The chunk's data, as far as they are there; beside them, what is wrong, as [`Self::end`] says.
    fn data(&self, record: &Bytes) -> Result<(Bytes, Option<Damage>), Damage> {
        let (end, wrong) = self.end(record.len() as u64)?;
        Ok((record.slice(self.start..end as usize), wrong))
    }

    /// Where the chunk's data end in its record, of which so many bytes are there; beside it, that they are cut, or that
    /// the record ends before these bytes.
    ///
    /// # Errors
    /// When they do not fit into the record.
    pub fn end(&self, found: u64) -> Result<(u64, Option<Damage>), Damage> {
        let (end, claimed) = (self.packed.saturating_add(self.start as u64), self.claimed);
        if end > claimed {
            let detail =
                format!("expected data of at most {claimed} B in a chunk record, found {end} B");
            return Err((Reason::BadIndex, detail));
        }
        let wrong = if end > found {
            Some((Reason::Torn, self.cut(found)))
        } else if claimed < found {
            let detail = format!("expected a chunk record of {found} B, found one of {claimed} B");
            Some((Reason::BadIndex, detail))
        } else {
            None
        };
        Ok((end.min(found), wrong))
    }

    /// How the chunk lies in its file, of whose record so many bytes are there.
    pub fn packing(&self, found: u64) -> Packing {
        Packing {
            compression: self.compression.clone(),
            compressed_size: self.packed.min(found - self.start as u64),
        }
    }

    /// What is wrong with a record of which only so many bytes are there.
    pub fn cut(&self, found: u64) -> String {
        let end = self.packed.saturating_add(self.start as u64);
        format!("expected a chunk record of {end} B, found its first {found}")
    }

    /// Compares the checksum.
    ///
    /// # Errors
    /// Where it is another one.
    pub fn check(&self, found: u32) -> Result<(), Damage> {
        if self.crc == 0 || self.crc == found {
            return Ok(());
        }
        let expected = self.crc;
        let detail = format!("expected the checksum {expected:08x}, found {found:08x}");
        Err((Reason::BadChecksum, detail))
    }
}
