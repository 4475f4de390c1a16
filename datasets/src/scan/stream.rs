//! The stream of one partition's rows from one file: fetch a unit, open it, fill a batch, and so on.
//!
//! Fetching is asynchronous and one unit ahead; everything that costs CPU time runs on the blocking pool. At any
//! moment a stream holds one opened unit, one fetched one and one batch, and has reserved that much before it fetches
//! or decompresses.

use std::collections::VecDeque;
use std::sync::Arc;

use arrow::array::RecordBatch;
use bytes::Bytes;
use datafusion::common::runtime::SpawnedTask;
use datafusion::error::Result;
use datafusion::execution::memory_pool::{MemoryConsumer, MemoryPool, MemoryReservation};
use datafusion::physical_plan::metrics::{Count, ExecutionPlanMetricsSet, MetricBuilder, Time};
use evermap_schemas::Fault;
use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};

use crate::fault::external;
use crate::log::chunk::{Block, ChunkHead, Damage, Message};
use crate::log::index::{Unit, UnitKind};
use crate::log::unpack::LARGEST_CHUNK;
use crate::log::window::fetch;
use crate::losses::{Loss, Reason};
use crate::scan::plan::PlannedUnit;
use crate::scan::rows::{MessageAt, RowBuilder};
use crate::session::LogPart;

/// A batch is handed on when it holds this many bytes, however few rows they are. What is a view keeps at most twice as
/// much, and the rest of its last chunk.
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
    /// What is counted.
    pub metrics: ScanMetrics,
}

/// What scans of one partition count.
#[derive(Clone)]
pub(crate) struct ScanMetrics {
    busy: Time,
    bytes: Count,
}

impl ScanMetrics {
    pub fn new(metrics: &ExecutionPlanMetricsSet, partition: usize) -> Self {
        let builder = || MetricBuilder::new(metrics);
        Self {
            busy: builder().elapsed_compute(partition),
            bytes: builder().counter("bytes_scanned", partition),
        }
    }
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
            metrics: job.metrics,
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
                self.reserve_largest()?;
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
            self.reserve(None, 0)?;
            self.fetch_ahead();
        }
        let Some((unit, task)) = self.fetched.take() else {
            return Ok(None);
        };
        self.reserve(Some(&unit.unit), unit.unit.size)?;
        self.fetch_ahead();
        let bytes = task
            .join()
            .await
            .map_err(|error| external(Fault::bug(error.to_string())))?
            .map_err(external)?;
        // What the chunk itself claims counts, if the index is too modest.
        if let Ok(head) = ChunkHead::parse(&bytes)
            && head.size > unit.unit.size
        {
            self.reserve(Some(&unit.unit), head.size)?;
        }
        Ok(Some((unit, bytes)))
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

    /// Reserves the memory for a unit of which so many bytes come out, for the one that is fetched next, and for a batch.
    fn reserve(&mut self, unit: Option<&Unit>, size: u64) -> Result<()> {
        let (held, units) = (&self.fetched, &self.units);
        let ahead = held.as_ref().map(|(planned, _)| planned).or(units.front());
        let opened = size.min(LARGEST_CHUNK);
        let bytes = [
            unit.map_or(0, |unit| unit.length),
            opened,
            ahead.map_or(0, |planned| planned.unit.length),
            opened.min(2 * BATCH_BYTES as u64),
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

impl Scan {
    /// Reserves the memory for the row of the largest message of a unit that was opened, where that is beyond a batch.
    fn reserve_largest(&mut self) -> Result<()> {
        let Some(open) = self.worker.current.as_mut().filter(|open| open.waits) else {
            return Ok(());
        };
        open.waits = false;
        match &mut self.reservation {
            Some(reservation) => reservation.try_grow(open.largest()),
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
    metrics: ScanMetrics,
}

/// Gives a message to the builder; a payload that is compressed on its own is decompressed first.
fn push(
    rows: &mut dyn RowBuilder,
    part: &LogPart,
    open: &Open,
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
        start: place.start,
        payload: &block.bytes[place],
        shares: open.shares || unpacked.is_some(),
    })
}

/// Messages that the index does not know of, in a unit that is read for others.
struct Strays<'a> {
    part: &'a LogPart,
    unit: &'a Unit,
    /// The last channel that was seen to be known.
    known: Option<u16>,
    /// Messages of channels that are described nowhere.
    unknown: u64,
    /// Messages of channels that the index does not list here.
    unlisted: u64,
}

impl<'a> Strays<'a> {
    fn new(part: &'a LogPart, unit: &'a Unit) -> Self {
        Self {
            part,
            unit,
            known: None,
            unknown: 0,
            unlisted: 0,
        }
    }

    fn see(&mut self, channel: u16) {
        if self.known == Some(channel) {
            return;
        }
        if !self.part.index.channels.contains_key(&channel) {
            self.unknown += 1;
        } else if !self.unit.may_hold(channel) {
            self.unlisted += 1;
        } else {
            self.known = Some(channel);
        }
    }

    fn note(self) {
        let (losses, offset) = (&self.part.losses, self.unit.offset);
        let loss = |count| Loss { count, bytes: 0 };
        // An index that was made by reading the file has told of its channels already.
        if self.unknown > 0 && self.part.index.indexed {
            let detail = "expected messages of the channels in the summary, found others";
            losses.note(Reason::UnknownChannel, offset, loss(self.unknown), detail);
        }
        if self.unlisted > 0 {
            let detail = "expected messages of the channels that the summary lists for the chunk, found others";
            losses.note(Reason::BadSummary, offset, loss(self.unlisted), detail);
        }
    }
}

/// A unit that is being read.
struct Open {
    unit: Unit,
    block: Block,
    messages: Vec<Message>,
    next: usize,
    lost: Loss,
    example: String,
    /// Its largest message waits for memory to be reserved.
    waits: bool,
    /// Whether values may keep the block.
    shares: bool,
}

impl Open {
    fn sizes(&self) -> impl Iterator<Item = usize> {
        let messages = self.messages.iter();
        messages.map(|message| message.end - message.start)
    }

    /// Bytes of the largest payload.
    fn largest(&self) -> usize {
        self.sizes().max().unwrap_or(0)
    }

    /// Bytes of all payloads.
    fn wanted(&self) -> usize {
        self.sizes().sum()
    }
}

impl Worker {
    /// Opens a unit if there is a new one, adds rows until the batch is full or the unit is done.
    fn work(
        &mut self,
        next: Option<(PlannedUnit, Bytes)>,
        ended: bool,
    ) -> Result<Vec<RecordBatch>, Fault> {
        let busy = self.metrics.busy.clone();
        let _timer = busy.timer();
        if let Some((planned, bytes)) = next {
            self.metrics.bytes.add(bytes.len());
            self.open(planned, bytes);
        }
        if self.current.as_ref().is_some_and(|open| open.waits) {
            return Ok(Vec::new());
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
        if let Some(damage) = block.damage.clone() {
            self.lose_unit(&unit, damage);
        }
        let mut strays = Strays::new(&self.part, &unit);
        let rows = &self.rows;
        let (messages, lost) = block.messages(|channel| {
            strays.see(channel);
            match &planned.channels {
                Some(channels) => channels.binary_search(&channel).is_ok(),
                None => rows.wants(channel),
            }
        });
        strays.note();
        if lost.count > 0 {
            let losses = &self.part.losses;
            losses.note(Reason::BadRecord, unit.offset, lost, "inside a chunk");
        }
        let mut open = Open {
            unit,
            block,
            messages,
            next: 0,
            lost: Loss::default(),
            example: String::new(),
            waits: false,
            shares: false,
        };
        open.waits = open.largest() > BATCH_BYTES;
        open.shares = open.wanted() >= open.block.bytes.len() / 2;
        self.current = Some(open);
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
