//! One machine or many: the same layers, digest for digest, even when executors die.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU16, Ordering};
use std::time::{Duration, Instant};

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use evermap_tests::park::made_once;
use evermap_tests::{
    command, command_that_hangs_up, evermap, layers_of, rectangle, text, write_drive,
};
use tempfile::TempDir;

/// Stops with the test, however the test ends.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn begin(command: &mut Command) -> Process {
    let command = command.stdout(Stdio::null()).stderr(Stdio::null());
    Process(command.spawn().expect("evermap starts"))
}

/// Waits for something that comes within a minute.
fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < Duration::from_secs(60), "never: {what}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// A port that nothing listens on, and the next one neither. The system gives none of these to whoever asks for just any
/// port, and no two tests get the same.
fn free_port() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let begin = u16::try_from(std::process::id() % 100).unwrap() * 200;
    loop {
        let port = 10_000 + begin + 2 * (NEXT.fetch_add(1, Ordering::Relaxed) % 100);
        let free = |port| TcpListener::bind(("127.0.0.1", port)).is_ok();
        if free(port) && free(port + 1) {
            return port;
        }
    }
}

fn listening(host: &str, port: u16) {
    until(&format!("{host}:{port} listens"), || {
        std::net::TcpStream::connect((host, port)).is_ok()
    });
}

/// A scheduler's place, and what its executors share.
struct Cluster {
    /// What its processes call this machine.
    host: &'static str,
    scheduler: u16,
    /// For temporary files.
    temporary: TempDir,
}

impl Cluster {
    fn new() -> Self {
        Self::at("127.0.0.1")
    }

    fn at(host: &'static str) -> Self {
        Self {
            host,
            scheduler: free_port(),
            temporary: tempfile::tempdir().unwrap(),
        }
    }

    fn address(&self) -> String {
        format!("{}:{}", self.host, self.scheduler)
    }

    fn scheduler(&self) -> Process {
        let process = begin(&mut command(&["scheduler", "--bind", &self.address()]));
        listening(self.host, self.scheduler);
        process
    }

    fn executor(&self) -> Process {
        begin(&mut self.executor_command())
    }

    /// An executor of one unit at a time, not yet started.
    fn executor_command(&self) -> Command {
        let scheduler = self.address();
        let bind = format!("{}:{}", self.host, free_port());
        let mut executor = command_that_hangs_up(&[
            "executor",
            "--scheduler",
            &scheduler,
            "--bind",
            &bind,
            "--jobs",
            "1",
        ]);
        executor.env("TMPDIR", self.temporary.path());
        executor
    }

    /// A run with a cluster within its process, whose temporary files are beside those of executors.
    fn within(&self, map: &Path, sessions: &[PathBuf]) -> Command {
        let mut within = arguments(PLAN, map, sessions);
        within.extend(["--cluster", "in-process"]);
        let mut within = command(&within);
        within.env("TMPDIR", self.temporary.path());
        within
    }

    /// The folders of its executors, each from when it is held.
    fn folders(&self) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(self.temporary.path()).unwrap();
        let paths = entries.map(|entry| entry.unwrap().path());
        let mut paths: Vec<_> = paths.filter(|path| path.join("lock").exists()).collect();
        paths.sort();
        paths
    }

    fn url(&self) -> String {
        format!("df://{}", self.address())
    }
}

fn sessions(folder: &Path, count: usize, loops: f64) -> Vec<PathBuf> {
    let write = |index: usize| {
        let path = folder.join(format!("drive_{index}.mcap"));
        write_drive(&path, rectangle(30.0 + index as f64, 20.0, loops));
        path
    };
    (0..count).map(write).collect()
}

/// So many of a dozen sessions that take a while, which the tests share.
fn long_sessions(count: usize) -> Vec<PathBuf> {
    static LONG: OnceLock<Vec<PathBuf>> = OnceLock::new();
    let made = || sessions(&made_once(env!("CARGO_TARGET_TMPDIR"), "cluster"), 12, 40.0);
    LONG.get_or_init(made)[..count].to_vec()
}

/// The plan of a run that is of no plan in particular.
const PLAN: &str = "trajectory";

fn arguments<'a>(plan: &'a str, map: &'a Path, sessions: &'a [PathBuf]) -> Vec<&'a str> {
    let mut arguments = vec![
        "run",
        plan,
        "--map",
        text(map),
        "--progress",
        "none",
        "--sessions",
    ];
    arguments.extend(sessions.iter().map(|path| text(path)));
    arguments
}

#[test]
fn a_pool_a_cluster_within_and_a_cluster_of_processes_make_equal_layers() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 3, 2.0);
    let local = folder.path().join("local");
    evermap(&arguments(PLAN, &local, &sessions)).expect(0);

    let cluster = Cluster::new();
    let within = folder.path().join("within");
    let ended = cluster.within(&within, &sessions).output().unwrap();
    evermap_tests::Finished::from(ended).expect(0);
    assert_eq!(layers_of(&within), layers_of(&local));

    let _scheduler = cluster.scheduler();
    let _executors = [cluster.executor(), cluster.executor()];
    let apart = folder.path().join("apart");
    let (url, mut outside) = (cluster.url(), arguments(PLAN, &apart, &sessions));
    outside.extend(["--cluster", &url]);
    evermap(&outside).expect(0);
    assert_eq!(layers_of(&apart), layers_of(&local));
}

#[test]
fn a_cluster_within_a_process_leaves_no_temporary_files_and_takes_those_that_a_killed_one_left() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = long_sessions(4);
    let cluster = Cluster::new();
    let within = |name: &str| cluster.within(&folder.path().join(name), &sessions);
    let killed = begin(&mut within("killed"));
    until("a folder", || cluster.folders().len() == 1);
    let left = cluster.folders();
    drop(killed);
    assert_eq!(cluster.folders(), left);

    let ended = within("next").output().unwrap();
    evermap_tests::Finished::from(ended).expect(0);
    let rest = std::fs::read_dir(cluster.temporary.path()).unwrap();
    let rest: Vec<_> = rest.map(|entry| entry.unwrap().path()).collect();
    assert!(rest.is_empty(), "{rest:?}");
}

#[test]
fn an_executor_whose_scheduler_does_not_answer_says_so_and_ends() {
    let cluster = Cluster::new();
    let nowhere = cluster.address();
    let begun = Instant::now();
    let mut executor = cluster.executor_command();
    let ended = executor.args(["--wait-s", "2"]).output().unwrap();
    let said = evermap_tests::Finished::from(ended).expect(1).stderr;
    assert!(begun.elapsed() >= Duration::from_secs(2));
    let expected = format!("expected a scheduler that answers at {nowhere} within 2 s, found ");
    assert!(said.contains(&expected), "{said}");
    assert!(said.contains("whether --scheduler names it"), "{said}");
}

/// An executor has one port: something else may have the next.
#[test]
fn an_executor_works_where_the_port_after_its_own_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 1, 1.0);
    let cluster = Cluster::new();
    let _scheduler = cluster.scheduler();
    let port = free_port();
    let _next = TcpListener::bind(("127.0.0.1", port + 1)).unwrap();
    let (scheduler, bind) = (cluster.address(), format!("127.0.0.1:{port}"));
    let arguments: [&str; 5] = ["executor", "--scheduler", &scheduler, "--bind", &bind];
    let _executor = begin(command(&arguments).env("TMPDIR", cluster.temporary.path()));
    let run = on_cluster(&folder.path().join("map"), &sessions, &cluster, "120");
    let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
    ended.expect(0);
}

#[test]
fn a_cluster_is_reached_by_the_name_of_its_host() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 1, 1.0);
    let cluster = Cluster::at("localhost");
    let _scheduler = cluster.scheduler();
    let _executor = cluster.executor();
    let map = folder.path().join("map");
    let run = on_cluster(&map, &sessions, &cluster, "120");
    let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
    ended.expect(0);
}

#[test]
fn an_address_that_is_taken_or_of_no_host_is_named() {
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = other.local_addr().unwrap().to_string();
    let temporary = tempfile::tempdir().unwrap();
    for process in ["scheduler", "executor"] {
        let told = |bind: &str| {
            let mut command = command(&[process, "--bind", bind]);
            let ended = command.env("TMPDIR", temporary.path()).output().unwrap();
            evermap_tests::Finished::from(ended).expect(1).stderr
        };
        let expected = format!("expected to listen on {taken}, found ");
        let said = told(&taken);
        assert!(said.contains(&expected), "{process}: {said}");
        let said = told("no such host:50050");
        let expected = "expected --bind with a host of this machine, found no such host: ";
        assert!(said.contains(expected), "{process}: {said}");
    }
}

fn signal(process: &Process, signal: &str) {
    let id = process.0.id().to_string();
    let sent = std::process::Command::new("kill")
        .args([signal, &id])
        .status();
    assert!(sent.unwrap().success());
}

#[test]
fn what_a_killed_executor_leaves_goes_with_the_next_and_a_hangup_leaves_nothing() {
    let cluster = Cluster::new();
    let _scheduler = cluster.scheduler();
    let killed = cluster.executor();
    until("a folder", || cluster.folders().len() == 1);
    let left = cluster.folders();
    drop(killed);
    assert_eq!(cluster.folders(), left);

    let mut next = cluster.executor();
    until("a folder of the next executor alone", || {
        cluster.folders().len() == 1 && cluster.folders() != left
    });
    let mut beside = cluster.executor();
    until("a folder beside", || cluster.folders().len() == 2);
    signal(&next, "-HUP");
    assert_eq!(next.0.wait().unwrap().code(), Some(0));
    until("one folder", || cluster.folders().len() == 1);
    signal(&beside, "-TERM");
    assert_eq!(beside.0.wait().unwrap().code(), Some(0));
    let mut rest = std::fs::read_dir(cluster.temporary.path()).unwrap();
    assert!(rest.next().is_none());
}

/// A run on the cluster, with its outputs.
fn on_cluster(map: &Path, sessions: &[PathBuf], cluster: &Cluster, deadline_s: &str) -> Child {
    let mut run = plan_on_cluster(PLAN, map, sessions, cluster, deadline_s);
    run.spawn().unwrap()
}

/// As [`on_cluster`] of a plan, not yet started.
fn plan_on_cluster(
    plan: &str,
    map: &Path,
    sessions: &[PathBuf],
    cluster: &Cluster,
    deadline_s: &str,
) -> Command {
    let (url, mut run) = (cluster.url(), arguments(plan, map, sessions));
    run.extend(["--cluster", &url, "--deadline-s", deadline_s]);
    let mut run = command(&run);
    run.stdout(Stdio::null()).stderr(Stdio::piped());
    run
}

#[test]
fn a_cluster_that_is_not_there_or_has_nobody_to_work_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 1, 1.0);
    let cluster = Cluster::new();
    let refused = |name: &str| {
        let run = on_cluster(&folder.path().join(name), &sessions, &cluster, "2");
        let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
        let stderr = ended.expect(1).stderr;
        assert!(stderr.contains("no unit has ended for 2 s"), "{stderr}");
        stderr
    };
    let nobody = refused("nowhere");
    assert!(nobody.contains(&cluster.scheduler.to_string()), "{nobody}");
    let _scheduler = cluster.scheduler();
    let idle = refused("idle");
    assert!(idle.contains("no executor is connected"), "{idle}");
}

/// A scheduler that takes connections and says nothing, as one that was suspended does.
#[test]
fn a_scheduler_that_says_nothing_is_given_up_at_the_deadline() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 1, 1.0);
    let cluster = Cluster::new();
    let silent = TcpListener::bind(("127.0.0.1", cluster.scheduler)).unwrap();
    silent.set_nonblocking(true).unwrap();
    let run = on_cluster(&folder.path().join("map"), &sessions, &cluster, "2");
    let mut held = Vec::new();
    until("the run asks", || {
        held.extend(silent.accept());
        !held.is_empty()
    });
    let asked = Instant::now();
    let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
    let waited = asked.elapsed();
    let said = ended.expect(1).stderr;
    for words in ["no unit has ended for 2 s", "does not answer"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    // One call alone may take ten seconds where nobody has a deadline.
    assert!(waited < Duration::from_secs(8), "{waited:?}");
}

/// How long the only executor of a run may hang, in seconds.
const HANGING: &str = "20";

#[test]
fn a_run_whose_only_executor_hangs_ends_at_its_deadline_and_nothing_runs_later() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = long_sessions(12);
    let cluster = Cluster::new();
    let _scheduler = cluster.scheduler();
    let executor = cluster.executor();
    let map = folder.path().join("map");
    let run = on_cluster(&map, &sessions, &cluster, HANGING);
    until_one_is_done(&map);
    signal(&executor, "-STOP");
    let (done, stopped) = (receipts(&map), Instant::now());
    let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
    let waited = stopped.elapsed();
    let said = ended.expect(1).stderr;
    let expected = format!("no unit has ended for {HANGING} s");
    assert!(said.contains(&expected), "{said}");
    assert!(waited < Duration::from_secs(35), "{waited:?}");
    signal(&executor, "-CONT");
    let ended = receipts_in_the_end(&map);
    // The executor has one slot: what it was at may end.
    assert!(
        ended <= done + 1 && ended < sessions.len(),
        "{done} {ended}"
    );
}

/// A function that notes when it is begun and when it ends, which it does once there is a file `go`.
const WAITING: &str = r#"
import pathlib
import time


def waiting(speeds, folder):
    folder = pathlib.Path(folder)

    def note(word):
        with open(folder / "notes", "a") as notes:
            notes.write(word + "\n")

    note("begun")
    while not (folder / "go").exists():
        time.sleep(0.05)
    note("ended")
    return {"seen": [len(speeds)]}
"#;

/// Two plans: of what that function reads, and of what it makes of it. It writes into this folder.
fn plans_that_wait(folder: &Path) -> [PathBuf; 2] {
    std::fs::write(folder.join("waiting.py"), WAITING).unwrap();
    let lines = [
        "  waiting:",
        "    python: waiting.py:waiting",
        "    in: { speeds: speeds }",
        "    grain: session",
        "    output: { seen: i64 }",
    ];
    let with = format!("    with: {{ folder: '{}' }}", folder.display());
    let waiting = format!("{}\n{with}\n", lines.join("\n"));
    [("speeds", ""), ("waiting", waiting.as_str())].map(|(name, more)| {
        let steps = "steps:\n  speeds: { op: speeds }";
        let text = format!("plan: {name}\n{steps}\n{more}write: [{name}]\n");
        let path = folder.join(format!("{name}.yaml"));
        std::fs::write(&path, text).unwrap();
        path
    })
}

#[test]
fn a_unit_that_takes_longer_than_the_deadline_is_begun_once_and_found_by_the_next_run() {
    let Some(python) = evermap_tests::python() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 1, 1.0);
    let cluster = Cluster::new();
    let _scheduler = cluster.scheduler();
    let executor = || begin(cluster.executor_command().env("EVERMAP_PYTHON", &python));
    // While one is at work, the other one would take what is sent again.
    let _executors = [executor(), executor()];
    let ([before, plan], map) = (plans_that_wait(folder.path()), folder.path().join("map"));
    let begin_run = |plan: &Path, deadline_s: &str| {
        let mut run = plan_on_cluster(text(plan), &map, &sessions, &cluster, deadline_s);
        run.env("EVERMAP_PYTHON", &python).spawn().unwrap()
    };
    let done = |run: Child| {
        let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
        ended.expect(0);
    };
    done(begin_run(&before, "120"));

    let notes = || {
        let notes = std::fs::read_to_string(folder.path().join("notes"));
        let notes = notes.unwrap_or_default();
        notes.lines().map(str::to_owned).collect::<Vec<_>>()
    };
    let mut run = begin_run(&plan, "5");
    until("the unit is begun", || !notes().is_empty());
    until("the run gives up", || {
        assert_eq!(notes(), ["begun"]);
        run.try_wait().unwrap().is_some()
    });
    let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
    let said = ended.expect(1).stderr;
    assert!(said.contains("no unit has ended for 5 s"), "{said}");

    // A run that comes meanwhile waits for it: were it sent again, it would be begun at once.
    let mut waits = begin_run(&plan, "120");
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(12) {
        assert_eq!(notes(), ["begun"]);
        assert!(waits.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(100));
    }
    std::fs::write(folder.path().join("go"), "").unwrap();
    until("the executor has done it", || receipts(&map) == 2);
    done(waits);
    done(begin_run(&plan, "120"));
    assert_eq!(notes(), ["begun", "ended"]);
}

#[test]
fn an_executor_that_stops_answering_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = long_sessions(8);
    let local = folder.path().join("local");
    evermap(&arguments(PLAN, &local, &sessions)).expect(0);
    let cluster = Cluster::new();
    let _scheduler = cluster.scheduler();
    let executors = [cluster.executor(), cluster.executor()];
    let map = folder.path().join("map");
    let mut run = on_cluster(&map, &sessions, &cluster, "120");
    // When units are there, both executors have joined: the first answer may be of either.
    while !map.join("receipts").is_dir() {
        std::thread::sleep(Duration::from_millis(50));
    }
    signal(&executors[0], "-STOP");
    assert!(run.try_wait().unwrap().is_none(), "the run was over before");
    let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
    ended.expect(0);
    assert_eq!(layers_of(&map), layers_of(&local));
}

/// Units of a map that are done.
fn receipts(map: &Path) -> usize {
    std::fs::read_dir(map.join("receipts")).map_or(0, Iterator::count)
}

fn until_one_is_done(map: &Path) {
    while receipts(map) == 0 {
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// How many units have ended by the time that none does any more: long after one would have, were others begun.
fn receipts_in_the_end(map: &Path) -> usize {
    let mut found = receipts(map);
    loop {
        std::thread::sleep(Duration::from_secs(4));
        match receipts(map) {
            now if now == found => return now,
            now => found = now,
        }
    }
}

#[test]
fn what_a_stopped_or_killed_run_has_not_begun_is_not_begun_any_more() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = long_sessions(12);
    let cluster = Cluster::new();
    let _scheduler = cluster.scheduler();
    let _executor = cluster.executor();

    let stopped = folder.path().join("stopped");
    let run = Process(on_cluster(&stopped, &sessions, &cluster, "120"));
    until_one_is_done(&stopped);
    signal(&run, "-TERM");
    let mut run = run;
    assert_eq!(run.0.wait().unwrap().code(), Some(1));
    let done = receipts(&stopped);
    let ended = receipts_in_the_end(&stopped);
    // The executor has one slot: what it was at may end.
    assert!(
        ended <= done + 1 && ended < sessions.len(),
        "{done} {ended}"
    );

    let killed = folder.path().join("killed");
    let run = Process(on_cluster(&killed, &sessions, &cluster, "120"));
    until_one_is_done(&killed);
    drop(run);
    // A minute passes.
    std::fs::remove_dir_all(killed.join("leases")).unwrap();
    let done = receipts(&killed);
    let ended = receipts_in_the_end(&killed);
    assert!(
        ended <= done + 1 && ended < sessions.len(),
        "{done} {ended}"
    );
}

#[test]
fn a_run_whose_executors_have_all_died_says_so_and_goes_on_with_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = long_sessions(6);
    let cluster = Cluster::new();
    let _scheduler = cluster.scheduler();
    let executor = cluster.executor();
    let map = folder.path().join("map");
    let mut run = on_cluster(&map, &sessions, &cluster, "120");
    until_one_is_done(&map);
    drop(executor);
    let begun = Instant::now();
    let mut said = BufReader::new(run.stderr.take().unwrap()).lines();
    let found = said.find(|line| line.as_ref().unwrap().contains("no executor is connected"));
    assert!(found.is_some(), "the run ended without an executor");
    assert!(
        begun.elapsed() < Duration::from_secs(40),
        "{:?}",
        begun.elapsed()
    );
    let _executor = cluster.executor();
    let rest: Vec<String> = said.map(Result::unwrap).collect();
    assert!(run.wait().unwrap().success(), "{rest:?}");
}

/// A cluster that is disturbed again and again.
struct Chaos<'a> {
    cluster: &'a Cluster,
    scheduler: Option<Process>,
    executors: Vec<Process>,
    paused: Vec<Process>,
}

/// What may happen to a cluster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Disturbance {
    /// The scheduler is killed, and another one starts in its place.
    Restart,
    /// An executor is killed.
    Kill,
    /// An executor stops answering.
    Suspend,
    /// One that had stopped goes on; where none had, an executor comes.
    Resume,
    /// An executor comes.
    Join,
}

impl Disturbance {
    /// So many of each kind, in an order by chance.
    fn dealt(random: &mut ChaCha8Rng) -> Vec<Self> {
        let each = [
            (Self::Restart, 5),
            (Self::Kill, 15),
            (Self::Suspend, 10),
            (Self::Resume, 10),
            (Self::Join, 10),
        ];
        let mut dealt: Vec<_> = each
            .into_iter()
            .flat_map(|(kind, times)| std::iter::repeat_n(kind, times))
            .collect();
        dealt.shuffle(random);
        dealt
    }
}

impl Chaos<'_> {
    fn disturb(&mut self, by: Disturbance) {
        match by {
            Disturbance::Restart => {
                drop(self.scheduler.take());
                self.scheduler = Some(self.cluster.scheduler());
            }
            Disturbance::Kill => drop(self.executors.remove(0)),
            Disturbance::Suspend => {
                let executor = self.executors.remove(0);
                signal(&executor, "-STOP");
                self.paused.push(executor);
            }
            Disturbance::Resume if !self.paused.is_empty() => {
                let executor = self.paused.remove(0);
                signal(&executor, "-CONT");
                self.executors.push(executor);
            }
            Disturbance::Resume | Disturbance::Join => self.executors.push(self.cluster.executor()),
        }
        while self.executors.len() < 2 {
            self.executors.push(self.cluster.executor());
        }
        self.executors.truncate(4);
    }
}

#[test]
fn fifty_random_disturbances_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 40, 20.0);
    let local = folder.path().join("local");
    evermap(&arguments(PLAN, &local, &sessions)).expect(0);

    let cluster = Cluster::new();
    let mut chaos = Chaos {
        cluster: &cluster,
        scheduler: Some(cluster.scheduler()),
        executors: vec![cluster.executor(), cluster.executor()],
        paused: Vec::new(),
    };
    let mut random = ChaCha8Rng::seed_from_u64(evermap_test_data::seed());
    let mut disturbances = Disturbance::dealt(&mut random);
    assert_eq!(disturbances.len(), 50);
    // Where one run is over too soon, another one begins.
    while !disturbances.is_empty() {
        let map = folder.path().join(format!("before_{}", disturbances.len()));
        let mut run = on_cluster(&map, &sessions, &cluster, "120");
        while run.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(300));
            if let Some(next) = disturbances.pop() {
                chaos.disturb(next);
            }
        }
        let ended: evermap_tests::Finished = run.wait_with_output().unwrap().into();
        ended.expect(0);
        assert_eq!(layers_of(&map), layers_of(&local));
    }
}
