//! The stream of one partition's rows from one file: fetch a unit, open it, fill a batch, and so on.
//!
//! Fetching is asynchronous and one unit ahead; everything that costs CPU time runs on the blocking pool. At any
//! moment a stream holds one opened unit, one fetched one and one batch, and has reserved that much.

use std::collections::VecDeque;
use std::sync::Arc;

use arrow::array::RecordBatch;
use bytes::Bytes;
use datafusion::common::runtime::SpawnedTask;
use datafusion::error::Result;
use datafusion::execution::memory_pool::{MemoryConsumer, MemoryPool, MemoryReservation};
use evermap_schemas::Fault;
use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};

use crate::fault::external;
use crate::log::chunk::{Block, Damage, Message};
use crate::log::index::{Unit, UnitKind};
use crate::log::window::fetch;
use crate::losses::{Loss, Reason};
use crate::scan::plan::PlannedUnit;
use crate::scan::rows::{MessageAt, RowBuilder};
use crate::session::LogPart;

/// A batch is handed on when it holds this many bytes, however few rows they are.
pub(crate) const BATCH_BYTES: usize = 8 << 20;

/// What a stream is made from.
pub(crate) struct Job {
    pub part: Arc<LogPart>,
    pub units: Vec<PlannedUnit>,
    pub rows: Box<dyn RowBuilder>,
    /// A batch is handed on when it holds this many rows.
    pub batch_rows: usize,
    pub pool: Option<Arc<dyn MemoryPool>>,
    /// A table of one topic notes what it loses under the topic's name.
    pub topic: String,
}

/// Runs a job.
pub(crate) fn stream(job: Job) -> BoxStream<'static, Result<RecordBatch>> {
    let reservation = job
        .pool
        .as_ref()
        .map(|pool| MemoryConsumer::new("McapScan").register(pool));
    let scan = Scan {
        worker: Worker {
            part: job.part,
            rows: job.rows,
            batch_rows: job.batch_rows.max(1),
            topic: job.topic,
            current: None,
        },
        units: job.units.into(),
        fetched: None,
        reservation,
        ended: false,
    };
    futures::stream::try_unfold(scan, Scan::step)
        .map_ok(|batches| futures::stream::iter(batches.into_iter().map(Ok)))
        .try_flatten()
        .boxed()
}

struct Scan {
    worker: Worker,
    units: VecDeque<PlannedUnit>,
    fetched: Option<(PlannedUnit, SpawnedTask<Result<Bytes, Fault>>)>,
    reservation: Option<MemoryReservation>,
    ended: bool,
}

impl Scan {
    /// The next batches, or the end.
    async fn step(mut self) -> Result<Option<(Vec<RecordBatch>, Self)>> {
        loop {
            if self.ended {
                return Ok(None);
            }
            let next = if self.worker.current.is_some() {
                None
            } else {
                self.next_unit().await?
            };
            self.ended = next.is_none() && self.worker.current.is_none();
            let ended = self.ended;
            let mut worker = self.worker;
            let (returned, batches) = SpawnedTask::spawn_blocking(move || {
                let batches = worker.work(next, ended);
                (worker, batches)
            })
            .join()
            .await
            .map_err(|error| external(Fault::bug(error.to_string())))?;
            self.worker = returned;
            let batches = batches.map_err(external)?;
            if !batches.is_empty() {
                return Ok(Some((batches, self)));
            }
        }
    }

    /// Awaits the unit that is being fetched, and starts to fetch the one behind it.
    async fn next_unit(&mut self) -> Result<Option<(PlannedUnit, Bytes)>> {
        if self.fetched.is_none() {
            self.fetch_ahead();
        }
        let Some((unit, task)) = self.fetched.take() else {
            return Ok(None);
        };
        self.fetch_ahead();
        self.reserve(&unit.unit)?;
        let bytes = task
            .join()
            .await
            .map_err(|error| external(Fault::bug(error.to_string())))?;
        Ok(Some((unit, bytes.map_err(external)?)))
    }

    fn fetch_ahead(&mut self) {
        let Some(unit) = self.units.pop_front() else {
            return;
        };
        let part = self.worker.part.clone();
        let range = unit.unit.offset..unit.unit.end();
        let task =
            SpawnedTask::spawn(async move { fetch(&part.store, &part.meta.location, range).await });
        self.fetched = Some((unit, task));
    }

    /// Reserves the memory for this unit, opened, for the one that is being fetched, and for a batch.
    fn reserve(&mut self, unit: &Unit) -> Result<()> {
        let ahead = self
            .fetched
            .as_ref()
            .map_or(0, |(planned, _)| planned.unit.length);
        let batch = unit.size.min(BATCH_BYTES as u64);
        let bytes = [
            unit.length,
            unit.size.min(crate::log::chunk::LARGEST_CHUNK),
            ahead,
            batch,
        ]
        .into_iter()
        .fold(0u64, u64::saturating_add);
        match &mut self.reservation {
            Some(reservation) => {
                reservation.try_resize(usize::try_from(bytes).unwrap_or(usize::MAX))
            }
            None => Ok(()),
        }
    }
}

/// The half that uses the CPU.
struct Worker {
    part: Arc<LogPart>,
    rows: Box<dyn RowBuilder>,
    batch_rows: usize,
    topic: String,
    current: Option<Open>,
}

/// Gives a message to the builder; a payload that is compressed on its own is decompressed first.
fn push(
    rows: &mut dyn RowBuilder,
    part: &LogPart,
    block: &Block,
    message: &Message,
) -> Result<(), String> {
    let Some(channel) = part.index.channels.get(&message.head.channel) else {
        return Ok(());
    };
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
        start: place.start,
        payload: &block.bytes[place],
    })
}

/// A unit that is being read.
struct Open {
    unit: Unit,
    block: Block,
    messages: Vec<Message>,
    next: usize,
    lost: Loss,
    example: String,
}

impl Worker {
    /// Opens a unit if there is a new one, adds rows until the batch is full or the unit is done.
    fn work(
        &mut self,
        next: Option<(PlannedUnit, Bytes)>,
        ended: bool,
    ) -> Result<Vec<RecordBatch>, Fault> {
        if let Some((planned, bytes)) = next {
            self.open(planned, bytes);
        }
        self.fill();
        let full = self.rows.rows() >= self.batch_rows || self.rows.bytes() >= BATCH_BYTES;
        if full || ended {
            return self.rows.finish();
        }
        Ok(Vec::new())
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
        let rows = &self.rows;
        let (messages, rest) = block.messages(|channel| match &planned.channels {
            Some(channels) => channels.binary_search(&channel).is_ok(),
            None => rows.wants(channel),
        });
        if rest > 0 {
            let loss = Loss::one(rest);
            let detail = "inside a chunk";
            self.part
                .losses
                .note(Reason::BadRecord, unit.offset, loss, detail);
        }
        self.current = Some(Open {
            unit,
            block,
            messages,
            next: 0,
            lost: Loss::default(),
            example: String::new(),
        });
    }

    fn lose_unit(&self, unit: &Unit, (reason, detail): Damage) {
        let loss = Loss::one(unit.length);
        self.part.losses.note(reason, unit.offset, loss, detail);
    }

    fn fill(&mut self) {
        let Some(mut open) = self.current.take() else {
            return;
        };
        while let Some(message) = open.messages.get(open.next) {
            if self.rows.rows() >= self.batch_rows || self.rows.bytes() >= BATCH_BYTES {
                self.current = Some(open);
                return;
            }
            open.next += 1;
            if let Err(detail) = push(self.rows.as_mut(), &self.part, &open.block, message) {
                open.lost.count += 1;
                open.lost.bytes += (message.end - message.start) as u64;
                if open.example.is_empty() {
                    open.example = detail;
                }
            }
        }
        self.close(open);
    }

    /// Notes what was lost in a unit, once it is done.
    fn close(&self, open: Open) {
        if open.lost.count > 0 {
            self.part.losses.note_topic(
                Reason::Undecodable,
                &self.topic,
                open.unit.offset,
                open.lost,
                open.example,
            );
        }
    }
}
