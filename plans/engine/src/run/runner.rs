//! Who runs the ready units: this process, or a cluster.

use std::convert::Infallible;
use std::sync::Arc;

use evermap_contract::Registry;
use evermap_schemas::{Fault, Kind};
use futures::StreamExt;
use futures::stream::{BoxStream, FuturesUnordered};

use crate::map::receipt::Receipt;
use crate::unit::Unit;

/// A unit's number in its run, and what came of it.
pub type Outcome = (usize, Result<Receipt, Fault>);

/// Held by what must end before the process does, though nobody waits for what comes of it.
pub type Unfinished = tokio::sync::mpsc::Sender<Infallible>;

/// Runs units that are ready, in any order.
pub trait Runner: Send + Sync {
    /// Runs these units; the stream ends when each has an outcome.
    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, Outcome>;
}

/// Runs units in this process, a few at a time.
pub struct LocalRunner {
    registry: Registry,
    slots: Arc<tokio::sync::Semaphore>,
}

impl LocalRunner {
    /// Runs `width` units side by side.
    pub fn new(registry: Registry, width: usize) -> Self {
        Self {
            registry,
            slots: Arc::new(tokio::sync::Semaphore::new(width.max(1))),
        }
    }
}

impl Runner for LocalRunner {
    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, Outcome> {
        let run = |(index, unit): (usize, Unit)| {
            let (registry, slots) = (self.registry.clone(), Arc::clone(&self.slots));
            async move {
                let _slot = slots.acquire_owned().await;
                let task = tokio::spawn(async move { unit.run(&registry).await });
                let receipt = task.await.unwrap_or_else(|error| {
                    Err(Fault::new(Kind::Bug, format!("a unit panicked: {error}"))
                        .next("please report it"))
                });
                (index, receipt)
            }
        };
        let running: FuturesUnordered<_> = units.into_iter().map(run).collect();
        running.boxed()
    }
}
