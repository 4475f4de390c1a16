//! Against numeric derivatives, near the identity, near half a turn and in between.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::f64::consts::PI;

use nalgebra::{Isometry3, Matrix6, SMatrix, SVector, Vector3, Vector6};
use proptest::prelude::*;

use super::{se3, so3};
use crate::geometry::pose::Pose;

/// Central differences of `f` at 0.
fn numeric<const R: usize, const C: usize>(
    step: f64,
    f: impl Fn(SVector<f64, C>) -> SVector<f64, R>,
) -> SMatrix<f64, R, C> {
    let mut jacobian = SMatrix::<f64, R, C>::zeros();
    for column in 0..C {
        let mut delta = SVector::<f64, C>::zeros();
        delta[column] = step;
        let difference = (f(delta) - f(-delta)) / (2.0 * step);
        jacobian.set_column(column, &difference);
    }
    jacobian
}

/// Rotation vectors of any size up to half a turn, many of them tiny or nearly half a turn.
fn rotations() -> impl Strategy<Value = Vector3<f64>> {
    let direction = prop::array::uniform3(-1.0..1.0f64)
        .prop_filter("direction", |v| Vector3::from(*v).norm() > 0.1)
        .prop_map(|v| Vector3::from(v).normalize());
    let angle = prop_oneof![
        Just(0.0),
        (-16.0..-1.0f64).prop_map(|e| 10f64.powf(e)),
        0.1..3.1f64,
        (0.48..0.52f64),
        (-12.0..-3.0f64).prop_map(|e| PI - 10f64.powf(e)),
    ];
    (direction, angle).prop_map(|(direction, angle)| direction * angle)
}

fn twists() -> impl Strategy<Value = Vector6<f64>> {
    (prop::array::uniform3(-5.0..5.0f64), rotations())
        .prop_map(|(rho, phi)| se3::join(&Vector3::from(rho), &phi))
}

fn poses() -> impl Strategy<Value = Pose> {
    twists().prop_map(|xi| se3::exp(&xi))
}

proptest! {
    #[test]
    fn rotations_go_there_and_back(phi in rotations()) {
        let back = so3::log(&so3::exp(&phi));
        // At half a turn the opposite vector is as short.
        let error = (back - phi).norm().min((back + phi).norm() + (PI - phi.norm()).max(0.0));
        prop_assert!(error < 1e-12 + 1e-14 * phi.norm(), "{phi} {back}");
    }

    #[test]
    fn rotation_vectors_agree_with_matrix_exponentials(phi in rotations()) {
        let ours = so3::exp(&phi).to_rotation_matrix().into_inner();
        prop_assert!((ours - so3::hat(&phi).exp()).norm() < 1e-12);
    }

    #[test]
    fn rotation_jacobians_are_derivatives(phi in rotations()) {
        let at = so3::exp(&phi);
        let left = numeric(1e-6, |d| so3::log(&(so3::exp(&(phi + d)) * at.inverse())));
        prop_assert!((left - so3::left_jacobian(&phi)).norm() < 1e-8);
        let right = numeric(1e-6, |d| so3::log(&(at.inverse() * so3::exp(&(phi + d)))));
        prop_assert!((right - so3::left_jacobian(&-phi)).norm() < 1e-8);
    }

    #[test]
    fn inverse_jacobians_are_inverses(xi in twists()) {
        let (_, phi) = se3::split(&xi);
        let small = so3::left_jacobian(&phi) * so3::left_jacobian_inverse(&phi);
        prop_assert!((small - nalgebra::Matrix3::identity()).norm() < 1e-12);
        let large = se3::left_jacobian(&-xi) * se3::right_jacobian_inverse(&xi);
        prop_assert!((large - Matrix6::identity()).norm() < 1e-11);
    }

    #[test]
    fn motions_go_there_and_back(xi in twists()) {
        let motion = se3::exp(&xi);
        let again = se3::exp(&se3::log(&motion));
        prop_assert!((again.translation - motion.translation).norm() < 1e-11);
        prop_assert!(again.rotation.angle_to(&motion.rotation) < 1e-7);
    }

    #[test]
    fn motions_agree_with_matrix_exponentials(xi in twists()) {
        let (rho, phi) = se3::split(&xi);
        let mut twist = nalgebra::Matrix4::zeros();
        twist.fixed_view_mut::<3, 3>(0, 0).copy_from(&so3::hat(&phi));
        twist.fixed_view_mut::<3, 1>(0, 3).copy_from(&rho);
        let motion = se3::exp(&xi);
        let ours = Isometry3::from_parts(motion.translation.into(), motion.rotation);
        let ours = ours.to_homogeneous();
        prop_assert!((ours - twist.exp()).norm() < 1e-11);
    }

    #[test]
    fn motion_jacobians_are_derivatives(xi in twists()) {
        let at = se3::exp(&xi);
        let left = numeric(1e-6, |d| se3::log(&se3::exp(&(xi + d)).compose(&at.inverse())));
        prop_assert!((left - se3::left_jacobian(&xi)).norm() < 1e-7);
        let right = numeric(1e-6, |d| se3::log(&at.inverse().compose(&se3::exp(&(xi + d)))));
        prop_assert!((right - se3::left_jacobian(&-xi)).norm() < 1e-7);
    }

    #[test]
    fn adjoints_carry_twists_across(pose in poses(), xi in twists()) {
        let small = xi * 1e-3;
        let right = pose.compose(&se3::exp(&small));
        let left = se3::exp(&(se3::adjoint(&pose) * small)).compose(&pose);
        prop_assert!((right.translation - left.translation).norm() < 1e-11);
        prop_assert!(right.rotation.angle_to(&left.rotation) < 1e-7);
    }

    #[test]
    fn minus_undoes_plus(pose in poses(), xi in twists()) {
        let xi = xi * 0.3;
        prop_assert!((se3::minus(&se3::plus(&pose, &xi), &pose) - xi).norm() < 1e-11);
    }

    #[test]
    fn covariances_turn_to_the_other_frame(pose in poses()) {
        // Moving the position along what is the pose's own x, and turning it about what is its own y.
        let (x, y) = (pose.rotate(&Vector3::x()), pose.rotate(&Vector3::y()));
        let mut along_left = Matrix6::zeros();
        along_left.fixed_view_mut::<3, 3>(0, 0).copy_from(&(x * x.transpose() * 4.0));
        along_left.fixed_view_mut::<3, 3>(3, 3).copy_from(&(y * y.transpose() * 9.0));
        let mut covariance = Matrix6::zeros();
        covariance[(0, 0)] = 4.0;
        covariance[(4, 4)] = 9.0;
        let back = se3::covariance_along_right(&pose, &along_left);
        prop_assert!((back - covariance).norm() < 1e-11);
    }
}

#[test]
fn a_landmark_moves_as_the_convention_says() {
    let pose = se3::exp(&Vector6::new(1.0, -2.0, 3.0, 0.4, -0.5, 0.6));
    let p = Vector3::new(4.0, 5.0, 6.0);
    let p_b = pose.inverse().transform(&p);
    let derivative = numeric(1e-6, |xi: Vector6<f64>| {
        se3::plus(&pose, &xi).inverse().transform(&p)
    });
    let mut expected = SMatrix::<f64, 3, 6>::zeros();
    expected
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&-nalgebra::Matrix3::identity());
    expected
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&so3::hat(&p_b));
    assert!((derivative - expected).norm() < 1e-8);
}
