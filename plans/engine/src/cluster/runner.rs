//! Waves of units, submitted as jobs until every receipt is there.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use ballista_core::serde::protobuf::scheduler_grpc_client::SchedulerGrpcClient;
use evermap_contract::Registry;
use evermap_schemas::Fault;
use futures::StreamExt;
use futures::stream::BoxStream;
use tokio::sync::mpsc;

use crate::cluster::job::{session_config, session_state, submit};
use crate::error::remote_fault;
use crate::map::receipt::Receipt;
use crate::map::store::Store;
use crate::run::runner::{Outcome, Runner};
use crate::unit::Unit;

/// How often the map store is asked for receipts.
const POLL: Duration = Duration::from_millis(300);

/// How often a wave is submitted before what is missing is given up.
const ATTEMPTS: usize = 6;

/// Runs units on a Ballista cluster.
#[derive(Clone)]
pub struct ClusterRunner {
    scheduler: String,
    registry: Registry,
    deadline: Duration,
}

impl ClusterRunner {
    /// Runs units on the cluster of the scheduler at `url` (`http://host:port`). A job in which no unit ends for
    /// `deadline` counts as hung: what is missing is submitted anew.
    pub fn new(url: &str, registry: Registry, deadline: Duration) -> Self {
        let scheduler = match url.split_once("://") {
            Some((_, address)) => format!("http://{address}"),
            None => format!("http://{url}"),
        };
        Self {
            scheduler,
            registry,
            deadline,
        }
    }

    /// Starts a scheduler and an executor inside this process, and runs units on them.
    ///
    /// # Errors
    /// A resource fault when they do not start.
    pub async fn in_process(
        registry: Registry,
        slots: usize,
        deadline: Duration,
    ) -> Result<Self, Fault> {
        let state = session_state(session_config(), &registry);
        let address = ballista_scheduler::standalone::new_standalone_scheduler_from_state(&state)
            .await
            .map_err(|error| remote_fault(&error, "the scheduler does not start"))?;
        let url = format!("http://127.0.0.1:{}", address.port());
        let client = SchedulerGrpcClient::connect(url.clone())
            .await
            .map_err(|error| remote_fault(&error, "the scheduler does not answer"))?;
        ballista_executor::new_standalone_executor_from_state(client, slots.max(1), &state)
            .await
            .map_err(|error| remote_fault(&error, "the executor does not start"))?;
        Ok(Self {
            scheduler: url,
            registry,
            deadline,
        })
    }
}

impl Runner for ClusterRunner {
    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, Outcome> {
        let (outcomes, mut received) = mpsc::unbounded_channel();
        let wave = Wave {
            cluster: self.clone(),
            outcomes,
        };
        tokio::spawn(wave.run(units));
        futures::stream::poll_fn(move |context| received.poll_recv(context)).boxed()
    }
}

/// One wave of units, from submission to the last outcome.
struct Wave {
    cluster: ClusterRunner,
    outcomes: mpsc::UnboundedSender<Outcome>,
}

type Missing = BTreeMap<usize, Unit>;

impl Wave {
    async fn run(self, units: Vec<(usize, Unit)>) {
        let mut missing: Missing = units.into_iter().collect();
        let mut reason = Fault::resource("the cluster did nothing");
        for attempt in 0..ATTEMPTS {
            if missing.is_empty() {
                return;
            }
            if attempt > 0 {
                tracing::warn!(missing = missing.len(), %reason, "submitting anew what is missing");
                tokio::time::sleep(POLL * (1 << attempt.min(5))).await;
            }
            if let Err(fault) = self.attempt(&mut missing).await {
                reason = fault;
            }
        }
        for (index, _) in missing {
            let fault = Fault::new(
                reason.kind,
                format!("{}, after {ATTEMPTS} attempts", reason.message),
            )
            .next("look at the executors' logs, then run again: what was computed is kept");
            let _ = self.outcomes.send((index, Err(fault)));
        }
    }

    /// Submits one job and follows it until it ends, or nothing has ended for as long as the deadline.
    async fn attempt(&self, missing: &mut Missing) -> Result<(), Fault> {
        let ClusterRunner {
            scheduler,
            registry,
            deadline,
        } = &self.cluster;
        let units = missing.clone();
        let mut job = std::pin::pin!(submit(scheduler, &units, registry));
        let mut progress = Instant::now();
        let ended = loop {
            match tokio::time::timeout(POLL, &mut job).await {
                Ok(ended) => break ended,
                Err(_) => {
                    if self.collect(missing).await? > 0 {
                        progress = Instant::now();
                    }
                    if missing.is_empty() {
                        return Ok(());
                    }
                    if progress.elapsed() > *deadline {
                        let waited = deadline.as_secs();
                        return Err(Fault::resource(format!(
                            "no unit of a job ended for {waited} s"
                        )));
                    }
                }
            }
        };
        self.collect(missing).await?;
        for (index, fault) in ended? {
            if missing.remove(&index).is_some() {
                let _ = self.outcomes.send((index, Err(fault)));
            }
        }
        if missing.is_empty() {
            Ok(())
        } else {
            Err(Fault::resource("a job ended without all its receipts"))
        }
    }

    /// Takes the receipts that have come in; how many there were.
    async fn collect(&self, missing: &mut Missing) -> Result<usize, Fault> {
        let mut found = Vec::new();
        for (index, unit) in missing.iter() {
            let store = Store::open(&unit.store, false)?;
            if let Some(receipt) = Receipt::find(&store, &unit.recipe.digest()?).await? {
                found.push((*index, receipt));
            }
        }
        let count = found.len();
        for (index, receipt) in found {
            missing.remove(&index);
            let _ = self.outcomes.send((index, Ok(receipt)));
        }
        Ok(count)
    }
}
