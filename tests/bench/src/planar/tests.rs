//! Jacobians against numeric ones, false loops, and the plane lifted into space.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::f64::consts::PI;

use evermap_algorithms::geometry::lie::se3;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::pose_graph::robust::relax_robustly;
use evermap_algorithms::metric_map::pose_graph::{Edge, SpatialGraph, options, relax};
use evermap_algorithms::solving::least_squares::Loss;
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};
use proptest::prelude::*;

use super::*;

#[path = "../../../../operators/algorithms/src/metric_map/pose_graph/tests/rounds.rs"]
mod rounds;

use rounds::{Noise, honest, is_found_as_well_as_by_who_knows, jacobians_are_derivatives, rounds};

/// `rᵀ Ω r` that a true measurement of three degrees of freedom exceeds once in a thousand.
const CUTOFF: f64 = 16.27;

fn planar() -> impl Strategy<Value = PlanarPose> {
    prop::array::uniform3(-3.0..3.0f64).prop_map(|[x, y, yaw]| PlanarPose::new(x, y, yaw))
}

fn flat_block(turns: f64) -> PlanarPose {
    let angle = turns * std::f64::consts::TAU;
    PlanarPose::new(10.0 * angle.cos(), 10.0 * angle.sin(), angle)
}

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

proptest! {
    #[test]
    fn planar_jacobians(measured in planar(), from in planar(), to in planar()) {
        jacobians_are_derivatives(measured, from, to);
    }

    #[test]
    fn planar_motions_keep_their_promises(
        a in prop::array::uniform3(-9.0..9.0f64), b in prop::array::uniform3(-3.0..3.0f64)
    ) {
        let a = PlanarPose::new(a[0], a[1], a[2]);
        let xi = Vector3::from(b);
        prop_assert!((a.plus(&xi).minus(&a) - xi).norm() < 1e-12);
        let motion = PlanarPose::new(b[0], b[1], b[2]);
        let derivative = numeric(1e-6, |d: Vector3<f64>| {
            motion.inverse().compose(&exp(&d)).compose(&motion).minus(&PlanarPose::identity())
        });
        prop_assert!((derivative - inverse_adjoint(&motion)).norm() < 1e-8);
        let right = numeric(1e-6, |d: Vector3<f64>| exp(&xi).plus(&d).minus(&PlanarPose::identity()));
        prop_assert!((right - right_jacobian_inverse(&xi)).norm() < 1e-7);
        let lifted = se3::exp(&Vector6::new(xi.x, xi.y, 0.0, 0.0, 0.0, xi.z));
        let flat = exp(&xi);
        prop_assert!((lifted.translation.xy() - flat.translation).norm() < 1e-12);
        prop_assert!((lifted.yaw() - flat.yaw).abs() < 1e-12);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_fifth_of_false_loops_is_found_on_the_plane(seed in any::<u64>()) {
        let (mut graph, truth, is_false) = rounds(flat_block, 0.2, seed);
        let honest = honest(&graph, &is_false);
        let doubted: Vec<bool> = (0..graph.edges.len()).map(|edge| edge >= truth.len() - 1).collect();
        let weights = relax_robustly(&mut graph, &doubted, CUTOFF, &options()).unwrap().weights;
        is_found_as_well_as_by_who_knows(&graph, &weights, &is_false, &honest, CUTOFF);
    }

    #[test]
    fn relaxed_costs_are_minima(seed in any::<u64>()) {
        let (mut graph, _, _) = rounds(flat_block, 0.0, seed);
        let summary = relax(&mut graph, &options()).unwrap();
        prop_assert!(summary.converged());
        prop_assert!((graph.cost() - summary.final_cost).abs() < 1e-9 * summary.final_cost);
        let mut noise = Noise(seed);
        let best = graph.cost();
        for pose in &mut graph.poses[1..] {
            *pose = pose.plus(&noise.twist(1e-3));
        }
        prop_assert!(graph.cost() > best);
    }
}

/// The plane is space without height, roll and pitch: costs and minima are the same.
#[test]
fn the_plane_lifted_into_space_costs_the_same() {
    let (mut flat, _, _) = rounds(flat_block, 0.0, 3);
    let space =
        |pose: &PlanarPose| Pose::from_yaw(pose.translation.x, pose.translation.y, pose.yaw);
    const PLACE: [usize; 3] = [0, 1, 5];
    let edges = flat.edges.iter().map(|edge| Edge {
        from: edge.from,
        to: edge.to,
        measured: space(&edge.measured),
        information: Matrix6::from_fn(|row, column| {
            let place = |at| PLACE.iter().position(|found| *found == at);
            match (place(row), place(column)) {
                (Some(row), Some(column)) => edge.information[(row, column)],
                _ => f64::from(u8::from(row == column)),
            }
        }),
        loss: edge.loss,
    });
    let mut lifted = SpatialGraph {
        edges: edges.collect(),
        poses: flat.poses.iter().map(space).collect(),
        fixed: flat.fixed.clone(),
    };
    assert!((flat.cost() - lifted.cost()).abs() < 1e-9 * flat.cost());
    relax(&mut flat, &options()).unwrap();
    relax(&mut lifted, &options()).unwrap();
    assert!((flat.cost() - lifted.cost()).abs() < 1e-6 * flat.cost());
    for (a, b) in flat.poses.iter().zip(&lifted.poses) {
        assert!(se3::minus(&space(a), b).norm() < 1e-4);
    }
}

#[test]
fn angles_wrap_into_one_turn() {
    for (angle, wrapped) in [(0.0, 0.0), (PI, PI), (-PI, PI), (7.0, 7.0 - 2.0 * PI)] {
        assert!((wrap(angle) - wrapped).abs() < 1e-12);
    }
    assert!(wrap(f64::NAN).is_nan());
    assert!(wrap(1e300).abs() <= PI);
}
