//! What the end-to-end tests share: where the data is, how the program is called.
//!
//! Data that others made (`../shared` beside the repository, or `EVERMAP_SHARED`) is never part of the project. A test
//! that needs it asks [`shared`] and, where it is absent, says so on standard error and passes.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod asked;
pub mod json_log;
pub mod kitti;
pub mod odometry;
pub mod park;
pub mod recording;
pub mod server;
pub mod trajectories;
pub mod turned;

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant, SystemTime};

pub use evermap_test_data::shared;
use serde_json::{Value, json};

use crate::json_log::JsonLog;

/// The repository.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("tests/ lies in the repository")
}

/// A page of the documentation, by its path in the repository.
pub fn page(name: &str) -> String {
    std::fs::read_to_string(repository().join(name)).expect("there is such a page")
}

/// The interpreter that `make test` sets up, with the packages that tests need; `None` where it is not there, and the test
/// is to be skipped.
pub fn python() -> Option<PathBuf> {
    let python = repository().join(".venv/bin/python");
    evermap_test_data::there(python, "`make test` sets it up")
}

/// A finished program.
pub struct Finished {
    /// Exit code; -1 where a signal ended it.
    pub code: i32,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl From<Output> for Finished {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

impl Finished {
    /// This, if it exited with `code`.
    ///
    /// # Panics
    /// With everything it said, if not.
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(
            self.code, code,
            "stdout: {}\nstderr: {}",
            self.stdout, self.stderr
        );
        self
    }

    /// Standard output as JSON.
    ///
    /// # Panics
    /// Where it is none.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("{error}: {}", self.stdout))
    }
}

/// The program under test, built beside the tests.
///
/// # Panics
/// Where it was not built.
pub fn program() -> PathBuf {
    let test = std::env::current_exe().expect("a test has a path");
    let folder = test
        .parent()
        .and_then(Path::parent)
        .expect("tests lie in target/PROFILE/deps");
    let program = folder.join("evermap");
    assert!(
        program.exists(),
        "{} is not built: run `cargo test --workspace`",
        program.display()
    );
    program
}

/// `evermap` with these arguments, not yet started.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(program());
    command.args(arguments).current_dir(repository());
    command
}

/// [`command`] of a program that a hangup ends: under `nohup` tests ignore it, and so does what they start.
pub fn command_that_hangs_up(arguments: &[&str]) -> Command {
    let mut command = Command::new("env");
    command.arg("--default-signal=HUP").arg(program());
    command.args(arguments).current_dir(repository());
    command
}

/// Runs `evermap` to its end.
///
/// # Panics
/// When it does not start.
pub fn evermap(arguments: &[&str]) -> Finished {
    command(arguments).output().expect("evermap starts").into()
}

/// `evermap run` of a plan, not yet started.
fn run_command(plan: &str, map: &Path) -> Command {
    command(&["run", plan, "--map", text(map), "--progress", "none"])
}

/// `evermap run` of a plan on sessions of one site, not yet started.
pub fn plan_command(plan: &str, map: &Path, site: &str, more: &[&str]) -> Command {
    let mut run = run_command(plan, map);
    run.args(["--site", site]).args(more);
    run
}

/// Runs a plan on sessions of one site to its end.
///
/// # Panics
/// When the program does not start.
pub fn run_of_site(plan: &str, map: &Path, site: &str, more: &[&str]) -> Finished {
    let run = plan_command(plan, map, site, more).output();
    run.expect("evermap starts").into()
}

/// Runs a plan on sessions, each a site of its own, to its end.
///
/// # Panics
/// When the program does not start.
pub fn run(plan: &str, map: &Path, sessions: &[&Path], more: &[&str]) -> Finished {
    let mut run = run_command(plan, map);
    run.arg("--sessions").args(sessions).args(more);
    run.output().expect("evermap starts").into()
}

/// The rows that a query of a map has, as JSON.
///
/// # Panics
/// Where the query fails.
pub fn rows_of(map: &Path, query: &str) -> Value {
    answered(&["--map", text(map)], query)
}

/// The rows that a query of a log has, as JSON.
///
/// # Panics
/// Where the query fails.
pub fn rows_of_log(log: &Path, query: &str) -> Value {
    answered(&["--sessions", text(log)], query)
}

/// The rows that a query has of what these options name, as JSON.
fn answered(of: &[&str], query: &str) -> Value {
    let asked = [&["sql"], of, &["--format", "json", query]].concat();
    evermap(&asked).expect(0).json()
}

/// The layers of a map, as `evermap layers` lists them.
///
/// # Panics
/// Where they cannot be listed.
pub fn layers_of(map: &Path) -> Value {
    let listed = evermap(&["layers", "--map", text(map), "--format", "json"]);
    listed.expect(0).json()
}

/// Simulates a world, with these settings.
///
/// # Panics
/// Where it cannot be simulated.
pub fn simulate(world: &str, out: &Path, settings: &[&str]) {
    let mut simulate = command(&["simulate", world, "--progress", "none", "--out", text(out)]);
    for setting in settings {
        simulate.args(["--set", setting]);
    }
    let ended: Finished = simulate.output().expect("evermap starts").into();
    ended.expect(0);
}

/// Bytes of memory of a process, by a line of what the system says of it: `VmRSS:` are those that it holds, `VmHWM:` the
/// most that it held. `None` once it has ended.
pub fn memory(process: u32, line: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let found = status.lines().find_map(|found| found.strip_prefix(line))?;
    let kilobytes: u64 = found.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes << 10)
}

/// MiB that the program may hold beside `--memory`. A development build has 60 more before it does anything.
pub const BESIDE_MIB: u64 = if cfg!(debug_assertions) { 384 } else { 256 };

/// Runs a command to its end, and finds the most MiB that it held.
///
/// # Panics
/// When it does not start.
pub fn watched(command: Command) -> (Finished, u64) {
    watched_for(Duration::MAX, command)
}

/// As [`watched`]; ends a command that takes longer than so long.
///
/// # Panics
/// When it does not start.
pub fn watched_for(longest: Duration, mut command: Command) -> (Finished, u64) {
    let command = command.stdout(Stdio::null()).stderr(Stdio::piped());
    let (begun, mut program) = (Instant::now(), command.spawn().expect("evermap starts"));
    let mut most = 0;
    while let Some(held) = memory(program.id(), "VmHWM:") {
        most = most.max(held);
        if begun.elapsed() > longest {
            program.kill().expect("evermap can be ended");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let ended = program.wait_with_output().expect("evermap is waited for");
    (ended.into(), most >> 20)
}

/// Waits until a file has been as it is for so long that runs believe what they remember of it: two seconds.
///
/// # Panics
/// Where there is no such file.
pub fn until_rested(file: &Path) {
    let found = file.metadata().expect("there is such a file");
    let second = u64::try_from(found.ctime()).expect("it changed after 1970");
    let changed = Duration::from_secs(second) + Duration::from_nanos(found.ctime_nsec() as u64);
    let modified = found.modified().expect("files have times");
    let changed = modified.max(SystemTime::UNIX_EPOCH + changed);
    let rested = changed + Duration::from_secs(2);
    while SystemTime::now() <= rested {
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// The text of a path.
///
/// # Panics
/// For a path that is no UTF-8.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

/// One pose of a made-up drive: seconds from the start, x and y in metres, yaw in radians.
pub type DrivePose = (f64, f64, f64, f64);

/// Writes a log of one message, `{}`, on a topic whose JSON schema has this name and text.
///
/// # Panics
/// When the file cannot be written.
pub fn write_nothing(path: &Path, topic: &str, (schema, text): (&str, &[u8])) {
    let mut log = JsonLog::new(path);
    let topic = log.topic(topic, schema, text);
    log.send(topic, 0, 1, &json!({}));
    log.finish();
}

/// Writes a session with nothing but odometry (`/odom`, foxglove.PoseInFrame as JSON).
///
/// # Panics
/// When the file cannot be written.
pub fn write_drive(path: &Path, poses: impl IntoIterator<Item = DrivePose>) {
    write_drive_with(path, poses, &[]);
}

/// As [`write_drive`], with an attachment of these bytes, where there are any.
///
/// # Panics
/// When the file cannot be written.
pub fn write_drive_with(path: &Path, poses: impl IntoIterator<Item = DrivePose>, attached: &[u8]) {
    let mut log = JsonLog::new(path);
    let odometry = log.topic("/odom", "foxglove.PoseInFrame", POSE_SCHEMA.as_bytes());
    for (sequence, (seconds, x, y, yaw)) in poses.into_iter().enumerate() {
        let nanoseconds = 1_700_000_000_000_000_000 + (seconds * 1e9) as u64;
        let message = json!({
            "timestamp": { "sec": nanoseconds / 1_000_000_000, "nsec": nanoseconds % 1_000_000_000 },
            "frame_id": "odom",
            "pose": {
                "position": { "x": x, "y": y, "z": 0.0 },
                "orientation": { "x": 0.0, "y": 0.0, "z": (yaw / 2.0).sin(), "w": (yaw / 2.0).cos() },
            },
        });
        log.send(odometry, sequence as u32, nanoseconds, &message);
    }
    if !attached.is_empty() {
        let attachment = mcap::Attachment {
            log_time: 0,
            create_time: 0,
            name: "attached".to_owned(),
            media_type: "application/octet-stream".to_owned(),
            data: attached.into(),
        };
        log.0.attach(&attachment).expect("an attachment fits");
    }
    log.finish();
}

pub(crate) const POSE_SCHEMA: &str = r#"{
  "type": "object",
  "properties": {
    "timestamp": { "type": "object", "properties": { "sec": { "type": "integer" }, "nsec": { "type": "integer" } } },
    "frame_id": { "type": "string" },
    "pose": {
      "type": "object",
      "properties": {
        "position": {
          "type": "object",
          "properties": { "x": { "type": "number" }, "y": { "type": "number" }, "z": { "type": "number" } }
        },
        "orientation": {
          "type": "object",
          "properties": {
            "x": { "type": "number" }, "y": { "type": "number" }, "z": { "type": "number" }, "w": { "type": "number" }
          }
        }
      }
    }
  }
}"#;

/// Seconds that a corner of [`rectangle`] takes: a quarter turn, at less than what a vehicle can do.
const CORNER_S: f64 = 0.5;

/// A drive around a rectangle, `loops` times, at 2 m/s and 10 Hz; at corners the vehicle turns on the spot.
pub fn rectangle(width_m: f64, height_m: f64, loops: f64) -> Vec<DrivePose> {
    let around = 2.0 * (width_m + height_m);
    let steps = (around * loops / 0.2) as usize;
    let (mut seconds, mut before) = (0.0, 0.0);
    (0..=steps)
        .map(|step| {
            let along = (step as f64 * 0.2) % around;
            let (x, y, yaw) = if along < width_m {
                (along, 0.0, 0.0)
            } else if along < width_m + height_m {
                (width_m, along - width_m, std::f64::consts::FRAC_PI_2)
            } else if along < 2.0 * width_m + height_m {
                (
                    2.0 * width_m + height_m - along,
                    height_m,
                    std::f64::consts::PI,
                )
            } else {
                (0.0, around - along, -std::f64::consts::FRAC_PI_2)
            };
            if step > 0 {
                seconds += if yaw == before { 0.1 } else { CORNER_S };
            }
            before = yaw;
            (seconds, x, y, yaw)
        })
        .collect()
}
