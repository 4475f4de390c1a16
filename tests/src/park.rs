//! Drives through a simulated car park, and maps of them.

#![allow(clippy::print_stderr)]

use std::path::{Path, PathBuf};

use evermap_bench::trajectory::{AbsoluteError, Statistics};

use crate::trajectories::{Trajectories, error_by_session, map_error, poses, truth};
use crate::{Finished, plan_command, simulate, text};

/// Runs a plan on sessions of one site, without loss.
///
/// # Panics
/// Where it fails.
pub fn run(plan: &str, map: &Path, sessions: &[&Path]) {
    finished(plan, map, sessions).expect(0);
}

/// Runs a plan on sessions of one site, however that ends.
///
/// # Panics
/// Where it does not start.
pub fn finished(plan: &str, map: &Path, sessions: &[&Path]) -> Finished {
    let mut more = vec!["--sessions"];
    more.extend(sessions.iter().map(|path| text(path)));
    let run = plan_command(plan, map, "park", &more).output();
    run.expect("evermap starts").into()
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
