//! What a chunk holds, without holding the chunk: its records go by while it is read and decompressed.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read};

use bytes::{Buf, Bytes};
use mcap::records::op;
use tokio::sync::mpsc::Receiver;

use crate::log::chunk::{ChunkHead, Damage, stray};
use crate::log::pace::{Pace, add};
use crate::log::record::{FRAME, MESSAGE_HEAD, MessageHead, frame};
use crate::log::unpack::{check_claim, reader};
use crate::losses::{Loss, Reason};

/// Bytes of the longest schema record that is kept: twice what any schema may have.
const LONGEST_DEFINITION: u64 = 8 << 20;
/// Bytes of the longest channel record that is kept: its notes take a multiple of their text.
const LONGEST_CHANNEL: u64 = 1 << 20;

/// Bytes of the longest record of this kind that is kept.
pub(crate) fn longest(opcode: u8) -> u64 {
    match opcode {
        op::CHANNEL => LONGEST_CHANNEL,
        _ => LONGEST_DEFINITION,
    }
}

/// What went by.
#[derive(Debug, Default)]
pub(crate) struct Census {
    /// Bytes after decompression.
    pub size: u64,
    /// When messages came, by channel.
    pub paces: BTreeMap<u16, Pace>,
    /// Earliest and latest log time of a message.
    pub times: Option<(i64, i64)>,
    /// Schema and channel records: opcode and number, body.
    pub definitions: BTreeMap<(u8, u16), Bytes>,
    /// Records that are too short, or out of place.
    pub lost: Loss,
    /// What is wrong with the chunk: then the rest is of what lies before the damage.
    pub damage: Option<Damage>,
}

/// Counts what is in a chunk. `cut` says that its record is not all there; of definitions, at most `room` bytes are kept.
///
/// # Errors
/// When nothing of it can be used: an unknown compression, a wrong checksum.
pub(crate) fn census(
    head: &ChunkHead,
    cut: Option<Damage>,
    room: usize,
    data: impl Read + Send,
) -> Result<Census, Damage> {
    check_claim(&head.compression, head.size)?;
    let mut records = Records {
        data: Counted {
            data: reader(&head.compression, data)?,
            left: head.size,
            crc: crc32fast::Hasher::new(),
        },
        buffer: vec![0; BUFFER],
        start: 0,
        end: 0,
        room,
        rest: 0,
        census: Census::default(),
    };
    let ended = records.run();
    let size = head.size - records.data.left;
    let whole = ended.and_then(|()| records.data.ended());
    let (mut census, rest) = (records.census, records.rest);
    census.size = size;
    let damaged = match whole {
        Err(error) => Some((Reason::BadCompression, error.to_string())),
        Ok(true) if size == head.size => None,
        Ok(_) => {
            let detail = format!(
                "expected {} B after decompression, found another size",
                head.size
            );
            Some((Reason::BadCompression, detail))
        }
    };
    census.damage = cut.or(damaged);
    if census.damage.is_none() {
        census.lost.add((rest > 0).then_some(rest));
        head.check(records.data.crc.finalize())?;
    }
    Ok(census)
}

/// Bytes that are looked at together.
const BUFFER: usize = 64 << 10;

/// Counts and hashes what is read, and reads no more than the chunk claims.
struct Counted<R> {
    data: R,
    left: u64,
    crc: crc32fast::Hasher,
}

impl<R: Read> Counted<R> {
    /// Whether there is no more than was claimed.
    fn ended(&mut self) -> io::Result<bool> {
        Ok(self.left > 0 || self.data.read(&mut [0])? == 0)
    }
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let most = bytes
            .len()
            .min(usize::try_from(self.left).unwrap_or(usize::MAX));
        let read = self.data.read(&mut bytes[..most])?;
        self.left -= read as u64;
        self.crc.update(&bytes[..read]);
        Ok(read)
    }
}

struct Records<R> {
    data: Counted<R>,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    room: usize,
    /// Bytes at the end that are no complete record.
    rest: u64,
    census: Census,
}

impl<R: Read> Records<R> {
    fn run(&mut self) -> io::Result<()> {
        loop {
            let head = self.peek(FRAME as usize)?;
            let Some((opcode, length)) = frame(head).filter(|(opcode, _)| *opcode != 0) else {
                self.rest = self.skip(u64::MAX)?;
                return Ok(());
            };
            self.start += FRAME as usize;
            let found = match opcode {
                op::MESSAGE => self.message(length)?,
                op::SCHEMA | op::CHANNEL if length <= longest(opcode) => {
                    self.definition(opcode, length as usize)?
                }
                _ => {
                    let long = matches!(opcode, op::SCHEMA | op::CHANNEL).then_some(length);
                    self.census.lost.add(stray(opcode, length).or(long));
                    self.skip(length)?
                }
            };
            if found < length {
                self.rest = FRAME + found;
                return Ok(());
            }
        }
    }

    /// The next bytes, up to so many.
    fn peek(&mut self, wanted: usize) -> io::Result<&[u8]> {
        if self.end - self.start < wanted {
            self.buffer.copy_within(self.start..self.end, 0);
            (self.start, self.end) = (0, self.end - self.start);
            while self.end < wanted {
                match self.data.read(&mut self.buffer[self.end..]) {
                    Ok(0) => break,
                    Ok(read) => self.end += read,
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(&self.buffer[self.start..self.end.min(self.start + wanted)])
    }

    /// Skips bytes; how many there were.
    fn skip(&mut self, length: u64) -> io::Result<u64> {
        let mut skipped = 0;
        while skipped < length {
            if self.start == self.end && self.peek(1)?.is_empty() {
                break;
            }
            let held = (self.end - self.start) as u64;
            let taken = held.min(length - skipped);
            self.start += taken as usize;
            skipped += taken;
        }
        Ok(skipped)
    }

    fn message(&mut self, length: u64) -> io::Result<u64> {
        let head = self.peek(MESSAGE_HEAD.min(usize::try_from(length).unwrap_or(usize::MAX)))?;
        let head = MessageHead::parse(head);
        let found = self.skip(length)?;
        if found < length {
            return Ok(found);
        }
        let census = &mut self.census;
        match head {
            Some(head) => {
                add(&mut census.paces, head.channel, Pace::of(head.log_time));
                let (start, end) = census.times.unwrap_or((head.log_time, head.log_time));
                census.times = Some((start.min(head.log_time), end.max(head.log_time)));
            }
            None => census.lost.add(Some(FRAME + length)),
        }
        Ok(found)
    }

    fn definition(&mut self, opcode: u8, length: usize) -> io::Result<u64> {
        let number = self.peek(2)?.first_chunk().map(|n| u16::from_le_bytes(*n));
        let key = (opcode, number.unwrap_or(0));
        if self.census.definitions.contains_key(&key) {
            return self.skip(length as u64);
        }
        if length > self.room {
            self.census.lost.add(Some(length as u64));
            return self.skip(length as u64);
        }
        let mut body = Vec::new();
        while body.len() < length {
            let piece = self.peek((length - body.len()).min(BUFFER))?;
            if piece.is_empty() {
                return Ok(body.len() as u64);
            }
            let taken = piece.len();
            body.extend_from_slice(piece);
            self.start += taken;
        }
        self.room -= length;
        self.census.definitions.insert(key, body.into());
        Ok(length as u64)
    }
}

/// What another task fetches piece by piece, as one stretch of bytes.
pub(crate) struct Pieces {
    pub pieces: Receiver<Bytes>,
    pub piece: Bytes,
}

impl Read for Pieces {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        while self.piece.is_empty() {
            match self.pieces.blocking_recv() {
                Some(piece) => self.piece = piece,
                None => return Ok(0),
            }
        }
        let length = bytes.len().min(self.piece.len());
        self.piece.copy_to_slice(&mut bytes[..length]);
        Ok(length)
    }
}
