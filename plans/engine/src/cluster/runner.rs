//! Waves of units, submitted as jobs until every receipt is there.

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::path::Path;
use std::time::{Duration, Instant};

use ballista_core::serde::protobuf::PartitionLocation;
use evermap_contract::Registry;
use evermap_schemas::Fault;
use futures::StreamExt;
use futures::stream::BoxStream;
use tokio::net::TcpListener;
use tokio::sync::mpsc;

use crate::cluster::job::{UnitTexts, session_config, session_state, unit_text};
use crate::cluster::note::{self, Others};
use crate::cluster::scheduler::{Job, JobState, Scheduler, failures};
use crate::cluster::serve::{ExecutorOptions, serve_units};
use crate::error::remote_fault;
use crate::map::receipt::Receipt;
use crate::map::store::{Store, each};
use crate::run::runner::{Report, Runner, Unfinished, UnitReport};
use crate::unit::Unit;

/// How often the map store is asked for receipts.
const POLL: Duration = Duration::from_millis(300);

/// How often jobs may fail one after another, without a unit ending, before what is missing is given up.
const FAILURES: usize = 6;

/// Longest pause before what is missing is submitted anew.
const PAUSE: Duration = Duration::from_secs(5);

/// How long a scheduler that is asked shortly before the deadline has to answer: one that works does.
const LAST_CALL: Duration = Duration::from_secs(1);

/// Bytes of units in one job, unless one unit has more. Each task of a job is sent all of its units, so large jobs cost
/// the square; a message may have 16 MiB.
const JOB_BYTES: usize = 1 << 20;

/// Runs units on a Ballista cluster. When nobody waits for them any more, their jobs are cancelled.
#[derive(Clone)]
pub struct ClusterRunner {
    scheduler: String,
    registry: Registry,
    deadline: Duration,
    /// Held while jobs are open.
    _unfinished: Unfinished,
}

impl ClusterRunner {
    /// Runs units on the cluster of the scheduler at `url` (`http://host:port`), and gives up when none has ended for as
    /// long as the deadline.
    pub fn new(url: &str, registry: Registry, deadline: Duration, unfinished: &Unfinished) -> Self {
        let scheduler = match url.split_once("://") {
            Some((_, address)) => format!("http://{address}"),
            None => format!("http://{url}"),
        };
        Self {
            scheduler,
            registry,
            deadline,
            _unfinished: unfinished.clone(),
        }
    }

    /// Starts a scheduler and an executor inside this process, and runs units on them. Ballista's own files are in
    /// `work_dir`.
    ///
    /// # Errors
    /// A resource fault when they do not start.
    pub async fn in_process(
        registry: Registry,
        slots: usize,
        work_dir: &Path,
        deadline: Duration,
        unfinished: &Unfinished,
    ) -> Result<Self, Fault> {
        let state = session_state(session_config(), &registry);
        let scheduler = ballista_scheduler::standalone::new_standalone_scheduler_from_state(&state)
            .await
            .map_err(|error| remote_fault(&error, "the scheduler does not start"))?;
        let (host, of_executor) = (Ipv4Addr::LOCALHOST, "the executor does not start");
        let listener = TcpListener::bind((host, 0)).await;
        let listener = listener.map_err(|error| remote_fault(&error, of_executor))?;
        let address = listener.local_addr();
        let address = address.map_err(|error| remote_fault(&error, of_executor))?;
        let options = ExecutorOptions {
            scheduler: (host.to_string(), scheduler.port()),
            host: host.to_string(),
            port: address.port(),
            slots,
            work_dir: work_dir.display().to_string(),
        };
        let operators = registry.clone();
        tokio::spawn(async move {
            let Err(fault) = serve_units(listener, address, options, &operators).await;
            tracing::warn!("nobody is left to run units: {fault}");
        });
        let url = format!("http://{host}:{}", scheduler.port());
        Ok(Self::new(&url, registry, deadline, unfinished))
    }
}

impl Runner for ClusterRunner {
    // Of all units that are ready a few jobs are made.
    fn room(&self) -> usize {
        usize::MAX
    }

    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, UnitReport> {
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
    outcomes: mpsc::UnboundedSender<UnitReport>,
}

type Missing = BTreeMap<usize, Unit>;

/// Why an attempt has not done everything.
enum Lost {
    /// The cluster cannot be reached, or has nobody to work: that may change.
    Cluster(Fault),
    /// A job failed.
    Job(Fault),
    /// No unit has ended for as long as the deadline.
    Deadline,
    /// Nobody waits for the outcomes any more: the run was stopped.
    Run,
}

impl From<Fault> for Lost {
    fn from(fault: Fault) -> Self {
        Self::Cluster(fault)
    }
}

impl Wave {
    async fn run(self, units: Vec<(usize, Unit)>) {
        let mut missing: Missing = units.into_iter().collect();
        let (mut progress, mut failures, mut pause) = (Instant::now(), 0, POLL);
        let mut reason = None;
        while !missing.is_empty() {
            let before = missing.len();
            let lost = match self.attempt(&mut missing, &mut progress).await {
                Ok(()) => continue,
                Err(lost) => lost,
            };
            if missing.len() < before {
                (failures, pause) = (0, POLL);
            }
            match lost {
                Lost::Cluster(fault) => reason = Some(fault),
                Lost::Job(fault) => {
                    failures += 1;
                    reason = Some(fault);
                }
                Lost::Deadline => {}
                Lost::Run => return,
            }
            if failures == FAILURES || progress.elapsed() >= self.cluster.deadline {
                let fault = self.given_up(failures, reason);
                return self.give_up(missing, &fault);
            }
            if let Some(reason) = &reason {
                tracing::warn!(missing = missing.len(), %reason, "submitting anew what is missing");
            }
            tokio::select! {
                () = tokio::time::sleep(pause.min(self.left(progress))) => {}
                () = self.outcomes.closed() => return,
            }
            pause = (pause * 2).min(PAUSE);
        }
    }

    /// What is left of the deadline when a unit ended last at this instant.
    fn left(&self, progress: Instant) -> Duration {
        self.cluster.deadline.saturating_sub(progress.elapsed())
    }

    /// The scheduler's answer to a call, waited for no longer than the deadline allows.
    async fn in_time<T>(
        &self,
        progress: Instant,
        call: impl Future<Output = Result<T, Fault>>,
    ) -> Result<T, Lost> {
        match tokio::time::timeout(self.left(progress).max(LAST_CALL), call).await {
            Ok(answer) => answer.map_err(Lost::Cluster),
            Err(_) => {
                let silent = format!("the cluster of {} does not answer", self.cluster.scheduler);
                Err(Lost::Cluster(Fault::resource(silent)))
            }
        }
    }

    fn given_up(&self, failures: usize, reason: Option<Fault>) -> Fault {
        let waited = format!(
            "no unit has ended for {} s",
            self.cluster.deadline.as_secs()
        );
        let fault = match reason {
            Some(fault) if failures == FAILURES => Fault::new(
                fault.kind,
                format!("{}, {FAILURES} times in a row", fault.message),
            ),
            Some(fault) => Fault::resource(format!("{waited}: {}", fault.message)),
            None => Fault::resource(waited),
        };
        fault.next("look at the executors' logs, or allow more with --deadline-s, then run again: what was computed is kept")
    }

    fn ended(&self, unit: usize, outcome: Result<Box<Receipt>, Fault>) {
        let _ = self.outcomes.send((unit, Report::Ended(outcome)));
    }

    fn give_up(&self, missing: Missing, fault: &Fault) {
        for (index, _) in missing {
            self.ended(index, Err(fault.clone()));
        }
    }

    /// Submits jobs of what has no receipt yet, and that nobody is at work on, and follows them until they end, nothing has ended
    /// for as long as the deadline, or the run was stopped. Those that are open then are cancelled.
    async fn attempt(&self, missing: &mut Missing, progress: &mut Instant) -> Result<(), Lost> {
        // Units that ran when an attempt was given up may have ended since.
        let all: Vec<usize> = missing.keys().copied().collect();
        self.collect(&all, missing, progress).await?;
        // Such as another run gave up: to be begun once.
        let mut others = Others::new(&note::at_work(missing).await?);
        let waited_for = others.units().len();
        if waited_for > 0 {
            tracing::info!(waited_for, "executors are at work on units already");
        }
        let connecting = Scheduler::connect(&self.cluster.scheduler);
        let mut scheduler = self.in_time(*progress, connecting).await?;
        let mut jobs = Vec::new();
        let free = missing.iter().filter(|(index, _)| !others.has(**index));
        let free = portions(free)?;
        let mut ended = self
            .submit(&mut scheduler, &mut jobs, free, *progress)
            .await;
        if ended.is_ok() {
            ended = tokio::select! {
                ended = self.follow(&mut scheduler, &mut jobs, &mut others, missing, progress) => ended,
                () = self.outcomes.closed() => Err(Lost::Run),
            };
        }
        scheduler.cancel(jobs).await;
        ended
    }

    /// Submits a job for each of these portions, which come to the others.
    async fn submit(
        &self,
        scheduler: &mut Scheduler,
        jobs: &mut Vec<Job>,
        portions: Vec<UnitTexts>,
        progress: Instant,
    ) -> Result<(), Lost> {
        for units in portions {
            let submitting = scheduler.submit(units, &self.cluster.registry);
            jobs.push(self.in_time(progress, submitting).await?);
        }
        Ok(())
    }

    /// Follows jobs; those that have ended are taken out. So are the units that others are at work on: once nobody is, they are
    /// submitted.
    async fn follow(
        &self,
        scheduler: &mut Scheduler,
        jobs: &mut Vec<Job>,
        others: &mut Others,
        missing: &mut Missing,
        progress: &mut Instant,
    ) -> Result<(), Lost> {
        let mut looked = Instant::now();
        while !jobs.is_empty() || !others.is_empty() {
            tokio::time::sleep(POLL).await;
            self.collect(&others.units(), missing, progress).await?;
            others.retain(|unit| missing.contains_key(&unit));
            if looked.elapsed() >= note::EVERY {
                let left = self.look(missing, others).await;
                // A note is removed when the receipt is there.
                self.collect(&left, missing, progress).await?;
                let left = left.iter().filter_map(|unit| missing.get_key_value(unit));
                let left = portions(left)?;
                self.submit(scheduler, jobs, left, *progress).await?;
                looked = Instant::now();
            }
            let mut index = 0;
            while let Some(job) = jobs.get(index) {
                let state = self.in_time(*progress, scheduler.state(job)).await?;
                self.collect(&job.units, missing, progress).await?;
                match state {
                    JobState::Open => {
                        index += 1;
                        continue;
                    }
                    JobState::Failed(fault) => return Err(Lost::Job(fault)),
                    JobState::Ended(answer) => {
                        self.end(&jobs.remove(index), answer, missing).await?
                    }
                }
            }
            let is_waiting = !jobs.is_empty() || !others.is_empty();
            if progress.elapsed() >= self.cluster.deadline && is_waiting {
                return Err(Lost::Deadline);
            }
        }
        Ok(())
    }

    /// Tells how far units have come that executors are at work on, and takes out those of others that nobody is at work on any
    /// more.
    async fn look(&self, missing: &Missing, others: &mut Others) -> Vec<usize> {
        let found = match note::at_work(missing).await {
            Ok(found) => found,
            Err(fault) => {
                tracing::debug!("cannot read which units are running: {fault}");
                return Vec::new();
            }
        };
        let left = others.left(&found, tokio::time::Instant::now());
        for (index, note) in found {
            let _ = self.outcomes.send((index, Report::Advanced(note.share)));
        }
        left
    }

    /// Takes what failed in a job that has ended.
    async fn end(
        &self,
        job: &Job,
        answer: Vec<PartitionLocation>,
        missing: &mut Missing,
    ) -> Result<(), Lost> {
        if job.units.iter().all(|unit| !missing.contains_key(unit)) {
            return Ok(());
        }
        for (unit, fault) in failures(answer).await.map_err(Lost::Job)? {
            if missing.remove(&unit).is_some() {
                self.ended(unit, Err(fault));
            }
        }
        match job.units.iter().any(|unit| missing.contains_key(unit)) {
            true => Err(Lost::Job(Fault::resource(
                "a job ended without all its receipts",
            ))),
            false => Ok(()),
        }
    }

    /// Takes the receipts of these units that have come in.
    async fn collect(
        &self,
        units: &[usize],
        missing: &mut Missing,
        progress: &mut Instant,
    ) -> Result<(), Fault> {
        let asked = units
            .iter()
            .filter_map(|index| missing.get_key_value(index));
        let found = each(asked.map(async |(index, unit)| {
            let store = Store::open(&unit.store, false)?;
            let receipt = Receipt::find(&store, &unit.recipe.digest()?).await?;
            Ok(receipt.map(|receipt| (*index, receipt)))
        }));
        for (index, receipt) in found.await?.into_iter().flatten() {
            *progress = Instant::now();
            missing.remove(&index);
            self.ended(index, Ok(Box::new(receipt)));
        }
        Ok(())
    }
}

/// Units in jobs of [`JOB_BYTES`].
fn portions<'u>(
    units: impl Iterator<Item = (&'u usize, &'u Unit)>,
) -> Result<Vec<UnitTexts>, Fault> {
    let mut portions = Vec::new();
    let (mut portion, mut bytes) = (UnitTexts::new(), 0);
    for (index, unit) in units {
        let text = unit_text(unit)?;
        if bytes > 0 && bytes + text.len() > JOB_BYTES {
            portions.push(std::mem::take(&mut portion));
            bytes = 0;
        }
        bytes += text.len();
        portion.insert(*index, text);
    }
    if !portion.is_empty() {
        portions.push(portion);
    }
    Ok(portions)
}
