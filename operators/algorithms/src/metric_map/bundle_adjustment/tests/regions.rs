//! By regions as in one piece.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::Vector3;

use super::super::*;
use super::{Drive, four_fisheyes, noise, odometry, options, sightings};

/// Drives beside each other along one winding road, a metre a step, with points at both sides.
fn road(drives: usize, steps: usize, seed: u64) -> Drive {
    let mut noise = noise(seed);
    let mut middle = Pose::identity();
    let mut path = Vec::new();
    for step in 0..steps {
        path.push(middle);
        let turn = 0.05 * (step as f64 * 0.1).sin();
        middle = middle.compose(&Pose::from_yaw(1.0, 0.0, turn));
    }
    let mut truth = Problem {
        rigs: vec![four_fisheyes()],
        sessions: vec![SessionState::new(0); drives],
        ..Problem::default()
    };
    for session in 0..drives {
        let aside = Pose::from_yaw(0.0, 0.4 * session as f64, 0.0);
        truth.poses.extend(path.iter().map(|pose| Keyframe {
            session,
            map_from_vehicle: pose.compose(&aside),
            fixed: false,
        }));
    }
    truth.poses[0].fixed = true;
    for pose in &path {
        for side in [-1.0, 1.0, -1.0, 1.0] {
            let across = side * (3.0 + 2.0 * noise.unit());
            let point = Vector3::new(noise.unit(), across, 3.0 * noise.unit());
            truth.landmarks.push(pose.transform(&point));
        }
    }
    truth.observations = sightings(&truth);
    let first = (0..drives * steps).filter(|pose| (pose + 1) % steps != 0);
    truth.odometry = first.map(|pose| odometry(&truth, pose)).collect();
    Drive { truth, noise }
}

/// Noise, outliers, a wheel that slips, an odometry that is wrong, and losses that bear it.
fn hard(drives: usize, steps: usize) -> (Problem, Options) {
    let mut drive = road(drives, steps, 11);
    let mut problem = drive.disturbed(0.5, 0.03);
    for seen in problem.observations.iter_mut().step_by(23) {
        seen.pixel[0] += 30.0;
    }
    for step in &mut problem.odometry {
        step.from_from_to.translation /= 1.02;
        step.length_m /= 1.02;
    }
    problem.odometry[steps / 3].from_from_to.translation.x += 0.4;
    let options = Options {
        observation_loss: Loss::Cauchy(2.0),
        odometry_loss: Loss::DynamicCovarianceScaling(22.0),
        linear_solver: LinearSolver::Factorised,
        ..options()
    };
    (problem, options)
}

fn by_regions(options: &Options, poses: usize) -> Options {
    Options {
        region_poses: Some(poses),
        ..*options
    }
}

/// The farthest that a pose of one is from that of the other, metres.
fn apart(a: &Problem, b: &Problem) -> f64 {
    let poses = a.poses.iter().zip(&b.poses);
    let apart = poses
        .map(|(a, b)| (a.map_from_vehicle.translation - b.map_from_vehicle.translation).norm());
    apart.fold(0.0, f64::max)
}

#[test]
fn regions_end_where_the_whole_does() {
    let (start, options) = hard(2, 200);
    let mut whole = start.clone();
    let one = solve(&mut whole, &options).unwrap();
    assert!(one.cut.is_none() && one.summary.converged());
    for poses in [60, 150] {
        let mut found = start.clone();
        let report = solve(&mut found, &by_regions(&options, poses)).unwrap();
        let cut = report.cut.unwrap();
        assert_eq!(cut.regions, 400_usize.div_ceil(poses));
        // The poses on both sides of each cut that see across it.
        assert!(cut.shared < 50 * (cut.regions - 1), "{cut:?}");
        // Step for step the same, to rounding.
        assert_eq!(report.summary.accepted, one.summary.accepted);
        assert_eq!(report.summary.refused, one.summary.refused);
        assert_eq!(report.summary.stop, one.summary.stop);
        assert!(apart(&whole, &found) < 1e-7, "{}", apart(&whole, &found));
        for (a, b) in whole.sessions.iter().zip(&found.sessions) {
            assert!((a.odometry_scale - b.odometry_scale).abs() < 1e-8);
            assert!((a.odometry_yaw_rad_per_m - b.odometry_yaw_rad_per_m).abs() < 1e-8);
        }
        for (a, b) in whole.landmarks.iter().zip(&found.landmarks) {
            assert!((a - b).norm() < 1e-4, "{a} {b}");
        }
        for (a, b) in one.observations.iter().zip(&report.observations) {
            assert!((a.weight - b.weight).abs() < 1e-4);
        }
    }
    // As the whole is adjusted unless told otherwise.
    let mut cheaper = start.clone();
    let unforced = Options {
        linear_solver: LinearSolver::Iterative,
        ..options
    };
    solve(&mut cheaper, &unforced).unwrap();
    let mut found = start;
    solve(&mut found, &by_regions(&unforced, 100)).unwrap();
    assert!(
        apart(&cheaper, &found) < 1e-4,
        "{}",
        apart(&cheaper, &found)
    );
}

#[test]
fn regions_are_the_same_on_any_number_of_threads() {
    let (start, options) = hard(2, 80);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut problem = start.clone();
        let options = by_regions(&options, 16);
        let report = pool.install(|| solve(&mut problem, &options).unwrap());
        assert_eq!(report.cut.unwrap().regions, 10);
        problem
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
}

#[test]
fn fixed_poses_blind_keyframes_and_what_nobody_sees_lie_in_regions_too() {
    let mut drive = road(2, 60, 12);
    let mut start = drive.disturbed(0.3, 0.02);
    for (pose, truth) in start.poses.iter_mut().zip(&drive.truth.poses).step_by(17) {
        *pose = Keyframe {
            fixed: true,
            ..*truth
        };
    }
    start
        .observations
        .retain(|seen| !(30..33).contains(&seen.pose));
    // Never seen; never driven; a pose without anything.
    start.landmarks.push(Vector3::zeros());
    start.sessions.push(SessionState::new(0));
    start.poses.push(Keyframe {
        session: 2,
        map_from_vehicle: Pose::from_yaw(1.0, 2.0, 3.0),
        fixed: false,
    });
    let mut whole = start.clone();
    let one = solve(&mut whole, &options()).unwrap();
    let mut found = start.clone();
    let report = solve(&mut found, &by_regions(&options(), 20)).unwrap();
    assert_eq!(report.summary.accepted, one.summary.accepted);
    assert!(apart(&whole, &found) < 1e-7, "{}", apart(&whole, &found));
    assert_eq!(found.poses.last(), start.poses.last());
    assert_eq!(found.landmarks.last(), start.landmarks.last());
    for (before, after) in start.poses.iter().zip(&found.poses) {
        assert!(!before.fixed || before == after);
    }
}

#[test]
fn drives_that_have_nothing_in_common_share_nothing() {
    let mut one = road(1, 40, 13);
    let mut start = one.disturbed(0.3, 0.02);
    let other = road(1, 40, 14).disturbed(0.3, 0.02);
    let (poses, landmarks) = (start.poses.len(), start.landmarks.len());
    start.sessions.extend(other.sessions);
    start.poses.extend(other.poses.iter().map(|pose| Keyframe {
        session: 1,
        ..*pose
    }));
    start.landmarks.extend(other.landmarks);
    let seen = other.observations.iter().map(|seen| Observation {
        pose: poses + seen.pose,
        landmark: landmarks + seen.landmark,
        ..*seen
    });
    start.observations.extend(seen);
    let steps = other.odometry.iter().map(|step| Odometry {
        from: poses + step.from,
        to: poses + step.to,
        ..*step
    });
    start.odometry.extend(steps);
    let mut whole = start.clone();
    solve(&mut whole, &options()).unwrap();
    let mut found = start;
    let report = solve(&mut found, &by_regions(&options(), 40)).unwrap();
    assert_eq!(
        report.cut,
        Some(Cut {
            regions: 2,
            shared: 0
        })
    );
    assert!(apart(&whole, &found) < 1e-7, "{}", apart(&whole, &found));
}
