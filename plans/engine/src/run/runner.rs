//! Who runs the ready units: this process, or a cluster.

use std::convert::Infallible;
use std::sync::Arc;

use evermap_contract::Registry;
use evermap_schemas::{Fault, Kind};
use futures::StreamExt;
use futures::channel::mpsc;
use futures::stream::{BoxStream, FuturesUnordered, select};
use tokio::sync::Semaphore;

use crate::map::receipt::Receipt;
use crate::unit::Unit;

/// A unit's number in its run, and what is told of it.
pub type UnitReport = (usize, Report);

/// What is told of a unit.
#[derive(Debug)]
pub enum Report {
    /// It is at work, and done with this share of its rows; `None` where nobody knows.
    Advanced(Option<f64>),
    /// What came of it. Nothing is told after that.
    Ended(Result<Box<Receipt>, Fault>),
}

/// Held by what must end before the process does, though nobody waits for what comes of it.
pub type Unfinished = tokio::sync::mpsc::Sender<Infallible>;

/// Runs units that are ready, in any order.
pub trait Runner: Send + Sync {
    /// So many units are at work, or wait for their turn, at most; the others of a run are but numbers meanwhile.
    fn room(&self) -> usize;

    /// Runs these units; the stream ends when each has ended.
    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, UnitReport>;
}

/// Runs units in this process, a few at a time.
pub struct LocalRunner {
    registry: Registry,
    room: usize,
    computing: Arc<Semaphore>,
    keeping: Arc<Semaphore>,
}

/// Units whose rows are on their way to the disk: file systems sync many files in little more time than one.
const KEEPING: usize = 32;

impl LocalRunner {
    /// Runs `width` units side by side.
    pub fn new(registry: Registry, width: usize) -> Self {
        let width = width.max(1);
        Self {
            registry,
            room: 4 * (width + KEEPING),
            computing: Arc::new(Semaphore::new(width)),
            keeping: Arc::new(Semaphore::new(KEEPING)),
        }
    }
}

impl Runner for LocalRunner {
    fn room(&self) -> usize {
        self.room
    }

    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, UnitReport> {
        let (tell, told) = mpsc::unbounded();
        let run = |(index, unit): (usize, Unit)| {
            let registry = self.registry.clone();
            let (computing, keeping) = (Arc::clone(&self.computing), Arc::clone(&self.keeping));
            let tell = tell.clone();
            async move {
                let computes = computing.acquire_owned().await;
                let advanced = tell.clone();
                let task = tokio::spawn(async move {
                    let advance = |share| {
                        let _ = advanced.unbounded_send((index, Report::Advanced(share)));
                    };
                    let computed = unit.compute(&registry, advance).await?;
                    let _keeps = keeping.acquire_owned().await;
                    drop(computes);
                    computed.keep().await
                });
                let receipt = task.await.unwrap_or_else(|error| {
                    Err(Fault::new(Kind::Bug, format!("a unit panicked: {error}"))
                        .next("please report it"))
                });
                // Whoever listens no more does not want to know.
                let _ = tell.unbounded_send((index, Report::Ended(receipt.map(Box::new))));
            }
        };
        let running: FuturesUnordered<_> = units.into_iter().map(run).collect();
        drop(tell);
        let running = running.filter_map(async |()| None);
        select(told, running).boxed()
    }
}
