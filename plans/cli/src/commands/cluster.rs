//! `evermap scheduler`, `evermap executor`, and both within the process of a run.

use std::time::Duration;

use evermap_contract::Registry;
use evermap_engine::cluster::{self, ClusterRunner, ExecutorOptions};
use evermap_engine::run::runner::{Runner, Unfinished, UnitReport};
use evermap_engine::sql::Limits;
use evermap_engine::temporary::WorkFolder;
use evermap_engine::unit::Unit;
use evermap_schemas::Fault;
use futures::stream::BoxStream;

use crate::arguments::{ExecutorArgs, SchedulerArgs};
use crate::ending::{DONE, Ending};
use crate::operators;
use crate::progress::line;

/// Serves as a scheduler until stopped.
///
/// # Errors
/// A resource fault when the address is taken, a user fault for a host that has none.
pub async fn scheduler(args: &SchedulerArgs) -> Ending {
    let (host, port) = &args.bind;
    line(&format!("scheduler on {host}:{port}"));
    cluster::scheduler(host, *port, operators::registry()).await?;
    DONE
}

/// Serves as an executor until stopped.
///
/// # Errors
/// A resource fault when its address is taken, when no scheduler answers in time or when it cannot start; a user fault for
/// a host that has no address.
pub async fn executor(args: &ExecutorArgs) -> Ending {
    let work = WorkFolder::new()?;
    let slots = args
        .jobs
        .map_or_else(|| Limits::default().partitions, |jobs| jobs as usize);
    let (host, port) = args.bind.clone();
    line(&format!(
        "executor on {host}:{port} for {}:{}, {slots} units side by side",
        args.scheduler.0, args.scheduler.1
    ));
    let options = ExecutorOptions {
        scheduler: args.scheduler.clone(),
        host,
        port,
        slots,
        work_dir: work.path().display().to_string(),
    };
    let wait = Duration::from_secs(args.wait_s);
    match cluster::executor(options, wait, operators::registry()).await? {}
}

/// Runs units on a cluster inside this process, whose temporary files go with it.
pub struct WithinProcess {
    cluster: ClusterRunner,
    _work: WorkFolder,
}

impl WithinProcess {
    /// Starts the cluster. See [`ClusterRunner::in_process`].
    ///
    /// # Errors
    /// A resource fault when it does not start.
    pub async fn new(
        registry: Registry,
        slots: usize,
        deadline: Duration,
        unfinished: &Unfinished,
    ) -> Result<Self, Fault> {
        let work = WorkFolder::new()?;
        let cluster =
            ClusterRunner::in_process(registry, slots, work.path(), deadline, unfinished).await?;
        Ok(Self {
            cluster,
            _work: work,
        })
    }
}

impl Runner for WithinProcess {
    fn room(&self) -> usize {
        self.cluster.room()
    }

    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, UnitReport> {
        self.cluster.start(units)
    }
}
