//! The stream of one partition's rows from one file: fetch a stretch of units, open one after the other, fill batches,
//! and so on.
//!
//! Fetching is asynchronous and, where there is memory for it, one stretch ahead; everything that costs CPU time runs on
//! the blocking pool. At any moment a stream holds one opened unit, two stretches and one batch, and has reserved that
//! much before it fetches or decompresses. Where a stretch finds no memory, units are fetched one by one; a chunk that
//! finds none is read by portions.

use std::collections::VecDeque;
use std::sync::Arc;

use arrow::array::RecordBatch;
use bytes::Bytes;
use datafusion::common::runtime::SpawnedTask;
use datafusion::error::{DataFusionError, Result};
use datafusion::execution::memory_pool::{MemoryConsumer, MemoryPool, MemoryReservation};
use datafusion::physical_plan::metrics::{Count, ExecutionPlanMetricsSet, MetricBuilder, Time};
use evermap_schemas::Fault;
use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};

use crate::fault::external;
use crate::log::chunk::ChunkHead;
use crate::log::index::UnitKind;
use crate::log::unpack::LARGEST_CHUNK;
use crate::log::walk::{Feed, joined};
use crate::log::window::{STRETCH_BYTES, fetch_all};
use crate::scan::plan::PlannedUnit;
use crate::scan::portions::{Portions, STREAMED_BYTES, begin};
use crate::scan::rows::RowBuilder;
use crate::scan::stretch::Stretch;
use crate::scan::worker::{Next, Units, Worker};
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
            waiting: VecDeque::new(),
            current: None,
            portions: None,
            metrics: job.metrics,
        },
        units: job.units.into(),
        most: Some(0),
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
    /// Bytes of the next stretch at most, beside its first unit: few at first, as a query may want no more; `None` where
    /// units are fetched one by one.
    most: Option<u64>,
    fetched: Option<(Stretch, Fetch)>,
    /// What fetches the chunk that is read by portions.
    feed: Option<Feed>,
    pool: Option<Arc<dyn MemoryPool>>,
    reservation: Option<MemoryReservation>,
    ended: bool,
}

/// A stretch on its way.
type Fetch = SpawnedTask<Result<Vec<Bytes>, Fault>>;

impl Scan {
    /// The next batches, or the end.
    async fn step(mut self) -> Result<Option<(Vec<RecordBatch>, Self)>> {
        loop {
            if self.ended {
                return Ok(None);
            }
            let next = self.next().await?;
            let worker = &self.worker;
            self.ended = next.is_none() && worker.is_idle();
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
            (None, None) if !self.worker.is_idle() => Ok(None),
            (None, None) => self.next_units().await,
        }
    }

    /// The next units: whole, or by portions where it is a chunk that finds no memory.
    async fn next_units(&mut self) -> Result<Option<Next>> {
        loop {
            let (stretch, fetch) = match self.fetched.take() {
                Some((stretch, fetch)) => (stretch, Some(fetch)),
                None => match self.stretch() {
                    Some(stretch) => (stretch, None),
                    None => return Ok(None),
                },
            };
            let mut units = match self.whole(stretch, fetch).await? {
                Ok(units) => return Ok(Some(Next::Units(units))),
                Err((stretch, _)) if stretch.units.len() > 1 => {
                    self.put_back(Some(stretch));
                    self.most = None;
                    continue;
                }
                Err((stretch, refused)) => match stretch.units.front() {
                    Some(planned) if planned.unit.kind == UnitKind::Chunk => stretch.units,
                    _ => return Err(refused),
                },
            };
            if let Some(planned) = units.pop_front()
                && let Some(portions) = self.portions(planned).await?
            {
                return Ok(Some(Next::Chunk(Box::new(portions))));
            }
        }
    }

    /// The next stretch of units to be fetched.
    fn stretch(&mut self) -> Option<Stretch> {
        let mut stretch = Stretch::from_iter([self.units.pop_front()?]);
        let Some(most) = self.most else {
            return Some(stretch);
        };
        self.most = Some((2 * most).clamp(STRETCH_BYTES / 64, STRETCH_BYTES));
        let units = &mut self.units;
        while let Some(next) = units.pop_front_if(|next| stretch.takes(&next.unit, most)) {
            stretch.push(next);
        }
        Some(stretch)
    }

    /// Gives back these units, and behind them those that are being fetched ahead: they are to be fetched again.
    fn put_back(&mut self, stretch: Option<Stretch>) {
        let ahead = self.fetched.take().map(|(ahead, _)| ahead);
        for stretch in ahead.into_iter().chain(stretch) {
            for planned in stretch.units.into_iter().rev() {
                self.units.push_front(planned);
            }
        }
    }

    /// The units of a stretch, while the one behind it is fetched; inside, that it finds no memory.
    async fn whole(
        &mut self,
        stretch: Stretch,
        fetch: Option<Fetch>,
    ) -> Result<Result<Units, (Stretch, DataFusionError)>> {
        if let Err(refused) = self.reserve(stretch.length(), stretch.opened()) {
            return Ok(Err((stretch, refused)));
        }
        let fetch = fetch.unwrap_or_else(|| self.fetch(&stretch));
        self.fetch_ahead();
        let fetched = joined(fetch).await.flatten().map_err(external)?;
        let (length, opened) = (stretch.length(), stretch.opened());
        let units = stretch.cut(&fetched);
        // What a chunk itself claims counts, if the index is too modest.
        let claims = units
            .iter()
            .filter(|(planned, _)| planned.unit.kind == UnitKind::Chunk);
        let claims = claims.filter_map(|(_, bytes)| ChunkHead::parse(bytes).ok());
        let claimed = claims.map(|head| head.size).max().unwrap_or(0);
        if claimed > opened
            && let Err(refused) = self.reserve(length, claimed)
        {
            let units = units.into_iter().map(|(planned, _)| planned);
            return Ok(Err((units.collect(), refused)));
        }
        Ok(Ok(units))
    }

    /// Begins to read a chunk by portions; none where nothing of it can be used.
    async fn portions(&mut self, planned: PlannedUnit) -> Result<Option<Portions>> {
        self.put_back(None);
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

    fn fetch(&self, stretch: &Stretch) -> Fetch {
        let (part, ranges) = (Arc::clone(&self.worker.part), stretch.ranges());
        SpawnedTask::spawn(async move { fetch_all(&part.store, &part.meta, ranges).await })
    }

    /// Begins to fetch the next stretch, where there is memory for it.
    fn fetch_ahead(&mut self) {
        let Some(stretch) = self.stretch() else {
            return;
        };
        let length = usize::try_from(stretch.length()).unwrap_or(usize::MAX);
        match self.grow(length) {
            Ok(()) => {
                let fetch = self.fetch(&stretch);
                self.fetched = Some((stretch, fetch));
            }
            Err(_) => self.put_back(Some(stretch)),
        }
    }
}

/// What is reserved.
impl Scan {
    /// Reserves the memory for a stretch of so many bytes, for its largest unit once it is opened, for the stretch that is
    /// fetched already, and for a batch.
    fn reserve(&mut self, length: u64, opened: u64) -> Result<()> {
        let opened = opened.min(LARGEST_CHUNK);
        let ahead = self.fetched.as_ref();
        let bytes = [
            length,
            opened,
            ahead.map_or(0, |(stretch, _)| stretch.length()),
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
