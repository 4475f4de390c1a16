//! Road networks from true paths plus noise, held against where was driven, by positions alone and with headings; prints
//! the tables of `BENCHMARKS.md`.
//!
//! ```text
//! cargo run --release --example lanes -p evermap-bench -- ../shared
//! ```
#![allow(clippy::print_stdout, clippy::unwrap_used, clippy::expect_used)]

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use evermap_algorithms::ground::road_network::{
    RoadNetwork, RoadNetworkParams, Trace, Travel, road_network,
};
use evermap_bench::Failure;
use evermap_worlds::{CarPark, car_park};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Standard deviation of a mapped position, metres.
const NOISE_M: f64 = 0.05;
/// Bound on how far a driven metre may be from a lane of its direction, metres.
const NEAR_M: f64 = 0.3;
/// An intersection is found within this distance of the true one, metres: an aisle's width.
const JUNCTION_M: f64 = 6.0;

type Path3 = Vec<[f64; 3]>;

/// True paths of a place, and its true intersections where they are known.
struct Place {
    name: String,
    paths: Vec<Path3>,
    junctions: Option<Vec<[f64; 2]>>,
}

fn main() -> Result<(), Failure> {
    let shared = PathBuf::from(
        std::env::args()
            .nth(1)
            .ok_or("expected the shared folder")?,
    );
    let places = places(&shared)?;
    for headings in [false, true] {
        let params = RoadNetworkParams {
            headings,
            ..RoadNetworkParams::default()
        };
        println!(
            "\n{}\n",
            if headings {
                "With headings:"
            } else {
                "Positions alone:"
            }
        );
        println!(
            "| place | passes | lanes | lane m | driven within {NEAR_M} m | 99 % | worst | out of the lane, worst | \
             lane within {NEAR_M} m of a path | 99 % | worst | sharpest turn | intersections found, missed, invented | ms |"
        );
        println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
        for place in &places {
            let noisy = noisy(&place.paths);
            let start = Instant::now();
            let network = network(&noisy, &params);
            let milliseconds = start.elapsed().as_secs_f64() * 1e3;
            println!("{} {milliseconds:.0} |", row(place, &network));
        }
        growth(&params);
    }
    Ok(())
}

fn network(paths: &[Path3], params: &RoadNetworkParams) -> RoadNetwork {
    let keys: Vec<String> = (0..paths.len()).map(|k| format!("{k:05}")).collect();
    let traces: Vec<Trace<'_>> = keys
        .iter()
        .zip(paths)
        .map(|(key, positions)| Trace {
            key,
            positions,
            breaks: &[],
        })
        .collect();
    road_network(&traces, params).unwrap()
}

fn row(place: &Place, network: &RoadNetwork) -> String {
    let driven: Vec<[f64; 4]> = place.paths.iter().flat_map(|path| directed(path)).collect();
    let lanes: Vec<[f64; 4]> = network
        .lanes
        .iter()
        .flat_map(|lane| {
            let ahead = directed(&lane.points);
            let back = ahead.iter().map(|[x, y, u, v]| [*x, *y, -u, -v]).collect();
            match lane.travel {
                Travel::Forward => vec![ahead],
                Travel::Reverse => vec![back],
                Travel::Both | Travel::Unknown => vec![ahead, back],
            }
        })
        .flatten()
        .collect();
    let (covered, far) = (distances(&driven, &lanes), distances(&lanes, &driven));
    let out = out_of_lanes(&driven, network);
    let metres: f64 = network.lanes.iter().map(|lane| lane.length_m).sum();
    let turns = network.lanes.iter().flat_map(|lane| turns(&lane.points));
    let found: Vec<[f64; 2]> = network
        .intersections
        .iter()
        .map(|i| [i.position[0], i.position[1]])
        .collect();
    let junctions = place.junctions.as_ref().map_or_else(
        || format!("{}", found.len()),
        |truth| {
            let near = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < JUNCTION_M;
            let hit = |a: &&[f64; 2], of: &[[f64; 2]]| of.iter().any(|b| near(a, b));
            let met = truth.iter().filter(|a| hit(a, &found)).count();
            let right = found.iter().filter(|a| hit(a, truth)).count();
            format!(
                "{}, {}, {}",
                found.len(),
                truth.len() - met,
                found.len() - right
            )
        },
    );
    format!(
        "| {} | {} | {} | {metres:.0} | {} | {out:.2} | {} | {:.0}° | {junctions} |",
        place.name,
        place.paths.len(),
        network.lanes.len(),
        summary(&covered),
        summary(&far),
        turns.fold(0.0, f64::max),
    )
}

fn summary(off: &[f64]) -> String {
    let mut sorted = off.to_vec();
    sorted.sort_by(f64::total_cmp);
    let near = sorted.partition_point(|off| *off <= NEAR_M) as f64 / sorted.len().max(1) as f64;
    let at = |q: f64| {
        sorted
            .get((q * (sorted.len().max(1) - 1) as f64) as usize)
            .copied()
            .unwrap_or(f64::NAN)
    };
    format!("{:.2} % | {:.2} | {:.2}", 100.0 * near, at(0.99), at(1.0))
}

/// How far the vehicle's side was out of the lane nearest to its path, at worst, metres; 0 where lanes are as wide as
/// what was driven.
fn out_of_lanes(driven: &[[f64; 4]], network: &RoadNetwork) -> f64 {
    let vehicle_m = RoadNetworkParams::default().vehicle_width_m;
    let mut inside = vec![f64::INFINITY; driven.len()];
    for lane in &network.lanes {
        let mut ways = directed(&lane.points);
        let back: Vec<[f64; 4]> = ways.iter().map(|[x, y, u, v]| [*x, *y, -u, -v]).collect();
        ways.extend(back);
        for (inside, off) in inside.iter_mut().zip(distances(driven, &ways)) {
            *inside = inside.min(off - 0.5 * (lane.width_m - vehicle_m));
        }
    }
    inside.into_iter().fold(0.0, f64::max)
}

/// Turns between successive pieces of at least 0.4 m, degrees.
fn turns(line: &[[f64; 3]]) -> Vec<f64> {
    let mut kept: Vec<[f64; 3]> = Vec::new();
    for point in line {
        let far = |last: &[f64; 3]| (point[0] - last[0]).hypot(point[1] - last[1]) >= 0.4;
        if kept.last().is_none_or(far) {
            kept.push(*point);
        }
    }
    let way = |a: &[f64; 3], b: &[f64; 3]| (b[1] - a[1]).atan2(b[0] - a[0]);
    let bend = |p: &[[f64; 3]]| {
        let turn = (way(&p[1], &p[2]) - way(&p[0], &p[1])).rem_euclid(TAU);
        turn.min(TAU - turn).to_degrees()
    };
    kept.windows(3).map(bend).collect()
}

/// Points every decimetre with the direction of travel.
fn directed(path: &[[f64; 3]]) -> Vec<[f64; 4]> {
    let mut points = Vec::new();
    let mut kept: Vec<[f64; 3]> = Vec::new();
    for point in path {
        let far = |last: &[f64; 3]| (point[0] - last[0]).hypot(point[1] - last[1]) >= 0.2;
        if kept.last().is_none_or(far) {
            kept.push(*point);
        }
    }
    for pair in kept.windows(2) {
        let (dx, dy) = (pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]);
        let length = dx.hypot(dy);
        let parts = (length / 0.1).ceil() as u32;
        for part in 0..parts {
            let t = f64::from(part) / f64::from(parts);
            let (x, y) = (pair[0][0] + t * dx, pair[0][1] + t * dy);
            points.push([x, y, dx / length, dy / length]);
        }
    }
    points
}

/// From each point to the nearest of the others that goes its way (less than 45° off), metres; at most 20.
fn distances(from: &[[f64; 4]], to: &[[f64; 4]]) -> Vec<f64> {
    let cell = |p: &[f64; 4]| [(p[0] / 2.0).floor() as i64, (p[1] / 2.0).floor() as i64];
    let mut cells: BTreeMap<[i64; 2], Vec<[f64; 4]>> = BTreeMap::new();
    for point in to {
        cells.entry(cell(point)).or_default().push(*point);
    }
    let nearest = |p: &[f64; 4], reach: i64| {
        let [x, y] = cell(p);
        let around = (x - reach..=x + reach)
            .flat_map(|x| (y - reach..=y + reach).map(move |y| [x, y]))
            .filter_map(|at| cells.get(&at))
            .flatten();
        around
            .filter(|q| p[2] * q[2] + p[3] * q[3] > 0.7)
            .map(|q| (p[0] - q[0]).hypot(p[1] - q[1]))
            .fold(20.0, f64::min)
    };
    let of = |p: &[f64; 4]| match nearest(p, 1) {
        near if near <= 2.0 => near,
        _ => nearest(p, 10),
    };
    from.iter().map(of).collect()
}

fn noisy(paths: &[Path3]) -> Vec<Path3> {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut normal = || -> f64 { (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0 };
    let mut moved = |p: &[f64; 3]| [p[0] + NOISE_M * normal(), p[1] + NOISE_M * normal(), p[2]];
    paths
        .iter()
        .map(|path| path.iter().map(&mut moved).collect())
        .collect()
}

fn places(shared: &Path) -> Result<Vec<Place>, Failure> {
    let mut places = vec![world(
        "carpark_small",
        &shared.join("worlds/carpark_small"),
    )?];
    let folder = std::env::temp_dir().join(format!("evermap_lanes_{}", std::process::id()));
    for (seed, (west_bays, east_bays), revisits) in [
        (11, (2, 4), 2),
        (12, (3, 5), 3),
        (13, (6, 4), 5),
        (14, (10, 14), 4),
        (15, (2, 2), 12),
    ] {
        let out = folder.join(seed.to_string());
        let park = CarPark {
            seed,
            revisits,
            west_bays,
            east_bays,
            width_px: 32,
            height_px: 32,
            floor_texels_per_m: 10.0,
            rate_hz: 12.5,
            ..CarPark::default()
        };
        car_park(&park, &out, &mut |_| {}, &|| false)?;
        places.push(world(&format!("simulated, seed {seed}"), &out)?);
    }
    fs::remove_dir_all(&folder)?;
    for name in ["00", "07"] {
        let text = fs::read_to_string(shared.join(format!("data/kitti_poses/{name}.txt")))?;
        let number = |line: &str, at: usize| -> f64 {
            line.split_whitespace().nth(at).unwrap().parse().unwrap()
        };
        let path = text
            .lines()
            .map(|line| [number(line, 11), -number(line, 3), -number(line, 7)]);
        places.push(Place {
            name: format!("KITTI {name}"),
            paths: vec![path.collect()],
            junctions: None,
        });
    }
    Ok(places)
}

/// A simulated car park: the trajectories in it, by session, and its lane graph.
fn world(name: &str, folder: &Path) -> Result<Place, Failure> {
    let mut files: Vec<PathBuf> = fs::read_dir(folder)?
        .flatten()
        .flat_map(|entry| match entry.path() {
            path if path.is_dir() => fs::read_dir(path)
                .unwrap()
                .flatten()
                .map(|e| e.path())
                .collect(),
            path => vec![path],
        })
        .collect();
    files.extend(
        fs::read_dir(folder.join("truth"))?
            .flatten()
            .map(|e| e.path()),
    );
    files.retain(|path| path.extension().is_some_and(|e| e == "tum"));
    files.retain(|path| !path.to_string_lossy().contains("50hz"));
    files.sort();
    files.dedup();
    let paths = files.iter().map(|file| {
        let text = fs::read_to_string(file).unwrap();
        let row = |line: &str| {
            let n: Vec<f64> = line
                .split_whitespace()
                .map(|word| word.parse().unwrap())
                .collect();
            [n[1], n[2], n[3]]
        };
        text.lines()
            .filter(|line| !line.starts_with('#'))
            .map(row)
            .collect()
    });
    let graph: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("truth/lane_graph.json"))?)?;
    let junctions = graph["nodes"].as_array().ok_or("no nodes")?.iter();
    let junctions = junctions.filter(|node| node["degree"].as_f64() > Some(2.0));
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    Ok(Place {
        name: name.to_owned(),
        paths: paths.collect(),
        junctions: Some(
            junctions
                .map(|node| [number(&node["x"]), number(&node["y"])])
                .collect(),
        ),
    })
}

/// Time against the number of drives: a third goes round a ring, a third round it the other way 3 m further in, a third
/// leaves it straight on after a quarter. That is three lanes and one intersection, whatever the number.
fn growth(params: &RoadNetworkParams) {
    println!("\n| drives | poses | lanes | intersections | ms | µs a pose |");
    println!("|---|---|---|---|---|---|");
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for drives in [1, 3, 10, 30, 100, 300] {
        let paths: Vec<Path3> = (0..drives)
            .map(|drive| {
                let aside = random.random_range(-0.2..0.2);
                (0..2000).map(|step| on_ring(drive, step, aside)).collect()
            })
            .collect();
        let noisy = noisy(&paths);
        let start = Instant::now();
        let network = network(&noisy, params);
        let seconds = start.elapsed().as_secs_f64();
        let poses = drives * 2000;
        println!(
            "| {drives} | {poses} | {} | {} | {:.0} | {:.2} |",
            network.lanes.len(),
            network.intersections.len(),
            seconds * 1e3,
            seconds * 1e6 / f64::from(poses)
        );
    }
}

fn on_ring(drive: i32, step: i32, aside: f64) -> [f64; 3] {
    let way_m = 0.22 * f64::from(step);
    let radius = 64.0 + aside;
    let quarter = 0.25 * TAU * radius;
    match drive % 3 {
        1 => {
            let (sin, cos) = (-way_m / 61.0).sin_cos();
            [(radius - 3.0) * cos, (radius - 3.0) * sin, 0.0]
        }
        2 if way_m > quarter => [quarter - way_m, radius, 0.0],
        _ => {
            let (sin, cos) = (way_m / radius).sin_cos();
            [radius * cos, radius * sin, 0.0]
        }
    }
}
