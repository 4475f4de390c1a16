//! Several at work on one map: runs beside runs, and `gc` beside runs.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use evermap_contract::Registry;
use evermap_engine::map::store::Store;
use evermap_engine::map::version::Version;
use evermap_engine::map::{gc, verify};
use evermap_engine::prepare::{PlanText, Prepared, Refusal};
use evermap_engine::run::runner::LocalRunner;
use evermap_engine::run::{RunEnd, RunResult};
use evermap_engine::sql::Limits;
use evermap_language::Source;
use evermap_schemas::Fault;
use evermap_tests::{Finished, command, evermap, rectangle, text, write_drive};
use tempfile::TempDir;

const PLAN: &str = "plan: posts
steps:
  keyframes: { op: keyframes, in: { odometry: odometry } }
  far: { sql: 'SELECT site, session, stamp FROM keyframes WHERE distance_m > 5' }
  many: { sql: 'SELECT session, count(*) AS n FROM far GROUP BY session' }
write: [keyframes, far, many]
";

/// A map with drives to run on it.
#[derive(Clone)]
struct Site {
    folder: Arc<TempDir>,
    registry: Registry,
}

impl Site {
    fn new() -> Self {
        let site = Self {
            folder: Arc::new(tempfile::tempdir().unwrap()),
            registry: evermap_catalog::registry(),
        };
        for (name, width_m) in [("a", 20.0), ("b", 30.0)] {
            write_drive(&site.log(name), rectangle(width_m, 15.0, 1.0));
        }
        site
    }

    fn log(&self, name: &str) -> PathBuf {
        self.folder.path().join(format!("{name}.mcap"))
    }

    fn map(&self) -> PathBuf {
        self.folder.path().join("map")
    }

    fn store(&self) -> Store {
        Store::open(text(&self.map()), true).unwrap()
    }

    async fn prepare(&self, log: &Path, settings: &[String]) -> Prepared {
        let plan = PlanText {
            source: Source {
                origin: "posts.yaml".into(),
                text: PLAN.into(),
            },
            find: |name, _| Err(format!("no plan {name}")),
            settings: settings.to_vec(),
            manifest: None,
        };
        let logs = [text(log).to_owned()];
        let prepared =
            Prepared::new(&plan, &self.registry, text(&self.map()), &logs, None, None).await;
        prepared.unwrap_or_else(|refusal| match refusal {
            Refusal::Plan(faults) => panic!("{}", faults.pretty()),
            Refusal::Fault(fault) => panic!("{fault}"),
        })
    }

    async fn execute(&self, prepared: &Prepared) -> Result<RunEnd, Fault> {
        let run = prepared.run(&self.registry, Limits::one_partition());
        let runner = LocalRunner::new(self.registry.clone(), 2);
        run.execute(&runner, &mut |_| ()).await
    }

    /// Runs, and again where another run was faster.
    async fn run(&self, log: &str, settings: &[String]) -> RunResult {
        loop {
            let prepared = self.prepare(&self.log(log), settings).await;
            if let RunEnd::Done(result) = self.execute(&prepared).await.unwrap() {
                return *result;
            }
        }
    }

    /// That all that the map's versions need is there.
    async fn is_whole(&self) {
        let verified = verify(&self.store(), None).await.unwrap();
        let lost = verified.findings.iter().filter(|finding| finding.is_loss());
        assert_eq!(lost.count(), 0, "{:?}", verified.findings);
    }
}

fn baseline(metres: usize) -> [String; 1] {
    [format!("keyframes.baseline_m={metres}.0")]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn gc_beside_a_hundred_runs_takes_nothing_that_they_need() {
    let site = Site::new();
    let ended = Arc::new(AtomicBool::new(false));
    let collecting = tokio::spawn({
        let (ended, store) = (Arc::clone(&ended), site.store());
        async move {
            let mut files = 0;
            while !ended.load(Ordering::Relaxed) {
                match gc(&store, 1, false).await {
                    Ok(collected) => files += collected.files,
                    Err(fault) => {
                        let said = fault.to_string();
                        let begins = ["a run is at work", "no map at", "no version yet"];
                        assert!(begins.iter().any(|why| said.contains(why)), "{said}");
                    }
                }
                tokio::task::yield_now().await;
            }
            files
        }
    });
    // Every other run makes anew what gc may just be taking as left over.
    for round in 0..100 {
        site.run("a", &baseline(1 + round % 2)).await;
        if round % 10 == 0 {
            site.is_whole().await;
        }
    }
    ended.store(true, Ordering::Relaxed);
    assert!(collecting.await.unwrap() > 0, "gc never had a turn");
    site.is_whole().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_vanishes_under_a_run_is_made_anew_before_its_version_is_published() {
    let site = Site::new();
    let ended = Arc::new(AtomicBool::new(false));
    // As gc would, were it not for leases: whatever no version needs yet.
    let taking = std::thread::spawn({
        let (ended, map) = (Arc::clone(&ended), site.map());
        move || {
            let mut taken = 0;
            while !ended.load(Ordering::Relaxed) && taken < 2 {
                let artifacts = std::fs::read_dir(map.join("artifacts"));
                for artifact in artifacts.into_iter().flatten().flatten() {
                    taken += i32::from(std::fs::remove_file(artifact.path()).is_ok());
                }
            }
            taken
        }
    });
    site.run("a", &[]).await;
    ended.store(true, Ordering::Relaxed);
    assert!(taking.join().unwrap() > 0);
    site.is_whole().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn the_loser_of_a_race_goes_on_from_the_version_that_won() {
    let site = Site::new();
    let (log_a, log_b) = (site.log("a"), site.log("b"));
    let first = site.prepare(&log_a, &[]).await;
    let (same, other) = (
        site.prepare(&log_a, &[]).await,
        site.prepare(&log_b, &[]).await,
    );
    assert!(
        matches!(site.execute(&first).await.unwrap(), RunEnd::Done(result) if result.published)
    );
    for late in [&same, &other] {
        let ended = site.execute(late).await.unwrap();
        assert!(matches!(ended, RunEnd::Overtaken { by: 1 }), "{ended:?}");
    }
    // The same run has nothing left to do; the other one adds its session.
    let again = site.prepare(&log_a, &[]).await;
    again.agrees_with(&same).unwrap();
    let ended = site.execute(&again).await.unwrap();
    assert!(matches!(ended, RunEnd::Done(result) if !result.published));
    let again = site.prepare(&log_b, &[]).await;
    again.agrees_with(&other).unwrap();
    let RunEnd::Done(result) = site.execute(&again).await.unwrap() else {
        panic!("nobody else is at work");
    };
    let sessions = result.version.sessions.iter();
    assert!(
        sessions
            .map(|session| session.log.session.as_str())
            .eq(["a", "b"])
    );

    // Another log of the same name, mapped meanwhile, is for a person to judge.
    write_drive(&log_a, rectangle(25.0, 15.0, 1.0));
    let ours = site.prepare(&log_a, &[]).await;
    let elsewhere = site.folder.path().join("elsewhere");
    std::fs::create_dir(&elsewhere).unwrap();
    write_drive(&elsewhere.join("a.mcap"), rectangle(35.0, 15.0, 1.0));
    let theirs = site.prepare(&elsewhere.join("a.mcap"), &[]).await;
    assert!(matches!(
        site.execute(&theirs).await.unwrap(),
        RunEnd::Done(_)
    ));
    let again = site.prepare(&log_a, &[]).await;
    let fault = again.agrees_with(&ours).unwrap_err().to_string();
    assert!(fault.contains("session a"), "{fault}");
}

#[test]
fn the_same_command_twice_at_once_ends_well_twice_and_makes_one_version() {
    let site = Site::new();
    let (log, map) = (site.log("a"), site.map());
    let run = [
        "run",
        "trajectory",
        "--progress",
        "none",
        "--map",
        text(&map),
        "--sessions",
    ];
    let begin = || {
        let mut run = command(&run);
        run.arg(&log).stdout(std::process::Stdio::piped());
        run.stderr(std::process::Stdio::piped()).spawn().unwrap()
    };
    for both in [begin(), begin()].map(|child| child.wait_with_output().unwrap()) {
        Finished::from(both).expect(0);
    }
    let versions = evermap(&["versions", "--map", text(&map), "--format", "json"]);
    assert_eq!(versions.expect(0).json().as_array().unwrap().len(), 1);
    // A third, after another session has come in between, with both at once.
    let mut other = command(&run);
    other.arg(site.log("b")).stdout(std::process::Stdio::null());
    let (mut again, mut other) = (begin(), other.spawn().unwrap());
    assert!(again.wait().unwrap().success() && other.wait().unwrap().success());
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let latest = runtime
        .block_on(Version::latest(&site.store()))
        .unwrap()
        .unwrap();
    assert_eq!(latest.sessions.len(), 2);
}
