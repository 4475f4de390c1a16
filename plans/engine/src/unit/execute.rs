//! A unit at work.

use std::sync::Arc;
use std::time::{Duration, Instant};

use datafusion::physical_plan::display::DisplayableExecutionPlan;
use evermap_contract::Registry;
use evermap_schemas::Fault;

use crate::map::receipt::Receipt;
use crate::map::store::Store;
use crate::unit::Unit;
use crate::unit::build::Builder;
use crate::unit::work::{of_plan, share};
use crate::unit::write::write;

/// How often it is told how far a unit has come.
const TOLD_EVERY: Duration = Duration::from_secs(1);

impl Unit {
    /// Does the work: reads, runs, writes the rows. What is left to do, `keep` of what it gives, takes no cores, but waits for a
    /// disk; done twice, both leave the same. Tells from time to time that it is at work, and which share of its rows it is
    /// done with, where that is known.
    ///
    /// # Errors
    /// Whatever stops it; nothing is left behind but, perhaps, a file in `tmp/`.
    pub async fn compute(
        &self,
        registry: &Registry,
        advanced: impl Fn(Option<f64>),
    ) -> Result<Computed, Fault> {
        let (started, clock) = (chrono::Utc::now(), Instant::now());
        let store = Store::open(&self.store, false)?;
        let builder = Builder::new(self, &store, registry).await?;
        let plan = builder.plan().await?;
        let span = tracing::info_span!("unit", label = %self.label());
        let write = write(&store, Arc::clone(&plan), &builder);
        let write = tracing::Instrument::instrument(write, span);
        let (temporary, artifact, writing) = told(write, || advanced(share(&plan))).await?;
        // A receipt says what came of the logs that it names.
        builder.logs_are_the_same().await?;
        let ran = DisplayableExecutionPlan::with_metrics(plan.as_ref());
        tracing::debug!(unit = %self.label(), "\n{}", ran.indent(false));
        let receipt = Receipt {
            digest: self.recipe.digest()?,
            recipe: self.recipe.clone(),
            artifact,
            skipped: builder.skipped(),
            log_losses: builder.log_losses(),
            started: started.timestamp_nanos_opt().unwrap_or_default(),
            seconds: clock.elapsed().as_secs_f64(),
            nodes: std::iter::once(writing).chain(of_plan(&plan)).collect(),
        };
        drop(builder);
        Ok(Computed {
            store,
            temporary,
            receipt,
        })
    }
}

/// Waits for work, and tells from time to time how far it has come.
async fn told<T>(work: impl Future<Output = T>, tell: impl Fn()) -> T {
    let mut work = std::pin::pin!(work);
    let first = tokio::time::Instant::now() + TOLD_EVERY;
    let mut ticks = tokio::time::interval_at(first, TOLD_EVERY);
    loop {
        tokio::select! {
            done = &mut work => return done,
            _ = ticks.tick() => tell(),
        }
    }
}

/// What a unit computed, on its way to its lasting names.
#[derive(Debug)]
pub struct Computed {
    store: Store,
    temporary: String,
    receipt: Receipt,
}

impl Computed {
    /// The artifact gets its name, then there is a receipt.
    ///
    /// # Errors
    /// A resource fault when the store does not take them.
    pub async fn keep(self) -> Result<Receipt, Fault> {
        let name = self.receipt.artifact.name();
        self.store.settle(&self.temporary, &name).await?;
        self.receipt.write(&self.store).await?;
        Ok(self.receipt)
    }
}
