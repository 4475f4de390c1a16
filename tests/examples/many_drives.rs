//! What a map costs as drives are added to it: many drives through one simulated car park, one run each, and for each
//! version its seconds, memory, bytes read, size and accuracy.
//!
//! ```sh
//! cargo build --release --package evermap
//! cargo run --release --package evermap-tests --example many_drives -- FOLDER 30 [PLAN]
//! ```
//!
//! A folder that has a world and a map goes on with them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use evermap_tests::park::SMALL;
use evermap_tests::trajectories::truth_from_map;
use evermap_tests::trajectories::{Trajectories, error_in, map_error, poses, rows, truth};
use evermap_tests::{plan_command, simulate, text};

/// Of Linux on all machines that evermap is built for.
const TICKS_PER_S: f64 = 100.0;
/// How often a run is looked at.
const LOOK: Duration = Duration::from_millis(50);

fn main() {
    let mut arguments = std::env::args().skip(1);
    let usage = "expected FOLDER and a number of drives";
    let folder = PathBuf::from(arguments.next().expect(usage));
    let drives: usize = arguments.next().expect(usage).parse().expect(usage);
    let plan = arguments.next().unwrap_or_else(|| "lifelong".to_owned());
    let world = folder.join("world");
    if !world.exists() {
        simulate_drives(&world, drives);
    }
    let map = folder.join("map");
    println!(
        "| drive | s | CPU s | peak MiB | read MiB | map MiB | keyframes kept | landmarks | ATE cm | lost % | median cm | frame moved mm |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut truths = Trajectories::new();
    let done = versions(&map);
    for drive in 0..drives {
        let name = match drive {
            0 => "initial".to_owned(),
            _ => format!("revisit_{drive}"),
        };
        let file = world.join("truth").join(format!("{name}.tum"));
        truths.insert(name.clone(), truth(&file));
        if drive < done {
            continue;
        }
        let cost = add(&plan, &map, &world.join(format!("{name}.mcap")));
        println!(
            "| {} | {cost} | {} |",
            drive + 1,
            found(&map, drive, &name, &truths)
        );
    }
}

/// Thirty drives of it fit into two hours.
fn simulate_drives(world: &Path, drives: usize) {
    let revisits = format!("revisits={}", drives - 1);
    let settings: Vec<&str> = SMALL.into_iter().chain(["loops=0.5", &revisits]).collect();
    simulate("car_park", world, &settings);
}

/// How many versions the map has.
fn versions(map: &Path) -> usize {
    let there = map
        .exists()
        .then(|| rows(map, None, "SELECT version FROM versions"));
    there.map_or(0, |versions| versions.len())
}

/// Adds a session to the map: seconds, those of the CPU, peak memory, bytes read, size of the map.
fn add(plan: &str, map: &Path, session: &Path) -> String {
    let begun = Instant::now();
    let mut run = plan_command(plan, map, "park", &["--sessions", text(session)]);
    let run = run.stdout(Stdio::null()).spawn();
    let Watched {
        cpu_ticks,
        peak_kib,
        read_bytes,
    } = watched(run.unwrap());
    let seconds = begun.elapsed().as_secs_f64();
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    format!(
        "{seconds:.1} | {:.1} | {:.0} | {:.0} | {:.0}",
        cpu_ticks as f64 / TICKS_PER_S,
        mib(peak_kib << 10),
        mib(read_bytes),
        mib(size(map))
    )
}

/// What a program took.
#[derive(Default)]
struct Watched {
    cpu_ticks: u64,
    peak_kib: u64,
    read_bytes: u64,
}

/// Waits for a program's end, and notes what it takes until then.
fn watched(mut run: Child) -> Watched {
    let process = PathBuf::from(format!("/proc/{}", run.id()));
    let told = |file: &str| std::fs::read_to_string(process.join(file)).ok();
    let number = |file: &str, key: &str| -> Option<u64> {
        let told = told(file)?;
        let line = told.lines().find(|line| line.starts_with(key))?;
        line.split_whitespace().nth(1)?.parse().ok()
    };
    // Behind the name, which may hold anything, in parentheses: proc_pid_stat(5), fields 14 and 15.
    let ticks = || -> Option<u64> {
        let told = told("stat")?;
        let (_, fields) = told.rsplit_once(')')?;
        let fields = fields.split_whitespace().skip(11).take(2);
        fields.map(|field| field.parse::<u64>().ok()).sum()
    };
    let mut watched = Watched::default();
    loop {
        let Watched {
            cpu_ticks,
            peak_kib,
            read_bytes,
        } = &mut watched;
        *cpu_ticks = ticks().unwrap_or_default().max(*cpu_ticks);
        *peak_kib = number("status", "VmHWM:")
            .unwrap_or_default()
            .max(*peak_kib);
        *read_bytes = number("io", "rchar:").unwrap_or_default().max(*read_bytes);
        if let Some(status) = run.try_wait().unwrap() {
            assert!(matches!(status.code(), Some(0 | 3)), "{status}");
            return watched;
        }
        std::thread::sleep(LOOK);
    }
}

fn size(folder: &Path) -> u64 {
    let entries = std::fs::read_dir(folder).unwrap().map(Result::unwrap);
    entries
        .map(|entry| match entry.file_type().unwrap().is_dir() {
            true => size(&entry.path()),
            false => entry.metadata().unwrap().len(),
        })
        .sum()
}

/// What is in the newest version of the map, and how right it is.
fn found(map: &Path, drive: usize, name: &str, truths: &Trajectories) -> String {
    let count = |sql: &str| rows(map, None, sql)[0]["n"].as_f64().unwrap_or(0.0);
    let kept = count("SELECT count(*) AS n FROM adjusted_poses");
    let landmarks = count("SELECT count(*) AS n FROM landmarks");
    let moved_mm = 1e3 * count("SELECT max(moved_m) AS n FROM map_frames");
    let error = map_error(&poses(map, None, "poses", "map_from_vehicle"), truths);
    let of = format!("FROM localisations WHERE session = '{name}'");
    let lost = count(&format!(
        "SELECT avg(CASE WHEN state = 'lost' THEN 100.0 ELSE 0.0 END) AS n {of}"
    ));
    let median_cm = (drive > 0).then(|| {
        let before = poses(map, Some(drive as u32), "poses", "map_from_vehicle");
        let mut found = poses(map, None, "localisations", "map_from_vehicle");
        found.retain(|session, _| session == name);
        let error = error_in(&found, truths, &truth_from_map(&before, truths));
        error.map_or(f64::NAN, |error| 100.0 * error.position_m.median)
    });
    format!(
        "{kept} | {landmarks} | {:.2} | {lost:.1} | {:.2} | {moved_mm:.1}",
        100.0 * error.position_m.rmse,
        median_cm.unwrap_or(f64::NAN)
    )
}
