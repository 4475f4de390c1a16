//! Against numeric derivatives, near the identity, near half a turn and in between.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::f64::consts::PI;

use nalgebra::{Matrix6, SMatrix, SVector, Vector3, Vector6};
use proptest::prelude::*;

use super::{se2, se3, so3};
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
        prop_assert!((right - so3::right_jacobian(&phi)).norm() < 1e-8);
    }

    #[test]
    fn inverse_jacobians_are_inverses(xi in twists()) {
        let (_, phi) = se3::split(&xi);
        let small = so3::left_jacobian(&phi) * so3::left_jacobian_inverse(&phi);
        prop_assert!((small - nalgebra::Matrix3::identity()).norm() < 1e-12);
        let large = se3::right_jacobian(&xi) * se3::right_jacobian_inverse(&xi);
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
        let ours = se3::exp(&xi).to_isometry().to_homogeneous();
        prop_assert!((ours - twist.exp()).norm() < 1e-11);
    }

    #[test]
    fn motion_jacobians_are_derivatives(xi in twists()) {
        let at = se3::exp(&xi);
        let left = numeric(1e-6, |d| se3::log(&se3::exp(&(xi + d)).compose(&at.inverse())));
        prop_assert!((left - se3::left_jacobian(&xi)).norm() < 1e-7);
        let right = numeric(1e-6, |d| se3::log(&at.inverse().compose(&se3::exp(&(xi + d)))));
        prop_assert!((right - se3::right_jacobian(&xi)).norm() < 1e-7);
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
        // Moving the pose along its own x is moving its position along that axis as seen from the left.
        let mut covariance = Matrix6::zeros();
        covariance[(0, 0)] = 4.0;
        covariance[(4, 4)] = 9.0;
        let turned = se3::covariance_along_left(&pose, &covariance);
        let (x, y) = (pose.rotate(&Vector3::x()), pose.rotate(&Vector3::y()));
        let position = turned.fixed_view::<3, 3>(0, 0) - x * x.transpose() * 4.0;
        let rotation = turned.fixed_view::<3, 3>(3, 3) - y * y.transpose() * 9.0;
        prop_assert!(position.norm() + rotation.norm() < 1e-12);
        let back = se3::covariance_along_right(&pose, &turned);
        prop_assert!((back - covariance).norm() < 1e-11);
    }

    #[test]
    fn planar_motions_keep_their_promises(
        a in prop::array::uniform3(-9.0..9.0f64), b in prop::array::uniform3(-3.0..3.0f64)
    ) {
        let a = se2::PlanarPose::new(a[0], a[1], a[2]);
        let xi = Vector3::from(b);
        prop_assert!((a.plus(&xi).minus(&a) - xi).norm() < 1e-12);
        let motion = se2::PlanarPose::new(b[0], b[1], b[2]);
        let derivative = numeric(1e-6, |d: Vector3<f64>| {
            motion.inverse().compose(&se2::exp(&d)).compose(&motion).minus(&se2::PlanarPose::identity())
        });
        prop_assert!((derivative - se2::inverse_adjoint(&motion)).norm() < 1e-8);
        let right = numeric(1e-6, |d: Vector3<f64>| se2::exp(&xi).plus(&d).minus(&se2::PlanarPose::identity()));
        prop_assert!((right - se2::right_jacobian_inverse(&xi)).norm() < 1e-7);
        let lifted = se3::exp(&Vector6::new(xi.x, xi.y, 0.0, 0.0, 0.0, xi.z));
        let flat = se2::exp(&xi);
        prop_assert!((lifted.translation.xy() - flat.translation).norm() < 1e-12);
        prop_assert!((lifted.yaw() - flat.yaw).abs() < 1e-12);
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

#[test]
fn angles_wrap_into_one_turn() {
    for (angle, wrapped) in [(0.0, 0.0), (PI, PI), (-PI, PI), (7.0, 7.0 - 2.0 * PI)] {
        assert!((se2::wrap(angle) - wrapped).abs() < 1e-12);
    }
    assert!(se2::wrap(f64::NAN).is_nan());
    assert!(se2::wrap(1e300).abs() <= PI);
}
