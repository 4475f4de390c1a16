//! Runs as a whole, of queries that read nothing.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_datasets::{Dataset, Manifest};
use evermap_language::Source;
use evermap_test_data::stores::{Reads, Watched};
use futures::StreamExt;
use futures::stream::BoxStream;
use object_store::path::Path;
use object_store::{Error, GetOptions, GetResult, ObjectStore, Result};
use tokio::sync::watch;

use super::*;
use crate::map::receipt::LogContent;
use crate::map::store::ARTIFACTS;
use crate::prepare::{PlanText, check};
use crate::run::runner::{LocalRunner, Report, Runner, UnitReport};
use crate::unit::Unit;

/// Four units that make three files.
const PLAN: &str = "plan: numbers
steps:
  one: { sql: SELECT 1 AS n }
  two: { sql: SELECT 2 AS n }
  three: { sql: SELECT 3 AS n }
  also_three: { sql: SELECT 3 AS n }
write: [one, two, three, also_three]
";

async fn program(registry: &Registry) -> Program {
    let plan = PlanText {
        source: Source {
            origin: "numbers.yaml".into(),
            text: PLAN.into(),
        },
        find: |name, _| Err(format!("no plan {name}")),
        settings: Vec::new(),
        manifest: None,
    };
    let logs = Dataset::open(&RuntimeEnv::default(), &[], None).await;
    let (_, program) = check(&plan, registry, &logs.unwrap()).await.unwrap();
    program
}

/// Runs a program on a session that it does not read.
async fn executed(
    store: &Store,
    program: &Program,
    registry: &Registry,
    runner: &dyn Runner,
    observe: &mut (dyn FnMut(Event<'_>) + Send),
) -> RunResult {
    let session = MappedSession {
        log: LogContent {
            session: "a".into(),
            site: "lot".into(),
            content: "a".into(),
            roles: String::new(),
        },
        manifest: Manifest::default(),
        times: None,
    };
    let base = Version::latest(store).await.unwrap();
    let run = Run {
        program,
        registry,
        store,
        sessions: &[session],
        base: base.as_ref(),
        limits: Limits::one_partition(),
    };
    match run.execute(runner, observe).await.unwrap() {
        RunEnd::Done(result) => *result,
        RunEnd::Overtaken { by } => panic!("version {by} is nobody's"),
    }
}

/// Counts how often a whole artifact is asked for, and gives none before so many are at once.
#[derive(Debug)]
struct Together {
    asked: watch::Sender<usize>,
    least: usize,
}

impl Together {
    /// How long is waited for the others. Where they are asked for one after another, they never come.
    const PATIENCE: Duration = Duration::from_secs(20);

    /// Waits until so many are asked for.
    async fn gather(&self) -> Result<()> {
        self.asked.send_modify(|asked| *asked += 1);
        let mut asked = self.asked.subscribe();
        let all = asked.wait_for(|asked| *asked >= self.least);
        let came = tokio::time::timeout(Self::PATIENCE, all).await.is_ok();
        match came {
            true => Ok(()),
            false => Err(Error::Generic {
                store: "together",
                source: "one is read after the other".into(),
            }),
        }
    }
}

#[async_trait]
impl Reads for Together {
    async fn file(
        &self,
        store: &dyn ObjectStore,
        location: &Path,
        options: GetOptions,
    ) -> Result<GetResult> {
        let is_whole = options.range.is_none() && !options.head;
        if is_whole && location.as_ref().contains(ARTIFACTS) {
            self.gather().await?;
        }
        store.get_opts(location, options).await
    }
}

#[tokio::test]
async fn what_is_reused_is_read_side_by_side_and_once() {
    let registry = Registry::default();
    let program = program(&registry).await;
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
    let runner = LocalRunner::new(registry.clone(), 2);
    let first = executed(&store, &program, &registry, &runner, &mut |_| ()).await;
    let units = first.units.iter();
    let files: BTreeSet<String> = units.map(|(_, done)| done.artifact.name()).collect();
    assert_eq!((first.units.len(), files.len()), (4, 3));

    let (asked, count) = watch::channel(0);
    let least = files.len();
    let reads = Together { asked, least };
    let store = store.over(|store| Arc::new(Watched { store, reads }));
    let again = executed(&store, &program, &registry, &runner, &mut |_| ()).await;
    assert!(again.units.iter().all(|(_, done)| done.cached));
    assert_eq!((again.published, *count.borrow()), (false, least));
}

/// Has room for few units, and counts those that it was given and that have not ended.
struct Narrow {
    local: LocalRunner,
    at_work: Arc<AtomicUsize>,
    most: AtomicUsize,
}

impl Runner for Narrow {
    fn room(&self) -> usize {
        2
    }

    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, UnitReport> {
        let given = units.len();
        let before = self.at_work.fetch_add(given, Ordering::SeqCst);
        self.most.fetch_max(before + given, Ordering::SeqCst);
        let at_work = Arc::clone(&self.at_work);
        let count = move |(_, report): &UnitReport| {
            if matches!(report, Report::Ended(_)) {
                at_work.fetch_sub(1, Ordering::SeqCst);
            }
        };
        self.local.start(units).inspect(count).boxed()
    }
}

#[tokio::test]
async fn no_more_units_are_put_together_than_a_runner_has_room_for() {
    let registry = Registry::default();
    let program = program(&registry).await;
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
    let runner = Narrow {
        local: LocalRunner::new(registry.clone(), 2),
        at_work: Arc::default(),
        most: AtomicUsize::new(0),
    };
    let result = executed(&store, &program, &registry, &runner, &mut |_| ()).await;
    assert_eq!((result.units.len(), result.published), (4, true));
    assert_eq!(runner.most.into_inner(), 2);
}

#[tokio::test]
async fn receipts_that_vanish_before_a_version_is_published_are_written_again() {
    let registry = Registry::default();
    let program = program(&registry).await;
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
    let runner = LocalRunner::new(registry.clone(), 2);
    let mut vanish = |event: Event<'_>| {
        if let Event::Done { receipt, .. } = event {
            std::fs::remove_file(folder.path().join(Receipt::name(&receipt.digest))).unwrap();
        }
    };
    let result = executed(&store, &program, &registry, &runner, &mut vanish).await;
    for (stage, done) in &result.units {
        let receipt = Receipt::read(&store, &done.digest).await.unwrap().unwrap();
        assert_eq!(receipt.recipe.digest().unwrap(), done.digest);
        assert_eq!(receipt.recipe.stages.last().unwrap().name, *stage);
        assert_eq!(receipt, done.receipt(receipt.recipe.clone()));
    }
}
