//! The stream of one partition's rows from one file: fetch a unit, open it, fill a batch, and so on.
//!
//! Fetching is asynchronous and, where there is memory for it, one unit ahead; everything that costs CPU time runs on
//! the blocking pool. At any moment a stream holds one opened unit, one fetched one and one batch, and has reserved that
//! much before it fetches or decompresses. A chunk that finds no memory is read by portions.

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
use crate::log::chunk::ChunkHead;
use crate::log::index::{Unit, UnitKind};
use crate::log::unpack::LARGEST_CHUNK;
use crate::log::walk::{Feed, joined};
use crate::log::window::fetch;
use crate::scan::plan::PlannedUnit;
use crate::scan::portions::{Portions, STREAMED_BYTES, begin};
use crate::scan::rows::RowBuilder;
use crate::scan::worker::{Next, Worker};
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
    pub busy: Time,
    pub bytes: Count,
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
            portions: None,
            metrics: job.metrics,
        },
        units: job.units.into(),
        fetched: None,
        feed: None,
        pool: job.pool,
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
    fetched: Option<(PlannedUnit, Fetch)>,
    /// What fetches the chunk that is read by portions.
    feed: Option<Feed>,
    pool: Option<Arc<dyn MemoryPool>>,
    reservation: Option<MemoryReservation>,
    ended: bool,
}

/// A unit on its way.
type Fetch = SpawnedTask<Result<Bytes, Fault>>;

impl Scan {
    /// The next batches, or the end.
    async fn step(mut self) -> Result<Option<(Vec<RecordBatch>, Self)>> {
        loop {
            if self.ended {
                return Ok(None);
            }
            let next = self.next().await?;
            let worker = &self.worker;
            let idle = worker.current.is_none() && worker.portions.is_none();
            self.ended = next.is_none() && idle;
            let ended = self.ended;
            let mut worker = self.worker;
            let (returned, batches) = joined(SpawnedTask::spawn_blocking(move || {
                let batches = worker.work(next, ended);
                (worker, batches)
            }))
            .await
            .map_err(external)?;
            self.worker = returned;
            if self.worker.portions.is_none()
                && let Some(feed) = self.feed.take()
            {
                // What the store says comes before what a chunk seems to lack.
                joined(feed).await.flatten().map_err(external)?;
            }
            let batches = batches.map_err(external)?;
            if !batches.is_empty() {
                return Ok(Some((batches, self)));
            }
        }
    }

    /// What there is to work on beside what the worker has; its memory is reserved.
    async fn next(&mut self) -> Result<Option<Next>> {
        match (&self.worker.current, &self.worker.portions) {
            (Some(_), _) => self.reserve_largest().map(|()| None),
            (None, Some(_)) => self.reserve_portion().map(|()| None),
            (None, None) => self.next_unit().await,
        }
    }

    /// The next unit: whole, or by portions where it is a chunk that finds no memory.
    async fn next_unit(&mut self) -> Result<Option<Next>> {
        loop {
            let (planned, fetch) = match self.fetched.take() {
                Some((planned, fetch)) => (planned, Some(fetch)),
                None => match self.units.pop_front() {
                    Some(planned) => (planned, None),
                    None => return Ok(None),
                },
            };
            match self.whole(&planned.unit, fetch).await? {
                Ok(bytes) => return Ok(Some(Next::Unit(planned, bytes))),
                Err(refused) if planned.unit.kind != UnitKind::Chunk => return Err(refused),
                Err(_) => {}
            }
            if let Some(portions) = self.portions(planned).await? {
                return Ok(Some(Next::Chunk(Box::new(portions))));
            }
        }
    }

    /// All of a unit, while the one behind it is fetched; inside, that it finds no memory.
    async fn whole(&mut self, unit: &Unit, fetch: Option<Fetch>) -> Result<Result<Bytes>> {
        if let Err(refused) = self.reserve(unit, unit.size) {
            return Ok(Err(refused));
        }
        let fetch = fetch.unwrap_or_else(|| self.fetch(unit));
        self.fetch_ahead();
        let bytes = joined(fetch).await.flatten().map_err(external)?;
        // What the chunk itself claims counts, if the index is too modest.
        if unit.kind == UnitKind::Chunk
            && let Ok(head) = ChunkHead::parse(&bytes)
            && head.size > unit.size
            && let Err(refused) = self.reserve(unit, head.size)
        {
            return Ok(Err(refused));
        }
        Ok(Ok(bytes))
    }

    /// Begins to read a chunk by portions; none where nothing of it can be used.
    async fn portions(&mut self, planned: PlannedUnit) -> Result<Option<Portions>> {
        if let Some((ahead, _)) = self.fetched.take() {
            self.units.push_front(ahead);
        }
        self.reserve_portion()?;
        let PlannedUnit { unit, channels } = planned;
        let (part, rows) = (&self.worker.part, &self.worker.rows);
        let all = part.index.channels.keys().copied();
        let channels = channels.unwrap_or_else(|| all.filter(|id| rows.wants(*id)).collect());
        let begun = begin(part, &unit, channels, self.pool.clone()).await;
        let (portions, damage) = match begun.map_err(external)? {
            Ok(begun) => {
                self.feed = Some(begun.feed);
                (Some(begun.portions), begun.damage)
            }
            Err(damage) => (None, Some(damage)),
        };
        if let Some(damage) = damage {
            self.worker.lose_unit(&unit, damage);
        }
        Ok(portions)
    }

    fn fetch(&self, unit: &Unit) -> Fetch {
        let (part, range) = (Arc::clone(&self.worker.part), unit.offset..unit.end());
        SpawnedTask::spawn(async move { fetch(&part.store, &part.meta.location, range).await })
    }

    /// Begins to fetch the next unit, where there is memory for it.
    fn fetch_ahead(&mut self) {
        let Some(planned) = self.units.pop_front() else {
            return;
        };
        let length = usize::try_from(planned.unit.length).unwrap_or(usize::MAX);
        match self.grow(length) {
            Ok(()) => {
                let fetch = self.fetch(&planned.unit);
                self.fetched = Some((planned, fetch));
            }
            Err(_) => self.units.push_front(planned),
        }
    }
}

/// What is reserved.
impl Scan {
    /// Reserves the memory for a unit of which so many bytes come out, for the one that is fetched already, and for a
    /// batch.
    fn reserve(&mut self, unit: &Unit, size: u64) -> Result<()> {
        let opened = size.min(LARGEST_CHUNK);
        let ahead = self.fetched.as_ref();
        let bytes = [
            unit.length,
            opened,
            ahead.map_or(0, |(planned, _)| planned.unit.length),
            opened.min(2 * BATCH_BYTES as u64),
        ];
        self.resize(bytes.into_iter().fold(0, u64::saturating_add))
    }

    /// Reserves the memory for a portion, and for a batch.
    fn reserve_portion(&mut self) -> Result<()> {
        self.resize(STREAMED_BYTES + 2 * BATCH_BYTES as u64)
    }

    /// Reserves the memory for the row of the largest message of a unit that was opened, where that is beyond a batch.
    fn reserve_largest(&mut self) -> Result<()> {
        let Some(open) = self.worker.current.as_mut().filter(|open| open.waits) else {
            return Ok(());
        };
        open.waits = false;
        let largest = open.largest();
        self.grow(largest)
    }

    fn resize(&mut self, bytes: u64) -> Result<()> {
        let bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
        match &mut self.reservation {
            Some(reservation) => reservation.try_resize(bytes),
            None => Ok(()),
        }
    }

    fn grow(&mut self, bytes: usize) -> Result<()> {
        match &mut self.reservation {
            Some(reservation) => reservation.try_grow(bytes),
            None => Ok(()),
        }
    }
}
