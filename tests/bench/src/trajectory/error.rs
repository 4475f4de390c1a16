//! How far a trajectory is from the truth.
//!
//! Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, section VI
//! (absolute and relative error); Geiger et al., "Are we ready for autonomous driving? The KITTI
//! vision benchmark suite", CVPR 2012 (relative error over distances instead of times).

use super::PosePair;
use evermap_algorithms::geometry::pose::Pose;

/// Numbers that sum up errors, in the errors' own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistics {
    /// How many errors.
    pub count: usize,
    /// Root mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 99 % of the errors are no larger (nearest rank).
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

impl Statistics {
    /// Of these errors; `None` where there are none or one is not a number.
    pub fn of(mut errors: Vec<f64>) -> Option<Self> {
        if errors.is_empty() || errors.iter().any(|error| error.is_nan()) {
            return None;
        }
        errors.sort_by(f64::total_cmp);
        let n = errors.len();
        let rank = |share: f64| errors[((share * n as f64).ceil() as usize).clamp(1, n) - 1];
        Some(Self {
            count: n,
            rmse: (errors.iter().map(|error| error * error).sum::<f64>() / n as f64).sqrt(),
            mean: errors.iter().sum::<f64>() / n as f64,
            median: 0.5 * (errors[(n - 1) / 2] + errors[n / 2]),
            p99: rank(0.99),
            max: errors[n - 1],
        })
    }
}

/// Absolute trajectory error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AbsoluteError {
    /// Distances between positions, metres.
    pub position_m: Statistics,
    /// Angles between orientations, radians.
    pub rotation_rad: Statistics,
}

/// The absolute error after `truth_from_estimate` (of [`align`](super::align), or the identity
/// where both are in one frame). `None` without pairs or where a number is not finite.
pub fn absolute_error(pairs: &[PosePair], truth_from_estimate: &Pose) -> Option<AbsoluteError> {
    let errors = pairs.iter().map(|pair| {
        let there = truth_from_estimate.compose(&pair.estimate);
        let apart = (there.translation - pair.truth.translation).norm();
        (apart, there.rotation.angle_to(&pair.truth.rotation))
    });
    let (position, rotation) = errors.unzip();
    Some(AbsoluteError {
        position_m: Statistics::of(position)?,
        rotation_rad: Statistics::of(rotation)?,
    })
}

/// Relative pose error: drift per distance driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelativeError {
    /// Error of the moved distance and direction, per metre driven (1 is 100 %).
    pub translation: Statistics,
    /// Error of the turned angle, radians per metre driven.
    pub rotation_rad_per_m: Statistics,
}

/// The relative error over pieces of the true path that are `distance_m` long, one from each pose
/// on. Pairs must be ordered by stamp and of one drive. `None` where the path is shorter than
/// that, `distance_m` is not positive, or a number is not finite.
pub fn relative_error(pairs: &[PosePair], distance_m: f64) -> Option<RelativeError> {
    if distance_m.is_nan() || distance_m <= 0.0 {
        return None;
    }
    let driven = driven(pairs);
    let mut end = 0;
    let (mut translation, mut rotation) = (Vec::new(), Vec::new());
    for (start, first) in pairs.iter().enumerate() {
        while end < pairs.len() && driven[end] - driven[start] < distance_m {
            end += 1;
        }
        let Some(last) = pairs.get(end) else { break };
        let moved = first.estimate.inverse().compose(&last.estimate);
        let truly = first.truth.inverse().compose(&last.truth);
        let error = truly.inverse().compose(&moved);
        let length = driven[end] - driven[start];
        translation.push(error.translation.norm() / length);
        rotation.push(error.rotation.angle() / length);
    }
    Some(RelativeError {
        translation: Statistics::of(translation)?,
        rotation_rad_per_m: Statistics::of(rotation)?,
    })
}

/// Length of the true path up to each pair, metres.
fn driven(pairs: &[PosePair]) -> Vec<f64> {
    let mut driven = vec![0.0; pairs.len()];
    for k in 1..pairs.len() {
        let step = pairs[k].truth.translation - pairs[k - 1].truth.translation;
        driven[k] = driven[k - 1] + step.norm();
    }
    driven
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::trajectory::align;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    fn pairs(estimates: impl Iterator<Item = (Pose, Pose)>) -> Vec<PosePair> {
        let pair = |(k, (estimate, truth))| PosePair {
            stamp_ns: k as i64,
            estimate,
            truth,
        };
        estimates.enumerate().map(pair).collect()
    }

    /// A drive in a circle of 10 m radius, a metre between poses, and its like that is `scale`
    /// times as large.
    fn circle(count: usize, scale: f64) -> Vec<PosePair> {
        pairs((0..count).map(|k| {
            let angle = k as f64 * 0.1;
            let place = |r: f64| Pose::from_yaw(r * angle.sin(), r * (1.0 - angle.cos()), angle);
            (place(10.0 * scale), place(10.0))
        }))
    }

    proptest! {
        #[test]
        fn statistics_are_those_of_sorting(errors in prop::collection::vec(0.0..10.0f64, 1..300)) {
            let found = Statistics::of(errors.clone()).unwrap();
            let above = |limit: f64| errors.iter().filter(|e| **e > limit).count() as f64;
            let n = errors.len() as f64;
            prop_assert!(above(found.p99) <= 0.01 * n && above(found.median) <= 0.5 * n);
            prop_assert!(above(found.median - 1e-12) >= 0.5 * n);
            prop_assert!(above(found.p99 - 1e-12) >= 0.01 * n);
            prop_assert!(above(found.max) == 0.0 && errors.contains(&found.max));
            prop_assert!(found.mean <= found.rmse + 1e-12 && found.rmse <= found.max + 1e-12);
        }

        #[test]
        fn where_a_map_lies_makes_no_error(
            t in prop::array::uniform3(-50.0..50.0f64), r in prop::array::uniform3(-3.0..3.0f64)
        ) {
            let moved = Pose::new(Vector3::from(t), UnitQuaternion::from_scaled_axis(Vector3::from(r)));
            let pairs = pairs(circle(60, 1.0).iter().map(|pair| (moved.compose(&pair.estimate), pair.truth)));
            let error = absolute_error(&pairs, &align(&pairs).unwrap()).unwrap();
            prop_assert!(error.position_m.max < 1e-9 && error.rotation_rad.max < 1e-6);
            let drift = relative_error(&pairs, 5.0).unwrap();
            prop_assert!(drift.translation.max < 1e-9 && drift.rotation_rad_per_m.max < 1e-6);
        }
    }

    #[test]
    fn a_wrong_scale_is_a_relative_error_of_that_size() {
        let drift = relative_error(&circle(60, 1.02), 5.0).unwrap();
        assert!((drift.translation.median - 0.02).abs() < 1e-3, "{drift:?}");
        assert!(drift.rotation_rad_per_m.max < 1e-9);
        // A piece that begins at each pose and still ends on the circle.
        assert_eq!(drift.translation.count, 54);
    }

    #[test]
    fn one_pose_aside_is_the_largest_error() {
        let mut pairs = circle(100, 1.0);
        pairs[40].estimate.translation.z += 3.0;
        let error = absolute_error(&pairs, &Pose::identity()).unwrap();
        assert!((error.position_m.max - 3.0).abs() < 1e-12);
        assert!((error.position_m.rmse - 0.3).abs() < 1e-12);
        assert_eq!((error.position_m.median, error.position_m.p99), (0.0, 0.0));
    }

    #[test]
    fn nothing_to_compare_is_no_error_at_all() {
        assert!(absolute_error(&[], &Pose::identity()).is_none());
        assert!(relative_error(&circle(5, 1.0), 100.0).is_none());
        assert!(relative_error(&circle(5, 1.0), 0.0).is_none());
        assert!(relative_error(&circle(5, 1.0), f64::NAN).is_none());
        assert!(Statistics::of(vec![1.0, f64::NAN]).is_none());
    }
}
