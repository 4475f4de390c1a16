//! Bundle adjustment for measurements, reported as JSON.
//!
//! ```text
//! cargo run --release --example solve_bundle -p evermap-bench -- problem-49-7776-pre.txt --threads 1 --repeat 5
//! cargo run --release --example solve_bundle -p evermap-bench -- --drive 3000 --threads 1
//! ```
//!
//! The first solves a BAL problem, for `tests/peers/bundle_adjustment.py`. The second simulates a
//! drive of so many keyframes with four fisheyes and odometry, as the metric map has them, and
//! adjusts it; it shows how time grows with length. With `--drives K` the road is driven K times, and
//! each drive sees the landmarks of all; with `--reach N` a landmark is seen from N keyframes before it
//! and after it (10 unless told otherwise). `--solver` forces how steps are found: `factorised` or `iterative`.
//! `--regions N` adjusts by regions of N keyframes at most; with `--compare` in one piece before it, too, and tells how far
//! apart poses are. `--write FILE` writes the drives for `tests/peers/ceres_drives.cpp` instead of solving them.
#![allow(clippy::print_stdout, clippy::unwrap_used, clippy::expect_used)]

use std::f64::consts::{FRAC_PI_2, PI};

use evermap_algorithms::geometry::camera::{Camera, Model};
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::{Rig, RigCamera};
use evermap_algorithms::metric_map::bundle_adjustment::{
    self, Keyframe, LinearSolver, Observation, Odometry, Problem, SessionState,
};
use evermap_algorithms::solving::least_squares::{Options, Summary};
use evermap_bench::timing::shortest;
use evermap_bench::{Failure, bal};
use nalgebra::{UnitQuaternion, Vector3};

struct Arguments {
    path: Option<String>,
    drive: usize,
    drives: usize,
    reach: usize,
    solver: LinearSolver,
    regions: Option<usize>,
    compare: bool,
    threads: usize,
    repeat: usize,
    write: Option<String>,
}

fn arguments() -> Result<Arguments, Failure> {
    let mut parsed = Arguments {
        path: None,
        drive: 0,
        drives: 1,
        reach: 10,
        solver: LinearSolver::Cheaper,
        regions: None,
        compare: false,
        threads: 1,
        repeat: 1,
        write: None,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "--threads" => parsed.threads = value()?.parse()?,
            "--repeat" => parsed.repeat = value()?.parse()?,
            "--drives" => parsed.drives = value()?.parse()?,
            "--reach" => parsed.reach = value()?.parse()?,
            "--regions" => parsed.regions = Some(value()?.parse()?),
            "--compare" => parsed.compare = true,
            "--solver" => {
                parsed.solver = match value()?.as_str() {
                    "cheaper" => LinearSolver::Cheaper,
                    "factorised" => LinearSolver::Factorised,
                    "iterative" => LinearSolver::Iterative,
                    other => {
                        return Err(format!(
                            "--solver: expected cheaper, factorised or iterative, found {other}"
                        )
                        .into());
                    }
                }
            }
            "--write" => parsed.write = Some(value()?),
            "--drive" => parsed.drive = value()?.parse()?,
            _ => parsed.path = Some(word),
        }
    }
    Ok(parsed)
}

fn main() -> Result<(), Failure> {
    let arguments = arguments()?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.threads)
        .build()?;
    pool.install(|| match &arguments.path {
        Some(path) => benchmark(&arguments, path),
        None => drive(&arguments),
    })
}

fn benchmark(arguments: &Arguments, path: &str) -> Result<(), Failure> {
    let initial = bal::read(&std::fs::read_to_string(path)?)?;
    let (seconds, summary) = shortest(arguments.repeat, || {
        let mut problem = initial.clone();
        bal::solve(&mut problem, &Options::default(), arguments.solver)
    });
    report(seconds, &summary?, initial.observations.len());
    Ok(())
}

fn drive(arguments: &Arguments) -> Result<(), Failure> {
    let initial = simulated(arguments.drive, arguments.drives, arguments.reach);
    if let Some(path) = &arguments.write {
        return Ok(std::fs::write(path, text(&initial))?);
    }
    let options = bundle_adjustment::Options {
        linear_solver: arguments.solver,
        ..bundle_adjustment::Options::default()
    };
    let whole = match (arguments.regions, arguments.compare) {
        (Some(_), true) => Some(adjusted(arguments, &initial, &options)?),
        _ => None,
    };
    let options = bundle_adjustment::Options {
        region_poses: arguments.regions,
        ..options
    };
    let found = adjusted(arguments, &initial, &options)?;
    if let Some(whole) = whole {
        println!(
            "{}",
            serde_json::json!({ "apart_m": apart_m(&whole, &found) })
        );
    }
    Ok(())
}

/// The problem adjusted, and reported.
fn adjusted(
    arguments: &Arguments,
    initial: &Problem,
    options: &bundle_adjustment::Options,
) -> Result<Problem, Failure> {
    let (seconds, result) = shortest(arguments.repeat, || {
        let mut problem = initial.clone();
        bundle_adjustment::solve(&mut problem, options).map(|report| (problem, report))
    });
    let (problem, found) = result?;
    report(seconds, &found.summary, initial.observations.len());
    if let Some(cut) = found.cut {
        println!(
            "{}",
            serde_json::json!({ "regions": cut.regions, "shared": cut.shared })
        );
    }
    Ok(problem)
}

/// The farthest that a pose of one is from that of the other, metres.
fn apart_m(a: &Problem, b: &Problem) -> f64 {
    let place = |pose: &Keyframe| pose.map_from_vehicle.translation;
    let pairs = a.poses.iter().zip(&b.poses);
    let apart = pairs.map(|(a, b)| (place(a) - place(b)).norm());
    apart.fold(0.0, f64::max)
}

fn report(seconds: f64, summary: &Summary, observations: usize) {
    let iterations = summary.accepted + summary.refused;
    println!(
        "{}",
        serde_json::json!({
            "initial_cost": summary.initial_cost,
            "final_cost": summary.final_cost,
            "iterations": iterations,
            "stop": format!("{:?}", summary.stop),
            "observations": observations,
            "seconds": seconds,
            "microseconds_per_iteration_and_observation":
                seconds * 1e6 / (iterations.max(1) * observations.max(1)) as f64,
        })
    );
}

/// A problem as `tests/peers/ceres_drives.cpp` reads it: a line of counts, then a line for each thing. Turns are
/// quaternions x, y, z, w.
fn text(problem: &Problem) -> String {
    let numbers = |numbers: &[f64]| -> String {
        let words: Vec<String> = numbers.iter().map(f64::to_string).collect();
        words.join(" ")
    };
    let pose = |pose: &Pose| {
        let turn = pose.rotation.coords;
        let at = pose.translation;
        numbers(&[at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w])
    };
    let cameras = problem.rigs[0].cameras.iter();
    let mut lines = vec![format!(
        "{} {} {} {} {} {}",
        problem.poses.len(),
        problem.sessions.len(),
        problem.landmarks.len(),
        problem.observations.len(),
        problem.odometry.len(),
        cameras.len(),
    )];
    lines.extend(problem.poses.iter().map(|keyframe| {
        let fixed = u8::from(keyframe.fixed);
        format!(
            "{} {fixed} {}",
            keyframe.session,
            pose(&keyframe.map_from_vehicle)
        )
    }));
    let landmarks = problem.landmarks.iter();
    lines.extend(landmarks.map(|landmark| numbers(landmark.as_slice())));
    lines.extend(problem.observations.iter().map(|seen| {
        let [u, v] = seen.pixel;
        let named = format!("{} {} {}", seen.pose, seen.camera, seen.landmark);
        format!("{named} {}", numbers(&[u, v, seen.sigma_px]))
    }));
    lines.extend(problem.odometry.iter().map(|step| {
        let (moved, length) = (pose(&step.from_from_to), step.length_m);
        format!(
            "{} {} {moved} {length} {}",
            step.from,
            step.to,
            numbers(&step.sigma)
        )
    }));
    lines.extend(cameras.map(|mounted| {
        let Model::KannalaBrandt(lens) = &mounted.camera.model else {
            unreachable!("the rig's cameras are fisheyes");
        };
        let of_lens = [&lens.focal()[..], &lens.centre(), &lens.distortion()].concat();
        let mount = pose(&mounted.vehicle_from_camera.inverse());
        format!("{} {mount} {}", numbers(&of_lens), lens.max_theta())
    }));
    lines.join("\n")
}

/// SplitMix64: numbers for a simulation.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (2.0 * PI * self.uniform()).cos()
    }
}

/// Four fisheyes of 180° that look ahead, left, back and right.
fn rig() -> Rig {
    let k = [127.0, 0.0, 199.5, 0.0, 127.0, 149.5, 0.0, 0.0, 1.0];
    let lens = [0.012, -0.006, 0.002, -0.0004];
    let camera = Camera::from_calibration("equidistant", 400, 300, &k, &lens).unwrap();
    let ahead = UnitQuaternion::from_euler_angles(-FRAC_PI_2, 0.0, -FRAC_PI_2);
    let mount = |name: &str, position: [f64; 3], yaw: f64| RigCamera {
        name: name.to_owned(),
        camera: camera.clone(),
        vehicle_from_camera: Pose::new(
            Vector3::from(position),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * ahead,
        ),
    };
    Rig {
        cameras: vec![
            mount("front", [3.7, 0.0, 0.7], 0.0),
            mount("left", [2.0, 0.9, 1.0], FRAC_PI_2),
            mount("rear", [-0.8, 0.0, 0.9], PI),
            mount("right", [2.0, -0.9, 1.0], -FRAC_PI_2),
        ],
    }
}

/// Drives of 0.2 m steps along one winding road with points at both sides, 12 new ones per step, each followed as far
/// as `reach` steps by every drive; noise of half a pixel, and a start that is off by centimetres.
fn simulated(keyframes: usize, drives: usize, reach: usize) -> Problem {
    let mut noise = Noise(1);
    let mut problem = Problem {
        rigs: vec![rig()],
        sessions: vec![SessionState::new(0); drives],
        ..Problem::default()
    };
    let mut pose = Pose::identity();
    let mut road = Vec::with_capacity(keyframes);
    for step in 0..keyframes {
        road.push(pose);
        pose = pose.compose(&Pose::from_yaw(0.2, 0.0, 0.02 * (step as f64 * 0.01).sin()));
    }
    let across = |drive: usize| 0.3 * (drive % 5) as f64 - 0.6 * f64::from(u8::from(drive > 0));
    let driven = |drive| {
        road.iter()
            .map(move |pose| pose.compose(&Pose::from_yaw(0.0, across(drive), 0.0)))
    };
    let poses: Vec<Vec<Pose>> = (0..drives).map(|drive| driven(drive).collect()).collect();
    for (at, pose) in road.iter().enumerate() {
        for _ in 0..12 {
            let side = if noise.uniform() < 0.5 { -1.0 } else { 1.0 };
            let across = side * (2.5 + 3.0 * noise.uniform());
            let point = Vector3::new(1.4, across, 2.5 * noise.uniform());
            let point = pose.transform(&point);
            sight(&mut problem, &poses, (at, reach), &point, &mut noise);
        }
    }
    for (session, poses) in poses.iter().enumerate() {
        add_drive(&mut problem, session, poses, &mut noise);
    }
    problem
}

/// Adds the poses and the odometry of a drive.
fn add_drive(problem: &mut Problem, session: usize, poses: &[Pose], noise: &mut Noise) {
    let first = problem.poses.len();
    for (at, pair) in poses.windows(2).enumerate() {
        let motion = pair[0].inverse().compose(&pair[1]);
        let measured = Pose::from_yaw(
            motion.translation.x / 1.01 + 0.003 * noise.normal(),
            motion.translation.y + 0.003 * noise.normal(),
            motion.yaw() + 0.001 * noise.normal(),
        );
        problem.odometry.push(Odometry {
            from: first + at,
            to: first + at + 1,
            from_from_to: measured,
            length_m: 0.2,
            sigma: [0.005, 0.005, 0.02, 0.01, 0.01, 0.003],
        });
    }
    problem
        .poses
        .extend(poses.iter().enumerate().map(|(at, pose)| {
            let fixed = first + at == 0;
            let (x, y, yaw) = (noise.normal(), noise.normal(), noise.normal());
            let off = Pose::from_yaw(0.02 * x, 0.02 * y, 0.002 * yaw);
            Keyframe {
                session,
                map_from_vehicle: if fixed { *pose } else { pose.compose(&off) },
                fixed,
            }
        }));
}

/// Adds a landmark with its observations from `reach` steps of every drive before and after it.
fn sight(
    problem: &mut Problem,
    drives: &[Vec<Pose>],
    (at, reach): (usize, usize),
    point: &Vector3<f64>,
    noise: &mut Noise,
) {
    let landmark = problem.landmarks.len();
    let off = Vector3::from_fn(|_, _| 0.05 * noise.normal());
    problem.landmarks.push(point + off);
    let length = drives[0].len();
    let near = at.saturating_sub(reach)..(at + reach).min(length);
    for (drive, poses) in drives.iter().enumerate() {
        for step in near.clone() {
            for (camera, mounted) in problem.rigs[0].cameras.iter().enumerate() {
                let map_from_camera = poses[step].compose(&mounted.vehicle_from_camera);
                let seen = map_from_camera.inverse().transform(point);
                // Tracks end: four of ten sights are missed.
                let Some(pixel) = mounted
                    .camera
                    .project(&seen)
                    .filter(|_| seen.z > 0.3 * seen.norm())
                else {
                    continue;
                };
                if mounted.camera.contains(pixel) && noise.uniform() < 0.6 {
                    problem.observations.push(Observation {
                        pose: drive * length + step,
                        camera,
                        landmark,
                        pixel: pixel.map(|x| x + 0.5 * noise.normal()),
                        sigma_px: 0.5,
                    });
                }
            }
        }
    }
}
