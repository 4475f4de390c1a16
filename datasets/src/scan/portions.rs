//! The messages of a chunk that does not fit into memory, a portion of them at a time.
//!
//! The chunk is fetched and decompressed twice, piece by piece: first for what is wrong with it, as nothing is used of
//! a chunk with another checksum, then for its messages. So the rows are those of a chunk that is opened whole; where
//! log times go back, they are in order within a portion only.

use std::io;
use std::sync::Arc;

use datafusion::common::runtime::SpawnedTask;
use datafusion::execution::memory_pool::{MemoryConsumer, MemoryPool, MemoryReservation};
use evermap_schemas::Fault;
use mcap::records::op;

use crate::fault::fault_of;
use crate::log::census::census;
use crate::log::chunk::{Block, ChunkHead, Damage, HEAD, Message, sort, stray};
use crate::log::index::Unit;
use crate::log::record::{FRAME, MESSAGE_HEAD, MessageHead, frame};
use crate::log::walk::{Feed, Walk, fed, joined};
use crate::log::window::fetch;
use crate::losses::{Loss, Reason};
use crate::scan::strays::Strays;
use crate::session::LogPart;

/// Bytes of a portion's messages, unless it is a single one.
const PORTION_BYTES: usize = 1 << 20;

/// Memory for what is fetched and decompressed ahead, and for a portion.
pub(crate) const STREAMED_BYTES: u64 = 8 << 20;

/// The messages of some channels in a chunk, in the order of the file.
pub(crate) struct Portions {
    walk: Walk<'static>,
    /// The chunk, without its bytes.
    chunk: Block,
    unit: Unit,
    part: Arc<LogPart>,
    /// Ascending.
    channels: Vec<u16>,
    strays: Strays,
    lost: Loss,
    /// Messages that do not decode, of all portions so far: they are told of the chunk.
    undecodable: Loss,
    damaged: bool,
    ended: bool,
    pool: Option<Arc<dyn MemoryPool>>,
}

/// Some messages, with their payloads.
pub(crate) struct Portion {
    pub block: Block,
    pub messages: Vec<Message>,
    /// Memory of a message that is larger than a portion.
    pub memory: Option<MemoryReservation>,
}

/// A chunk that is gone through.
pub(crate) struct Begun {
    pub portions: Portions,
    /// Ends before all portions are there only when the store fails.
    pub feed: Feed,
    /// What is wrong with the chunk: then the portions are of what lies before the damage.
    pub damage: Option<Damage>,
}

/// Begins with the messages of these channels, ascending, of a chunk.
///
/// # Errors
/// A resource fault when the store fails. Inside, why nothing of the chunk can be used.
pub(crate) async fn begin(
    part: &Arc<LogPart>,
    unit: &Unit,
    channels: Vec<u16>,
    pool: Option<Arc<dyn MemoryPool>>,
) -> Result<Result<Begun, Damage>, Fault> {
    let start = unit.offset..unit.offset + unit.length.min(HEAD);
    let bytes = fetch(&part.store, &part.meta, start).await?;
    let found = ChunkHead::parse(&bytes).and_then(|head| {
        let (end, wrong) = head.end(unit.length)?;
        Ok((head, end, wrong))
    });
    let (head, end, wrong) = match found {
        Ok(found) => found,
        Err(damage) => return Ok(Err(damage)),
    };
    let data = unit.offset + head.start as u64..unit.offset + end;
    let (pieces, surveyed) = fed(&part.store, &part.meta, data.clone());
    let claimed = head.clone();
    // Definitions are known from the index: there is no room for them.
    let counted = SpawnedTask::spawn_blocking(move || census(&claimed, wrong, 0, pieces));
    let counted = joined(counted).await?;
    joined(surveyed).await.flatten()?;
    let census = match counted {
        Ok(census) => census,
        Err(damage) => return Ok(Err(damage)),
    };
    let (pieces, feed) = fed(&part.store, &part.meta, data);
    let walk = match Walk::new(&head.compression, head.size, pieces) {
        Ok(walk) => walk,
        Err(damage) => return Ok(Err(damage)),
    };
    let portions = Portions {
        walk,
        chunk: Block {
            bytes: bytes::Bytes::new(),
            size: census.size,
            file_offset: unit.offset + head.start as u64,
            packing: Some(head.packing(unit.length)),
            addressable: true,
            damage: None,
        },
        unit: unit.clone(),
        part: Arc::clone(part),
        channels,
        strays: Strays::new(part, unit),
        lost: Loss::default(),
        undecodable: Loss::default(),
        damaged: census.damage.is_some(),
        ended: false,
        pool,
    };
    let damage = census.damage;
    Ok(Ok(Begun {
        portions,
        feed,
        damage,
    }))
}

impl Portions {
    /// What does not decode of the chunk so far, with these of the latest portion.
    pub fn undecodable(&mut self, more: Loss) -> Loss {
        self.undecodable.join(more);
        self.undecodable
    }

    /// The next portion; none at the end of the chunk. What of the chunk is no record, or not of the index, is noted
    /// then.
    ///
    /// # Errors
    /// A resource fault when a message finds no memory, or the file is another one than before.
    pub fn next(&mut self) -> Result<Option<Portion>, Fault> {
        let mut portion = Portion {
            block: self.chunk.clone(),
            messages: Vec::new(),
            memory: None,
        };
        let mut payloads = Vec::new();
        while !self.ended {
            match self.record(&mut portion, &mut payloads) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => {
                    return Err(error
                        .downcast()
                        .unwrap_or_else(|error| self.changed(&error)));
                }
            }
        }
        if portion.messages.is_empty() {
            self.note();
            return Ok(None);
        }
        portion.block.bytes = payloads.into();
        sort(&mut portion.messages);
        Ok(Some(portion))
    }

    /// Where the chunk lies.
    pub fn unit(&self) -> &Unit {
        &self.unit
    }

    /// Takes the next record; whether there is room for further ones.
    fn record(&mut self, portion: &mut Portion, payloads: &mut Vec<u8>) -> io::Result<bool> {
        let at = self.walk.position();
        let left = self.chunk.size.saturating_sub(at);
        let record = self.walk.peek(FRAME as usize + MESSAGE_HEAD)?;
        let complete = |length: &u64| length.saturating_add(FRAME) <= left;
        let found = frame(record).filter(|(opcode, length)| *opcode != 0 && complete(length));
        let Some((opcode, length)) = found else {
            self.ended = true;
            // What lies behind the records of a damaged chunk is the damage.
            let rest = (left > 0 && !self.damaged).then_some(left);
            self.lost.add(rest);
            return Ok(false);
        };
        let body = &record[FRAME as usize..];
        let body = &body[..body.len().min(length as usize)];
        let head = match opcode {
            op::MESSAGE => MessageHead::parse(body).ok_or(Some(FRAME + length)),
            _ => Err(stray(opcode, length)),
        };
        let is_wanted = |head: &MessageHead| self.channels.binary_search(&head.channel).is_ok();
        let wanted = head.as_ref().ok().copied().filter(is_wanted);
        if let Some(head) = wanted {
            let held = payloads.len() + portion.messages.len() * size_of::<Message>();
            if held > 0 && held as u64 + length > PORTION_BYTES as u64 {
                return Ok(false);
            }
            let before = FRAME + MESSAGE_HEAD as u64;
            let payload = length - MESSAGE_HEAD as u64;
            if payload > PORTION_BYTES as u64 {
                portion.memory = self.memory(payload)?;
                payloads.try_reserve_exact(payload as usize)?;
            }
            let start = payloads.len();
            exactly(before, self.walk.skip(before)?)?;
            exactly(payload, self.walk.take(payload, payloads)?)?;
            let (at, end) = (at + before, payloads.len());
            portion.messages.push(Message {
                head,
                at,
                start,
                end,
            });
        } else {
            exactly(FRAME + length, self.walk.skip(FRAME + length)?)?;
        }
        match head {
            Ok(head) => self.strays.see(&head),
            Err(lost) => self.lost.add(lost),
        }
        Ok(true)
    }

    /// Memory for the payload of a message that is larger than a portion.
    fn memory(&self, bytes: u64) -> io::Result<Option<MemoryReservation>> {
        let reserve = |pool: &Arc<dyn MemoryPool>| {
            let reservation = MemoryConsumer::new("McapScan").register(pool);
            let grown = reservation.try_grow(usize::try_from(bytes).unwrap_or(usize::MAX));
            grown.map(|()| reservation)
        };
        let reservation = self.pool.as_ref().map(reserve).transpose();
        reservation.map_err(|error| {
            let place = format!("{} at {}", self.part.url, self.unit.offset);
            io::Error::other(fault_of(&error).at(format!("a message of {bytes} B in {place}")))
        })
    }

    /// Notes what else there was.
    fn note(&mut self) {
        self.strays.note(!self.damaged && self.lost.count == 0);
        let lost = std::mem::take(&mut self.lost);
        if lost.count > 0 {
            let losses = &self.part.losses;
            losses.note(Reason::BadRecord, self.unit.offset, lost, "inside a chunk");
        }
    }

    fn changed(&self, error: &io::Error) -> Fault {
        let fault = Fault::resource(format!("{error}: the file changed while it was read"));
        fault.at(&self.part.url)
    }
}

fn exactly(expected: u64, found: u64) -> io::Result<()> {
    match found == expected {
        true => Ok(()),
        false => Err(io::Error::other(format!(
            "expected {expected} B of a chunk, found {found}"
        ))),
    }
}
