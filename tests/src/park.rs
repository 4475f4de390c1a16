//! Drives through a car park, and maps of them.

#![allow(clippy::print_stderr, clippy::expect_used)]

use std::path::{Path, PathBuf};
use std::process::Command;

use evermap_bench::trajectory::{AbsoluteError, Statistics};

use crate::trajectories::{
    Trajectories, error_by_session, error_in, map_error, poses, rows, truth, truth_from_map,
};
use crate::{BESIDE_MIB, Finished, plan_command, simulate, text, watched};

/// Runs a plan on sessions of one site, without loss.
///
/// # Panics
/// Where it fails.
pub fn run(plan: &str, map: &Path, sessions: &[&Path]) {
    finished(plan, map, sessions, &[]).expect(0);
}

/// Runs a plan on small images of a simulated car park, without loss: they need fewer features.
///
/// # Panics
/// Where it fails.
pub fn run_small(plan: &str, map: &Path, sessions: &[&Path]) {
    finished(plan, map, sessions, &FEWER).expect(0);
}

/// Options of a run on small images.
pub const FEWER: [&str; 2] = ["--set", "features.count=300"];

/// Runs a plan with options on sessions of one site, however that ends.
///
/// # Panics
/// Where it does not start.
pub fn finished(plan: &str, map: &Path, sessions: &[&Path], options: &[&str]) -> Finished {
    let run = on_park(plan, map, sessions, options).output();
    run.expect("evermap starts").into()
}

/// Runs a plan on sessions of one site, without loss and within `--memory`.
///
/// # Panics
/// Where it fails, or holds more than is promised beside that.
pub fn run_within(memory_mib: u64, plan: &str, map: &Path, sessions: &[&Path]) {
    let limit = format!("{memory_mib}MiB");
    let (ended, most) = watched(on_park(plan, map, sessions, &["--memory", &limit]));
    ended.expect(0);
    eprintln!("{plan} within {limit}: {most} MiB resident");
    assert!(most > 0, "nobody looked while it ran");
    assert!(most <= memory_mib + BESIDE_MIB, "{most} MiB resident");
}

fn on_park(plan: &str, map: &Path, sessions: &[&Path], options: &[&str]) -> Command {
    let mut more = options.to_vec();
    more.push("--sessions");
    more.extend(sessions.iter().map(|path| text(path)));
    plan_command(plan, map, "park", &more)
}

/// Small images at a small rate: a drive is mapped within a minute.
pub const SMALL: [&str; 5] = [
    "width_px=400",
    "height_px=300",
    "rate_hz=6.25",
    "speed_mps=3",
    "floor_texels_per_m=100",
];

/// A simulated car park: a drive around the western island, small images.
pub struct Park {
    folder: PathBuf,
    seed: u64,
}

impl Park {
    /// Simulated into this folder.
    pub fn new(folder: &Path, seed: u64) -> Self {
        Self {
            folder: folder.to_owned(),
            seed,
        }
    }

    /// Simulates session number `index` with parameters beside the usual ones; gives its file, named `name`, and its
    /// truth.
    ///
    /// # Panics
    /// Where it cannot be simulated.
    pub fn drive(&self, index: usize, name: &str, more: &[&str]) -> (PathBuf, Trajectories) {
        let out = self.folder.join(format!("world_{name}"));
        let own = [
            format!("seed={}", self.seed),
            format!("skip={index}"),
            format!("revisits={index}"),
        ];
        let own = own.iter().map(String::as_str);
        let settings: Vec<&str> = own
            .chain(SMALL)
            .chain(["loops=0.8"])
            .chain(more.iter().copied())
            .collect();
        simulate("car_park", &out, &settings);
        let usual = if index == 0 {
            "initial".to_owned()
        } else {
            format!("revisit_{index}")
        };
        let session = out.join(format!("{name}.mcap"));
        std::fs::rename(out.join(format!("{usual}.mcap")), &session)
            .expect("a file can be renamed");
        let truth = truth(&out.join("truth").join(format!("{usual}.tum")));
        (session, [(name.to_owned(), truth)].into())
    }
}

/// The error of a version's adjusted poses, with the odometry's beside it on standard error.
///
/// # Panics
/// Where the map and the truth share no pose.
pub fn adjusted_error(
    what: &str,
    map: &Path,
    version: Option<u32>,
    truths: &Trajectories,
) -> AbsoluteError {
    let error = map_error(&poses(map, version, "poses", "map_from_vehicle"), truths);
    let odometry = error_by_session(
        &poses(map, version, "keyframes", "odom_from_vehicle"),
        truths,
    );
    let Statistics {
        rmse,
        median,
        p99,
        max,
        ..
    } = error.position_m;
    eprintln!(
        "{what}: rmse {:.1} cm, median {:.1}, p99 {:.1}, max {:.1}; {:.3} deg; odometry {:.1} cm",
        100.0 * rmse,
        100.0 * median,
        100.0 * p99,
        100.0 * max,
        error.rotation_rad.median.to_degrees(),
        100.0 * odometry.rmse
    );
    error
}

/// A copy of a map, to try something on.
///
/// # Panics
/// Where it cannot be copied.
pub fn copy(map: &Path, folder: &Path, name: &str) -> PathBuf {
    let target = folder.join(name);
    copy_folder(map, &target);
    target
}

/// An empty folder below the one that Cargo gives to integration tests, for what several tests of a program share.
///
/// # Panics
/// Where it cannot be made.
pub fn made_once(below: &str, name: &str) -> PathBuf {
    let folder = Path::new(below).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("the target folder can be written");
    folder
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder can be made");
    for entry in std::fs::read_dir(from).expect("a map can be read") {
        let entry = entry.expect("a map can be read");
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        if let Ok(of_map) = std::fs::read_link(&path) {
            std::os::unix::fs::symlink(of_map, &target).expect("a map can be copied");
        } else if path.is_dir() {
            copy_folder(&path, &target);
        } else {
            std::fs::copy(&path, &target).expect("a map can be copied");
        }
    }
}

/// How a session was localised in the version before.
pub struct Localised {
    /// Of what was not lost; `None` where all was.
    pub error: Option<AbsoluteError>,
    keyframes: u64,
    /// Keyframes that were lost.
    pub lost: u64,
}

impl Localised {
    /// Of this version of a map, against the version before.
    ///
    /// # Panics
    /// Where there are no such versions.
    pub fn of(map: &Path, version: u32, session: &str, truths: &Trajectories) -> Self {
        let before = poses(map, Some(version - 1), "poses", "map_from_vehicle");
        let mut found = poses(map, Some(version), "localisations", "map_from_vehicle");
        found.retain(|name, _| name == session);
        let error = error_in(&found, truths, &truth_from_map(&before, truths));
        let count = format!(
            "SELECT count(*) AS n, count(*) FILTER (WHERE state = 'lost') AS lost FROM localisations \
             WHERE session = '{session}'"
        );
        let counted = rows(map, Some(version), &count);
        let number = |name: &str| counted[0][name].as_u64().expect("a count is a number");
        let localised = Self {
            error,
            keyframes: number("n"),
            lost: number("lost"),
        };
        eprintln!("{session}: {localised}");
        localised
    }

    /// Nothing is off by more than half a metre without being called lost.
    pub fn is_never_silently_wrong(&self) -> bool {
        self.error.is_none_or(|error| error.position_m.max <= 0.5)
    }

    /// Share of the keyframes that were lost.
    pub fn lost_share(&self) -> f64 {
        self.lost as f64 / self.keyframes as f64
    }
}

impl std::fmt::Display for Localised {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} of {} keyframes lost", self.lost, self.keyframes)?;
        let Some(error) = self.error else {
            return Ok(());
        };
        let (position, rotation) = (error.position_m, error.rotation_rad);
        write!(
            f,
            "; median {:.1} cm, p99 {:.1}, max {:.1}; median {:.3} deg",
            100.0 * position.median,
            100.0 * position.p99,
            100.0 * position.max,
            rotation.median.to_degrees()
        )
    }
}
