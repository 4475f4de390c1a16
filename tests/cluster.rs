//! One machine or many: the same layers, digest for digest, even when executors die.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use evermap_tests::{command, evermap, rectangle, text, write_drive};

/// Stops with the test, however the test ends.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(arguments: &[&str]) -> Process {
    Process(
        command(arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("evermap starts"),
    )
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port()
}

fn listening(port: u16) {
    let begun = Instant::now();
    while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
        assert!(
            begun.elapsed() < Duration::from_secs(60),
            "nothing listens on {port}"
        );
        std::thread::sleep(Duration::from_millis(100));
    }
}

struct Cluster {
    scheduler: u16,
}

impl Cluster {
    fn scheduler(&self) -> Process {
        let process = start(&[
            "scheduler",
            "--bind",
            &format!("127.0.0.1:{}", self.scheduler),
        ]);
        listening(self.scheduler);
        process
    }

    fn executor(&self) -> Process {
        let scheduler = format!("127.0.0.1:{}", self.scheduler);
        let bind = format!("127.0.0.1:{}", free_port());
        start(&[
            "executor",
            "--scheduler",
            &scheduler,
            "--bind",
            &bind,
            "--jobs",
            "1",
        ])
    }

    fn url(&self) -> String {
        format!("df://127.0.0.1:{}", self.scheduler)
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

fn arguments<'a>(map: &'a Path, sessions: &'a [PathBuf]) -> Vec<&'a str> {
    let mut arguments = vec![
        "run",
        "trajectory",
        "--map",
        text(map),
        "--progress",
        "none",
        "--sessions",
    ];
    arguments.extend(sessions.iter().map(|path| text(path)));
    arguments
}

fn layers(map: &Path) -> serde_json::Value {
    evermap(&["layers", "--map", text(map), "--format", "json"])
        .expect(0)
        .json()
}

#[test]
fn a_pool_a_cluster_within_and_a_cluster_of_processes_make_equal_layers() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 3, 2.0);
    let local = folder.path().join("local");
    evermap(&arguments(&local, &sessions)).expect(0);

    let within = folder.path().join("within");
    let mut inside = arguments(&within, &sessions);
    inside.extend(["--cluster", "in-process"]);
    evermap(&inside).expect(0);
    assert_eq!(layers(&within), layers(&local));

    let cluster = Cluster {
        scheduler: free_port(),
    };
    let _scheduler = cluster.scheduler();
    let _executors = [cluster.executor(), cluster.executor()];
    let apart = folder.path().join("apart");
    let (url, mut outside) = (cluster.url(), arguments(&apart, &sessions));
    outside.extend(["--cluster", &url]);
    evermap(&outside).expect(0);
    assert_eq!(layers(&apart), layers(&local));
}

#[test]
fn executors_that_die_and_a_scheduler_that_restarts_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = sessions(folder.path(), 16, 40.0);
    let local = folder.path().join("local");
    evermap(&arguments(&local, &sessions)).expect(0);

    let cluster = Cluster {
        scheduler: free_port(),
    };
    let mut scheduler = Some(cluster.scheduler());
    let mut executors = vec![cluster.executor(), cluster.executor()];
    let map = folder.path().join("map");
    let (url, mut disturbed) = (cluster.url(), arguments(&map, &sessions));
    disturbed.extend(["--cluster", &url, "--deadline-s", "10"]);
    let mut run = command(&disturbed)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    let mut disturbance = 0;
    while run.try_wait().unwrap().is_none() {
        assert!(begun.elapsed() < Duration::from_secs(240), "the run hangs");
        std::thread::sleep(Duration::from_millis(400));
        disturbance += 1;
        match disturbance {
            1 | 3 => {
                drop(executors.remove(0));
                executors.push(cluster.executor());
            }
            2 => {
                drop(scheduler.take());
                scheduler = Some(cluster.scheduler());
            }
            _ => {}
        }
    }
    assert!(
        disturbance >= 3,
        "the run was over before anything could be disturbed"
    );
    let output = run.wait_with_output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert_eq!(layers(&map), layers(&local));
}
