//! The pose that the inliers agree on best, and how well they fix it.

use nalgebra::{Matrix6, UnitQuaternion, Vector6};

use super::sight::{RigidMatrix, Sight};
use crate::geometry::pose::Pose;

/// Cauchy's loss with 95 % efficiency on normal errors (Holland, Welsch 1977).
const CAUCHY: f64 = 2.385;

/// Damping at the start; it only matters where a direction is hardly fixed.
const DAMPING: f64 = 1e-4;

/// Steps of one adjustment; more than ten are rare.
const MAX_STEPS: usize = 20;

/// A step shorter than this (metres and radians) is none.
const SMALLEST_STEP: f64 = 1e-9;

/// A pose with its normal equations.
pub(super) struct Adjusted {
    pub(super) world_from_vehicle: Pose,
    pub(super) information: Matrix6<f64>,
    /// Weighted sum of squares by degrees of freedom.
    pub(super) variance_factor: f64,
}

struct Normal {
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
    cost: f64,
    weighted: f64,
    weights: f64,
}

/// Levenberg–Marquardt on the sights given; a sight that no longer sees its point counts like one just at the gate.
/// None where they do not fix all six.
pub(super) fn adjust(sights: &[&Sight], start: &Pose, gate: f64) -> Option<Adjusted> {
    let mut pose = *start;
    let mut normal = normal(sights, &pose, gate);
    let mut damping = DAMPING;
    for _ in 0..MAX_STEPS {
        let mut damped = normal.information;
        for i in 0..6 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = -damped.cholesky()?.solve(&normal.gradient);
        let next = moved(&pose, &step);
        let at_next = self::normal(sights, &next, gate);
        if at_next.cost <= normal.cost {
            (pose, normal) = (next, at_next);
            damping *= 0.1;
            if step.norm() < SMALLEST_STEP.max(1e-7 * pose.translation.norm()) {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    let freedom = (2.0 * normal.weights - 6.0).max(1.0);
    Some(Adjusted {
        world_from_vehicle: pose,
        information: normal.information,
        variance_factor: normal.weighted / freedom,
    })
}

/// A pose moved by a translation along the world's axes and a rotation about them.
pub(crate) fn moved(pose: &Pose, step: &Vector6<f64>) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
    let rotation = UnitQuaternion::new_normalize((turn * pose.rotation).into_inner());
    Pose::new(pose.translation + step.fixed_rows::<3>(0), rotation)
}

fn normal(sights: &[&Sight], pose: &Pose, gate: f64) -> Normal {
    let frame = RigidMatrix::from(&pose.inverse());
    let mut sum = Normal {
        information: Matrix6::zeros(),
        gradient: Vector6::zeros(),
        cost: 0.0,
        weighted: 0.0,
        weights: 0.0,
    };
    let scale = CAUCHY * CAUCHY;
    for sight in sights {
        let Some(miss) = sight.miss(&frame, gate) else {
            sum.cost += scale * (gate / scale).ln_1p();
            continue;
        };
        let squared = miss.squared();
        let weight = 1.0 / (1.0 + squared / scale);
        let slopes = sight.slopes(&miss, &frame, pose);
        let pulled = slopes.transpose() * miss.information * weight;
        sum.information += pulled * slopes;
        sum.gradient += pulled * miss.error;
        sum.cost += scale * (squared / scale).ln_1p();
        sum.weighted += weight * squared;
        sum.weights += weight;
    }
    sum
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::super::Correspondence;
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn slopes_are_those_of_the_error(
            at in prop::array::uniform3(-3.0..3.0f64), turn in prop::array::uniform3(-2.0..2.0f64),
            point in prop::array::uniform3(-9.0..9.0f64), beside in prop::array::uniform3(-0.2..0.2f64),
        ) {
            let pose = Pose::new(at.into(), UnitQuaternion::from_scaled_axis(turn.into()));
            let mount = Pose::from_yaw(1.0, 0.5, 0.3);
            let point = Vector3::from(point);
            let seen = pose.compose(&mount).inverse().transform(&point);
            prop_assume!(seen.norm() > 0.5);
            let given = Correspondence {
                camera: 0,
                bearing: (seen.normalize() + Vector3::from(beside)).normalize(),
                sigma_rad: 0.01,
                point,
                point_covariance: Matrix3::zeros(),
                quality: 1.0,
            };
            let sight = Sight::new(&[mount], 0, &given).unwrap();
            let error = |pose: &Pose| {
                sight.miss(&RigidMatrix::from(&pose.inverse()), f64::INFINITY).unwrap()
            };
            let slopes = sight.slopes(&error(&pose), &RigidMatrix::from(&pose.inverse()), &pose);
            for i in 0..6 {
                let step = Vector6::ith(i, 1e-6);
                let ahead = error(&moved(&pose, &step)).error;
                let behind = error(&moved(&pose, &-step)).error;
                let numeric = (ahead - behind) / 2e-6;
                prop_assert!((numeric - slopes.column(i)).norm() < 1e-5 * (1.0 + slopes.norm()));
            }
        }
    }
}
