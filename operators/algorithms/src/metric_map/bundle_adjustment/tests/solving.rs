//! What comes out of simulated drives.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{UnitQuaternion, Vector3};

use super::super::*;
use super::{Drive, options};

#[test]
fn exact_data_converge_to_the_truth() {
    let mut drive = Drive::new(24, 150, 1);
    let mut problem = drive.disturbed(0.0, 0.1);
    let before = drive.error_m(&problem);
    let report = solve(&mut problem, &options()).unwrap();
    assert!(before > 0.1 && drive.error_m(&problem) < 1e-6, "{report:?}");
    assert!(report.summary.final_cost < 1e-9 && report.summary.converged());
    assert!(report.observations.iter().all(|o| o.weight == 1.0));
    for (landmark, truth) in problem.landmarks.iter().zip(&drive.truth.landmarks) {
        assert!((landmark - truth).norm() < 1e-4);
    }
}

#[test]
fn a_wrong_odometry_scale_and_drift_are_found_through_the_rig() {
    let mut drive = Drive::new(40, 250, 2);
    let mut problem = drive.disturbed(0.3, 0.05);
    for step in &mut problem.odometry {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -0.004 * step.length_m);
        step.from_from_to.translation /= 1.05;
        step.from_from_to.rotation *= turn;
        step.length_m /= 1.05;
    }
    let report = solve(&mut problem, &Options::default()).unwrap();
    let session = problem.sessions[0];
    assert!((session.odometry_scale - 1.05).abs() < 0.004, "{session:?}");
    assert!(
        (session.odometry_yaw_rad_per_m - 0.0042).abs() < 0.0008,
        "{session:?}"
    );
    assert!(
        drive.error_m(&problem) < 0.02,
        "{} {:?}",
        drive.error_m(&problem),
        report.summary
    );
}

#[test]
fn results_are_the_same_on_any_number_of_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut drive = Drive::new(60, 300, 3);
        let mut problem = drive.disturbed(0.5, 0.05);
        pool.install(|| solve(&mut problem, &Options::default()).unwrap());
        problem
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
}

/// The same round driven several times.
fn overlapping(drives: usize, steps: usize) -> Problem {
    let mut all = Drive::new(steps, 300, 5);
    let one = all.disturbed(0.5, 0.05);
    let mut problem = one.clone();
    for drive in 1..drives {
        let own = all.disturbed(0.5, 0.05);
        let first = problem.poses.len();
        problem.sessions.extend(own.sessions);
        problem.poses.extend(own.poses.iter().map(|pose| Keyframe {
            session: drive,
            fixed: false,
            ..*pose
        }));
        problem
            .observations
            .extend(own.observations.iter().map(|seen| Observation {
                pose: first + seen.pose,
                ..*seen
            }));
        problem
            .odometry
            .extend(own.odometry.iter().map(|step| Odometry {
                from: first + step.from,
                to: first + step.to,
                ..*step
            }));
    }
    problem
}

#[test]
fn conjugate_gradients_end_where_the_factorisation_does() {
    let start = overlapping(3, 60);
    let run = |linear_solver| {
        let mut problem = start.clone();
        let options = Options {
            linear_solver,
            ..Options::default()
        };
        let summary = solve(&mut problem, &options).unwrap().summary;
        (problem, summary)
    };
    let (direct, exact) = run(LinearSolver::Factorised);
    let (found, inexact) = run(LinearSolver::Iterative);
    assert!(
        inexact.final_cost <= exact.final_cost * (1.0 + 1e-6),
        "{exact:?} {inexact:?}"
    );
    assert!(
        inexact.accepted <= exact.accepted + 1,
        "{exact:?} {inexact:?}"
    );
    for (a, b) in direct.poses.iter().zip(&found.poses) {
        let off = a.map_from_vehicle.translation - b.map_from_vehicle.translation;
        assert!(off.norm() < 1e-4, "{off}");
    }
}

#[test]
fn conjugate_gradients_are_the_same_on_any_number_of_threads() {
    let start = overlapping(2, 60);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut problem = start.clone();
        let options = Options {
            linear_solver: LinearSolver::Iterative,
            ..Options::default()
        };
        pool.install(|| solve(&mut problem, &options).unwrap());
        problem
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
}

#[test]
fn noise_gives_the_expected_chi_squared() {
    let mut drive = Drive::new(20, 150, 4);
    let mut problem = drive.disturbed(0.5, 0.02);
    for step in &mut problem.odometry {
        let (translation, rotation) = step.sigma.split_at(3);
        let [x, y, z] = [0, 1, 2].map(|axis| translation[axis] * drive.noise.normal());
        let angles = [0, 1, 2].map(|axis| rotation[axis] * drive.noise.normal());
        step.from_from_to.translation += Vector3::new(x, y, z);
        step.from_from_to.rotation *= UnitQuaternion::from_scaled_axis(Vector3::from(angles));
    }
    let options = Options {
        observation_loss: Loss::Quadratic,
        ..options()
    };
    let report = solve(&mut problem, &options).unwrap();
    let mut sights = vec![0; problem.landmarks.len()];
    for seen in &problem.observations {
        sights[seen.landmark] += 1;
    }
    // Both unknowns of the session have a prior each.
    let residuals = 2 * problem.observations.len() + 6 * problem.odometry.len() + 2;
    let unknowns = 6 * (problem.poses.len() - 1) + 2;
    let points: usize = sights.iter().map(|count| (2 * count).min(3)).sum();
    let freedom = (residuals - unknowns - points) as f64;
    let chi2 = 2.0 * report.summary.final_cost;
    assert!(
        (chi2 - freedom).abs() < 4.0 * (2.0 * freedom).sqrt(),
        "{chi2} {freedom}"
    );
}

#[test]
fn outliers_lose_their_weight() {
    let mut drive = Drive::new(30, 200, 5);
    let mut problem = drive.disturbed(0.3, 0.05);
    let mut false_ones = vec![false; problem.observations.len()];
    for (seen, is_false) in problem.observations.iter_mut().zip(&mut false_ones) {
        if drive.noise.unit() < 0.1 {
            let (far, angle) = (20.0 + 60.0 * drive.noise.unit(), 6.3 * drive.noise.unit());
            seen.pixel = [
                seen.pixel[0] + far * angle.cos(),
                seen.pixel[1] + far * angle.sin(),
            ];
            *is_false = true;
        }
    }
    let options = Options {
        observation_loss: Loss::Cauchy(2.0),
        ..options()
    };
    let report = solve(&mut problem, &options).unwrap();
    assert!(
        drive.error_m(&problem) < 0.02,
        "{}",
        drive.error_m(&problem)
    );
    let weights = report.observations.iter().zip(&false_ones);
    let heavy = weights
        .clone()
        .filter(|(o, is_false)| **is_false && o.weight > 0.1)
        .count();
    let light = weights
        .filter(|(o, is_false)| !**is_false && o.weight < 0.5)
        .count();
    let share = |count: usize| count as f64 / false_ones.len() as f64;
    assert!(
        share(heavy) < 0.005 && share(light) < 0.02,
        "{heavy} {light}"
    );
}

#[test]
fn dark_cameras_and_blind_keyframes_are_bridged() {
    let mut drive = Drive::new(30, 200, 6);
    let mut problem = drive.disturbed(0.3, 0.05);
    let blind = |seen: &Observation| seen.camera == 1 || (10..13).contains(&seen.pose);
    problem.observations.retain(|seen| !blind(seen));
    let report = solve(&mut problem, &Options::default()).unwrap();
    assert!(report.summary.converged(), "{:?}", report.summary);
    assert!(
        drive.error_m(&problem) < 0.03,
        "{}",
        drive.error_m(&problem)
    );
}

#[test]
fn landmarks_that_nothing_fixes_do_no_harm() {
    let mut drive = Drive::new(20, 120, 7);
    let mut problem = drive.disturbed(0.0, 0.02);
    let seen = problem.observations[0];
    let pose = problem.poses[seen.pose].map_from_vehicle;
    let camera = problem.rigs[0].cameras[seen.camera].vehicle_from_camera;
    let first = problem.landmarks.len();
    let behind = pose
        .compose(&camera)
        .transform(&Vector3::new(0.0, 0.0, -3.0));
    // Never seen, seen once, in the middle of its camera, behind it.
    problem
        .landmarks
        .extend([Vector3::zeros(), Vector3::new(3.0, 9.0, 1.0)]);
    problem
        .landmarks
        .extend([pose.compose(&camera).translation, behind]);
    for landmark in first + 1..first + 4 {
        problem.observations.push(Observation { landmark, ..seen });
    }
    let report = solve(&mut problem, &options()).unwrap();
    assert!(drive.error_m(&problem) < 1e-3, "{:?}", report.summary);
    assert!(
        problem
            .landmarks
            .iter()
            .all(|p| p.iter().all(|x| x.is_finite()))
    );
    assert_eq!(problem.landmarks[first], Vector3::zeros());
    assert_eq!(report.observations.last().unwrap().error_px, None);
}

#[test]
fn faults_are_named_and_change_nothing() {
    let mut drive = Drive::new(6, 20, 9);
    let good = drive.disturbed(0.0, 0.01);
    let fault = |change: fn(&mut Problem)| {
        let mut problem = good.clone();
        change(&mut problem);
        let before = problem.clone();
        let message = solve(&mut problem, &Options::default())
            .unwrap_err()
            .to_string();
        let same = problem == before || message.contains("finite");
        assert!(same);
        message
    };
    assert!(fault(|p| p.observations[3].landmark = 99).contains("observation 3"));
    assert!(fault(|p| p.observations[3].camera = 4).contains("camera below 4, found 4"));
    assert!(fault(|p| p.observations[0].sigma_px = 0.0).contains("above 0"));
    assert!(fault(|p| p.landmarks[1].x = f64::NAN).contains("landmark 1"));
    assert!(fault(|p| p.odometry[1].to = 77).contains("odometry 1"));
    assert!(fault(|p| p.poses[2].session = 5).contains("pose 2"));
    assert!(solve(&mut Problem::default(), &Options::default()).is_ok());
}
