//! The camera's motion between two views, refined by what was matched.
//!
//! A match says that both rays and the way between the cameras lie in one plane: `r_b · (t̂ × R r_a) = 0`
//! (Longuet-Higgins, *A computer algorithm for reconstructing a scene from two projections*, 1981).
//! Multiplied out, that is the sine of the distance from the epipolar plane, times the sine of the angle between ray
//! and way, so that rays along the way, which know nothing, count nothing. Odometry is the prior; scale is its alone.

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

use super::{Ready, TrackParams};
use crate::geometry::pose::Pose;
use crate::metric_map::matching::Match;

/// Fewer matches than this refine nothing.
const FEWEST: usize = 12;

/// What remains of the rotation's uncertainty once it was refined: share.
pub(super) const LEFT_OVER: f64 = 0.25;

const ROUNDS: usize = 6;

/// A way shorter than this (m) has no direction to speak of.
const SHORTEST_M: f64 = 0.01;

/// `b_from_a` made to agree with the matches; `None` where they are too few, or the camera stood.
pub(super) fn refine(
    a: &Ready<'_>,
    b: &Ready<'_>,
    matches: &[Match],
    odometry: &Pose,
    params: &TrackParams,
) -> Option<Pose> {
    let way_m = odometry.translation.norm();
    let pairs: Vec<(Vector3<f64>, Vector3<f64>, f64)> = matches
        .iter()
        .filter_map(|found| {
            let ((from, sigma_a), (to, sigma_b)) = (a.ray(found.query)?, b.ray(found.found)?);
            Some((from, to, sigma_a.hypot(sigma_b)))
        })
        .collect();
    if pairs.len() < FEWEST || way_m < SHORTEST_M {
        return None;
    }
    let way_sigma_m = (params.way_sigma * way_m).max(0.005);
    let mut refined = *odometry;
    for _ in 0..ROUNDS {
        let (mut information, mut gradient) =
            prior(odometry, &refined, params.turn_sigma_rad, way_sigma_m);
        for (from, to, sigma) in &pairs {
            let (error, jacobian) = coplanarity(&refined, from, to);
            let scaled = error / sigma;
            // Cauchy's loss at two standard deviations.
            let weight = 1.0 / (1.0 + (0.5 * scaled).powi(2)) / (sigma * sigma);
            information += jacobian * jacobian.transpose() * weight;
            gradient += jacobian * (error * weight);
        }
        let step = -information.cholesky()?.solve(&gradient);
        refined = moved(&refined, &step);
    }
    refined
        .translation
        .iter()
        .all(|at| at.is_finite())
        .then_some(refined)
}

/// Turned by the first three numbers (rad), shifted by the others (m).
fn moved(pose: &Pose, step: &Vector6<f64>) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    Pose::new(
        pose.translation + Vector3::new(step[3], step[4], step[5]),
        turn * pose.rotation,
    )
}

/// Information and gradient of "odometry is right".
fn prior(
    odometry: &Pose,
    refined: &Pose,
    turn_sigma_rad: f64,
    way_sigma_m: f64,
) -> (Matrix6<f64>, Vector6<f64>) {
    let turned = (refined.rotation * odometry.rotation.inverse()).scaled_axis();
    let shifted = refined.translation - odometry.translation;
    let (turn, way) = (turn_sigma_rad.powi(-2), way_sigma_m.powi(-2));
    let information = Matrix6::from_diagonal(&Vector6::new(turn, turn, turn, way, way, way));
    let off = Vector6::new(
        turned.x, turned.y, turned.z, shifted.x, shifted.y, shifted.z,
    );
    (information, information * off)
}

/// `r_b · (t̂ × R r_a)`, and its derivative by [`moved`]'s step.
fn coplanarity(b_from_a: &Pose, from: &Vector3<f64>, to: &Vector3<f64>) -> (f64, Vector6<f64>) {
    let turned = b_from_a.rotation * from;
    let way_m = b_from_a.translation.norm().max(1e-9);
    let way = b_from_a.translation / way_m;
    let error = to.dot(&way.cross(&turned));
    let by_turn = turned.cross(&to.cross(&way));
    let by_way = turned.cross(to);
    let by_shift = (by_way - way * way.dot(&by_way)) / way_m;
    let jacobian = Vector6::new(
        by_turn.x, by_turn.y, by_turn.z, by_shift.x, by_shift.y, by_shift.z,
    );
    (error, jacobian)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unit() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-1.0..1.0_f64)
            .prop_filter("has a direction", |v| Vector3::from(*v).norm() > 0.1)
            .prop_map(|v| Vector3::from(v).normalize())
    }

    proptest! {
        #[test]
        fn derivatives_are_the_numeric_ones(
            from in unit(), to in unit(), way in unit(), turn in unit(), length in 0.1..2.0_f64
        ) {
            let pose = Pose::new(way * length, UnitQuaternion::from_scaled_axis(turn));
            let (_, jacobian) = coplanarity(&pose, &from, &to);
            for axis in 0..6 {
                let mut step = Vector6::zeros();
                step[axis] = 1e-6;
                let ahead = coplanarity(&moved(&pose, &step), &from, &to).0;
                let behind = coplanarity(&moved(&pose, &-step), &from, &to).0;
                prop_assert!(((ahead - behind) / 2e-6 - jacobian[axis]).abs() < 1e-6);
            }
        }
    }
}
