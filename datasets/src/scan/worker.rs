//! From the bytes of units to batches: the half of a stream that uses the CPU.

use std::collections::VecDeque;
use std::sync::Arc;

use arrow::array::RecordBatch;
use bytes::Bytes;
use datafusion::execution::memory_pool::MemoryReservation;
use evermap_schemas::Fault;

use crate::log::chunk::{Block, Damage, Message};
use crate::log::index::{Unit, UnitKind};
use crate::losses::{Loss, Reason};
use crate::scan::plan::PlannedUnit;
use crate::scan::portions::{Portion, Portions};
use crate::scan::rows::{MessageAt, RowBuilder};
use crate::scan::strays::Strays;
use crate::scan::stream::{BATCH_BYTES, ScanMetrics};
use crate::session::LogPart;

/// Units that are there, in the order of the file.
pub(crate) type Units = VecDeque<(PlannedUnit, Bytes)>;

/// What is worked on next.
pub(crate) enum Next {
    /// Units, whole.
    Units(Units),
    /// A chunk that does not fit into memory.
    Chunk(Box<Portions>),
}

/// Opens units and builds rows of their messages.
pub(crate) struct Worker {
    pub part: Arc<LogPart>,
    pub rows: Box<dyn RowBuilder>,
    pub batch_rows: usize,
    pub topic: String,
    /// Units that wait to be opened.
    pub waiting: Units,
    pub current: Option<OpenUnit>,
    /// What is left of a chunk that does not fit into memory.
    pub portions: Option<Box<Portions>>,
    pub metrics: ScanMetrics,
}

/// Gives a message to the builder; a payload that is compressed on its own is decompressed first.
fn push(
    rows: &mut dyn RowBuilder,
    part: &LogPart,
    open: &OpenUnit,
    message: &Message,
) -> Result<(), String> {
    let Some(channel) = part.index.channels.get(&message.head.channel) else {
        return Ok(());
    };
    let block = &open.block;
    let unpacked = match rows.decodes() && channel.message_encoding == "cdr" {
        true => block.unpack(message)?,
        false => None,
    };
    let (block, place) = match &unpacked {
        Some(own) => (own, 0..own.bytes.len()),
        None => (block, message.start..message.end),
    };
    rows.push(&MessageAt {
        part,
        block,
        head: message.head,
        at: unpacked.as_ref().map_or(message.at, |_| 0),
        payload: &block.bytes[place],
        shares: open.shares || unpacked.is_some(),
    })
}

/// A unit that is being read, or a portion of one.
pub(crate) struct OpenUnit {
    unit: Unit,
    block: Block,
    messages: Vec<Message>,
    next: usize,
    lost: Loss,
    example: String,
    /// Its largest message waits for memory to be reserved.
    pub waits: bool,
    /// Whether values may keep the block.
    shares: bool,
    /// Memory that it holds beside what the scan has reserved.
    _memory: Option<MemoryReservation>,
}

impl OpenUnit {
    fn new(unit: Unit, block: Block, messages: Vec<Message>) -> Self {
        let mut open = Self {
            unit,
            block,
            messages,
            next: 0,
            lost: Loss::default(),
            example: String::new(),
            waits: false,
            shares: false,
            _memory: None,
        };
        open.waits = open.largest() > BATCH_BYTES;
        open
    }

    fn sizes(&self) -> impl Iterator<Item = usize> {
        let messages = self.messages.iter();
        messages.map(|message| message.end - message.start)
    }

    /// Bytes of the largest payload.
    pub fn largest(&self) -> usize {
        self.sizes().max().unwrap_or(0)
    }

    /// Bytes of all payloads.
    fn wanted(&self) -> usize {
        self.sizes().sum()
    }
}

impl Worker {
    /// Whether it has nothing to work on.
    pub fn is_idle(&self) -> bool {
        self.waiting.is_empty() && self.current.is_none() && self.portions.is_none()
    }

    /// Opens units, if there are new ones, and adds rows until the batch is full or they are done.
    ///
    /// # Errors
    /// As [`RowBuilder::finish`] and [`Portions::next`].
    pub fn work(&mut self, next: Option<Next>, ended: bool) -> Result<Vec<RecordBatch>, Fault> {
        let busy = self.metrics.busy.clone();
        let _timer = busy.timer();
        match next {
            Some(Next::Units(units)) => {
                let bytes = units.iter().map(|(_, bytes)| bytes.len());
                self.metrics.bytes.add(bytes.sum());
                self.waiting = units;
            }
            Some(Next::Chunk(portions)) => self.portions = Some(portions),
            None => {}
        }
        loop {
            if self.current.is_none() {
                match self.waiting.pop_front() {
                    Some((planned, bytes)) => self.open(planned, bytes),
                    None => self.open_portion()?,
                }
            }
            if self.current.as_ref().is_some_and(|open| open.waits) {
                return Ok(Vec::new());
            }
            self.fill();
            if self.is_full() || self.waiting.is_empty() {
                break;
            }
        }
        if self.is_full() || ended {
            return self.rows.finish();
        }
        Ok(Vec::new())
    }

    fn is_full(&self) -> bool {
        self.rows.rows() >= self.batch_rows || self.rows.bytes() >= BATCH_BYTES
    }

    fn open(&mut self, planned: PlannedUnit, bytes: Bytes) {
        let unit = planned.unit;
        let block = match unit.kind {
            UnitKind::Chunk => match Block::open(&bytes, unit.offset) {
                Ok(block) => block,
                Err(damage) => return self.lose_unit(&unit, damage),
            },
            UnitKind::Loose => Block::loose(bytes, unit.offset),
            UnitKind::Attachment | UnitKind::Metadata => {
                if let Err(detail) = self.rows.push_record(&unit, &bytes) {
                    self.lose_unit(&unit, (Reason::BadAttachment, detail));
                }
                return;
            }
        };
        if let Some(damage) = block.damage.clone() {
            self.lose_unit(&unit, damage);
        }
        let mut strays = Strays::new(&self.part, &unit);
        let rows = &self.rows;
        let contents = block.contents(|head| {
            strays.see(head);
            match &planned.channels {
                Some(channels) => channels.binary_search(&head.channel).is_ok(),
                None => rows.wants(head.channel),
            }
        });
        for (opcode, body) in contents.definitions {
            strays.define(opcode, &block.bytes[body]);
        }
        strays.note(block.damage.is_none() && contents.lost.count == 0);
        if contents.lost.count > 0 {
            let (losses, lost) = (&self.part.losses, contents.lost);
            losses.note(Reason::BadRecord, unit.offset, lost, "inside a chunk");
        }
        let mut open = OpenUnit::new(unit, block, contents.messages);
        open.shares = open.wanted() >= open.block.bytes.len() / 2;
        self.current = Some(open);
    }

    /// Opens the next portion of a chunk that does not fit into memory, if there is one.
    fn open_portion(&mut self) -> Result<(), Fault> {
        // After a fault nothing more of it is read.
        let Some(mut portions) = self.portions.take() else {
            return Ok(());
        };
        let Some(portion) = portions.next()? else {
            return Ok(());
        };
        let Portion {
            block,
            messages,
            memory,
        } = portion;
        self.current = Some(OpenUnit {
            _memory: memory,
            ..OpenUnit::new(portions.unit().clone(), block, messages)
        });
        self.portions = Some(portions);
        Ok(())
    }

    /// Notes what is wrong with a unit.
    pub fn lose_unit(&self, unit: &Unit, (reason, detail): Damage) {
        let loss = Loss::one(unit.length);
        self.part.losses.note(reason, unit.offset, loss, detail);
    }

    fn fill(&mut self) {
        let Some(mut open) = self.current.take() else {
            return;
        };
        while let Some(message) = open.messages.get(open.next) {
            if self.is_full() {
                self.current = Some(open);
                return;
            }
            open.next += 1;
            if let Err(detail) = push(self.rows.as_mut(), &self.part, &open, message) {
                open.lost.count += 1;
                open.lost.bytes += (message.end - message.start) as u64;
                if open.example.is_empty() {
                    open.example = detail;
                }
            }
        }
        self.close(open);
    }

    /// Notes what was lost in a unit, or up to the end of a portion of one, once it is done.
    fn close(&mut self, open: OpenUnit) {
        if open.lost.count > 0 {
            let lost = match &mut self.portions {
                Some(portions) => portions.undecodable(open.lost),
                None => open.lost,
            };
            self.part.losses.note_topic(
                Reason::Undecodable,
                &self.topic,
                open.unit.offset,
                lost,
                open.example,
            );
        }
    }
}
