//! What a map costs as drives are added to it: many drives through one simulated car park, one run each, and for each
//! version its seconds, memory, bytes read, size and accuracy; of the parking spaces that somebody drew once, after the first
//! drive, how far they are from where they truly are, and how far off a vehicle would stop that finds itself in the version
//! before and drives to them from 20 m (paper 1, sections VI-A and VI-D).
//!
//! ```sh
//! cargo build --release --package evermap
//! cargo run --release --package evermap-tests --example many_drives -- FOLDER 30 [PLAN [SEED]]
//! ```
//!
//! A folder that has a world and a map goes on with them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use evermap_bench::trajectory::Statistics;
use evermap_tests::park::SMALL;
use evermap_tests::trajectories::{
    Trajectories, error_in, map_error, pairs, poses, rows, truth, truth_from_map,
};
use evermap_tests::{plan_command, simulate, text};
use nalgebra::Vector3;
use serde_json::Value;

/// Of Linux on all machines that evermap is built for.
const TICKS_PER_S: f64 = 100.0;
/// How often a run is looked at.
const LOOK: Duration = Duration::from_millis(50);

fn main() {
    let mut arguments = std::env::args().skip(1);
    let usage = "expected FOLDER and a number of drives";
    let folder = PathBuf::from(arguments.next().expect(usage));
    let drives: usize = arguments.next().expect(usage).parse().expect(usage);
    let plan = arguments.next().unwrap_or_else(|| "labels".to_owned());
    let seed = arguments.next().unwrap_or_else(|| "1".to_owned());
    let world = folder.join("world");
    if !world.exists() {
        simulate_drives(&world, drives, &seed);
    }
    let map = folder.join("map");
    let spaces = spaces(&world);
    println!(
        "| drive | s | CPU s | peak MiB | read MiB | map MiB | keyframes kept | landmarks | ATE cm | lost % | median cm | frame moved mm | spaces off cm, median, worst | parked off cm, median, worst |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut truths = Trajectories::new();
    let done = drives_in(&map);
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
            "| {} | {cost} | {} | {} |",
            drive + 1,
            found(&map, &name, &truths),
            labels(&map, &name, &truths, &spaces)
        );
        if drive == 0 && plan != "lifelong" {
            add(&plan, &map, &world.join("annotations.mcap"));
        }
    }
}

/// Thirty drives of it fit into two hours.
fn simulate_drives(world: &Path, drives: usize, seed: &str) {
    let (revisits, seed) = (format!("revisits={}", drives - 1), format!("seed={seed}"));
    let own = ["loops=0.5", "annotations=true", &revisits, &seed];
    let settings: Vec<&str> = SMALL.into_iter().chain(own).collect();
    simulate("car_park", world, &settings);
}

/// How many drives the map has.
fn drives_in(map: &Path) -> usize {
    let sql = "SELECT DISTINCT session FROM keyframes";
    map.exists()
        .then(|| rows(map, None, sql))
        .map_or(0, |found| found.len())
}

/// Where the middles of the parking spaces truly are, by what the annotator calls them, m.
fn spaces(world: &Path) -> BTreeMap<String, [f64; 2]> {
    let text = std::fs::read_to_string(world.join("truth/bays.geojson")).unwrap();
    let truth: Value = serde_json::from_str(&text).unwrap();
    let space = |feature: &Value| {
        let label = feature["properties"]["label"].as_str().unwrap();
        let ring = feature["geometry"]["coordinates"][0].as_array().unwrap();
        // The last point of a ring is the first one again.
        let corners = &ring[1..];
        let mean = |axis: usize| {
            let sum: f64 = corners
                .iter()
                .map(|corner| corner[axis].as_f64().unwrap())
                .sum();
            sum / corners.len() as f64
        };
        (format!("space {label}"), [mean(0), mean(1)])
    };
    truth["features"]
        .as_array()
        .unwrap()
        .iter()
        .map(space)
        .collect()
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
fn found(map: &Path, name: &str, truths: &Trajectories) -> String {
    let number = |sql: &str| rows(map, None, sql)[0]["n"].as_f64();
    let count = |sql: &str| number(sql).unwrap_or(0.0);
    let kept = count("SELECT count(*) AS n FROM adjusted_poses");
    let landmarks = count("SELECT count(*) AS n FROM landmarks");
    let moved_mm = 1e3 * count("SELECT max(moved_m) AS n FROM map_frames");
    let error = map_error(&poses(map, None, "poses", "map_from_vehicle"), truths);
    let of = format!("FROM localisations WHERE session = '{name}'");
    let lost = number(&format!(
        "SELECT avg(CASE WHEN state = 'lost' THEN 100.0 ELSE 0.0 END) AS n {of}"
    ));
    let median_cm = before(map).and_then(|before| {
        let before = poses(map, Some(before), "poses", "map_from_vehicle");
        let mut found = poses(map, None, "localisations", "map_from_vehicle");
        found.retain(|session, _| session == name);
        let error = error_in(&found, truths, &truth_from_map(&before, truths));
        error.map(|error| 100.0 * error.position_m.median)
    });
    // The first drive had no map to be localised in.
    let of_fixes = |found: Option<f64>, digits: usize| {
        found.map_or_else(|| "none".to_owned(), |found| format!("{found:.digits$}"))
    };
    format!(
        "{kept} | {landmarks} | {:.2} | {} | {} | {moved_mm:.1}",
        100.0 * error.position_m.rmse,
        of_fixes(lost, 1),
        of_fixes(median_cm, 2)
    )
}

/// How far drawn spaces are from where they are, and from where a vehicle expects them that found itself in the version
/// before: median and worst of each, cm.
fn labels(
    map: &Path,
    name: &str,
    truths: &Trajectories,
    spaces: &BTreeMap<String, [f64; 2]>,
) -> String {
    let drawn = drawn(map, None, spaces);
    let truth_from_map = truth_from_map(&poses(map, None, "poses", "map_from_vehicle"), truths);
    let off = drawn.iter().map(|(label, space)| {
        let found = truth_from_map.transform(label);
        (found.xy() - space.xy()).norm()
    });
    let parked = before(map).map_or_else(Vec::new, |before| {
        parked(map, name, truths, &self::drawn(map, Some(before), spaces))
    });
    format!("{} | {}", statistics(off.collect()), statistics(parked))
}

/// The version before the newest one.
fn before(map: &Path) -> Option<u32> {
    let newest = rows(map, None, "SELECT max(version) AS n FROM versions")[0]["n"].as_u64();
    newest
        .filter(|newest| *newest > 1)
        .map(|newest| newest as u32 - 1)
}

/// Drawn spaces of a version: where the map has them, and where they truly are, m.
fn drawn(
    map: &Path,
    version: Option<u32>,
    spaces: &BTreeMap<String, [f64; 2]>,
) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let there = rows(
        map,
        version,
        "SELECT layer FROM layers WHERE layer = 'placed_labels'",
    );
    if there.is_empty() {
        return Vec::new();
    }
    let sql = "SELECT label, map_from_label['x'] AS x, map_from_label['y'] AS y, map_from_label['z'] AS z \
               FROM placed_labels WHERE kind = 'parking_space' AND standing = 'drawn'";
    let label = |row: &Value| {
        let [x, y] = *spaces.get(row["label"].as_str()?)?;
        let found = ["x", "y", "z"].map(|axis| row[axis].as_f64().unwrap());
        Some((Vector3::from(found), Vector3::new(x, y, 0.0)))
    };
    rows(map, version, sql).iter().filter_map(label).collect()
}

/// Where a vehicle expects each space, against where it is, at each pose from 20 m on.
fn parked(
    map: &Path,
    name: &str,
    truths: &Trajectories,
    drawn: &[(Vector3<f64>, Vector3<f64>)],
) -> Vec<f64> {
    let found = pairs(
        &poses(map, None, "localisations", "map_from_vehicle"),
        truths,
    );
    let found = found.get(name).map_or(&[][..], Vec::as_slice);
    let mut off = Vec::new();
    for pair in found {
        for (label, space) in drawn {
            let standing = Vector3::new(space.x, space.y, pair.truth.translation.z);
            let truly = pair.truth.inverse().transform(&standing);
            if truly.norm() <= 20.0 {
                let expected = pair.estimate.inverse().transform(label);
                off.push((expected.xy() - truly.xy()).norm());
            }
        }
    }
    off
}

fn statistics(metres: Vec<f64>) -> String {
    let said = |found: Statistics| format!("{:.1}, {:.1}", 100.0 * found.median, 100.0 * found.max);
    Statistics::of(metres).map_or_else(|| "none".to_owned(), said)
}
