//! What a chunk holds, without holding the chunk: its records go by while it is read and decompressed.

use std::collections::BTreeMap;
use std::io::{self, Read};

use bytes::Bytes;
use mcap::records::op;

use crate::log::chunk::{ChunkHead, Damage, stray};
use crate::log::pace::{Pace, add};
use crate::log::record::{FRAME, MESSAGE_HEAD, MessageHead, frame};
use crate::log::walk::Walk;
use crate::losses::Loss;

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
    /// Schema and channel records: opcode, body. One that is there again is here once.
    pub definitions: Vec<(u8, Bytes)>,
    /// Messages whose log time is beyond what Arrow holds.
    pub late: u64,
    /// Records that are too short, or out of place.
    pub lost: Loss,
    /// What is wrong with the chunk: then the rest is of what lies before the damage.
    pub damage: Option<Damage>,
}

/// Counts what is in a chunk. `cut` says that its record is not all there; of definitions, at most `room` bytes are kept.
///
/// # Errors
/// When nothing of it can be used: an unknown compression, a wrong checksum.
pub(crate) fn census<'a>(
    head: &ChunkHead,
    cut: Option<Damage>,
    room: usize,
    data: impl Read + Send + 'a,
) -> Result<Census, Damage> {
    let mut records = Records {
        walk: Walk::new(&head.compression, head.size, data)?,
        room,
        rest: 0,
        first: BTreeMap::new(),
        census: Census::default(),
    };
    let ended = records.run();
    let damage = records.walk.damage(ended);
    let Records {
        walk,
        rest,
        mut census,
        ..
    } = records;
    census.size = walk.found();
    census.damage = cut.or(damage);
    if census.damage.is_none() {
        census.lost.add((rest > 0).then_some(rest));
    }
    if census.damage.is_none() || census.size == head.size {
        head.check(walk.checksum())?;
    }
    Ok(census)
}

struct Records<'a> {
    walk: Walk<'a>,
    room: usize,
    /// Bytes at the end that are no complete record.
    rest: u64,
    /// The first definition of each opcode and number.
    first: BTreeMap<(u8, u16), usize>,
    census: Census,
}

impl Records<'_> {
    fn run(&mut self) -> io::Result<()> {
        loop {
            let head = self.walk.peek(FRAME as usize)?;
            let Some((opcode, length)) = frame(head).filter(|(opcode, _)| *opcode != 0) else {
                self.rest = self.walk.skip(u64::MAX)?;
                return Ok(());
            };
            self.walk.skip(FRAME)?;
            let found = match opcode {
                op::MESSAGE => self.message(length)?,
                op::SCHEMA | op::CHANNEL if length <= longest(opcode) => {
                    self.definition(opcode, length as usize)?
                }
                _ => {
                    let long = matches!(opcode, op::SCHEMA | op::CHANNEL).then_some(length);
                    self.census.lost.add(stray(opcode, length).or(long));
                    self.walk.skip(length)?
                }
            };
            if found < length {
                self.rest = FRAME + found;
                return Ok(());
            }
        }
    }

    fn message(&mut self, length: u64) -> io::Result<u64> {
        let head = self
            .walk
            .peek(MESSAGE_HEAD.min(usize::try_from(length).unwrap_or(usize::MAX)))?;
        let head = MessageHead::parse(head);
        let found = self.walk.skip(length)?;
        if found < length {
            return Ok(found);
        }
        let census = &mut self.census;
        match head {
            Some(head) => {
                census.late += u64::from(head.is_late());
                add(&mut census.paces, head.channel, Pace::of(head.log_time));
                let (start, end) = census.times.unwrap_or((head.log_time, head.log_time));
                census.times = Some((start.min(head.log_time), end.max(head.log_time)));
            }
            None => census.lost.add(Some(FRAME + length)),
        }
        Ok(found)
    }

    fn definition(&mut self, opcode: u8, length: usize) -> io::Result<u64> {
        let number = self
            .walk
            .peek(2)?
            .first_chunk()
            .map(|n| u16::from_le_bytes(*n));
        let key = (opcode, number.unwrap_or(0));
        if length > self.room {
            self.census.lost.add(Some(length as u64));
            return self.walk.skip(length as u64);
        }
        let mut body = Vec::new();
        let found = self.walk.take(length as u64, &mut body)?;
        if found < length as u64 {
            return Ok(found);
        }
        let definitions = &mut self.census.definitions;
        let first = *self.first.entry(key).or_insert(definitions.len());
        if definitions.get(first).is_none_or(|known| known.1 != body) {
            self.room -= length;
            definitions.push((opcode, body.into()));
        }
        Ok(length as u64)
    }
}
