//! Derivatives of the factors against numeric ones.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::Vector6;

use super::super::schur::Bundle;
use super::super::*;
use super::Drive;
use crate::geometry::lie::se3;

/// The derivative of a cost along every direction of a pose and of the session.
#[test]
fn jacobians_are_derivatives() {
    let mut drive = Drive::new(5, 30, 10);
    let problem = drive.disturbed(3.0, 0.1);
    let options = Options::default();
    let (mut bundle, _) = decomposition::schur(&problem, &options)
        .unwrap()
        .into_estimate();
    let blocks = 4 + 1;
    for (index, seen) in problem.observations.iter().enumerate().step_by(7) {
        let landmark: [f64; 3] = problem.landmarks[seen.landmark].into();
        let (_, linear) = bundle.linearise(index, &landmark);
        let slope = |rows: [f64; 2]| linear.residual[0] * rows[0] + linear.residual[1] * rows[1];
        for axis in (0..6).filter(|_| seen.pose > 0) {
            let mut cost = |h: f64| {
                let mut steps = vec![[0.0; 6]; blocks];
                steps[seen.pose - 1][axis] = h;
                bundle.step(&steps);
                bundle.trial_cost(index, &landmark)
            };
            let numeric = (cost(1e-6) - cost(-1e-6)) / 2e-6;
            let exact = slope([0, 1].map(|row| linear.camera[row][axis]));
            assert!(
                (numeric - exact).abs() < 1e-4 * (1.0 + exact.abs()),
                "{numeric} {exact}"
            );
        }
        bundle.step(&vec![[0.0; 6]; blocks]);
        for axis in 0..3 {
            let cost = |h: f64| {
                let mut moved = landmark;
                moved[axis] += h;
                bundle.trial_cost(index, &moved)
            };
            let numeric = (cost(1e-6) - cost(-1e-6)) / 2e-6;
            let exact = slope([0, 1].map(|row| linear.landmark[row][axis]));
            assert!(
                (numeric - exact).abs() < 1e-4 * (1.0 + exact.abs()),
                "{numeric} {exact}"
            );
        }
    }
}

#[test]
fn odometry_jacobians_are_derivatives() {
    let mut drive = Drive::new(3, 0, 11);
    let problem = drive.disturbed(0.0, 1.0);
    let step = &problem.odometry[0];
    let poses = [0, 1].map(|at| problem.poses[at].map_from_vehicle);
    let session = SessionState {
        rig: 0,
        odometry_scale: 1.1,
        odometry_yaw_rad_per_m: 0.02,
    };
    let linear = odometry::linearise(step, &poses[0], &poses[1], &session);
    for axis in 0..6 {
        let moved = |pose: &Pose, h: f64| {
            se3::plus(
                pose,
                &Vector6::from_fn(|row, _| if row == axis { h } else { 0.0 }),
            )
        };
        let slope = |f: &dyn Fn(f64) -> Vector6<f64>| (f(1e-6) - f(-1e-6)) / 2e-6;
        let residual = odometry::residual;
        let from = slope(&|h| residual(step, &moved(&poses[0], h), &poses[1], &session));
        let to = slope(&|h| residual(step, &poses[0], &moved(&poses[1], h), &session));
        assert!((from - linear.from.column(axis)).norm() < 1e-4);
        assert!((to - linear.to.column(axis)).norm() < 1e-4);
        let by_session = slope(&|h| {
            let mut session = session;
            match axis {
                0 => session.odometry_scale += h,
                1 => session.odometry_yaw_rad_per_m += h,
                _ => {}
            }
            residual(step, &poses[0], &poses[1], &session)
        });
        let exact = if axis < 2 {
            linear.session.column(axis).into_owned()
        } else {
            Vector6::zeros()
        };
        assert!((by_session - exact).norm() < 1e-4);
    }
}
