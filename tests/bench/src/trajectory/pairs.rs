//! Poses of two trajectories at the same instants.

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::{StampedPose, pose_at};

/// The same instant in two trajectories.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosePair {
    /// Nanoseconds since the epoch, UTC.
    pub stamp_ns: i64,
    /// What was found.
    pub estimate: Pose,
    /// What is true.
    pub truth: Pose,
}

/// For each estimated pose the true one at its instant, between the true poses around it. Left
/// out are estimates before the first and after the last true pose, and between true poses more
/// than `max_gap_ns` apart. Both must be ordered by stamp.
pub fn associate(
    estimate: &[StampedPose],
    truth: &[StampedPose],
    max_gap_ns: i64,
) -> Vec<PosePair> {
    estimate
        .iter()
        .filter_map(|found| {
            Some(PosePair {
                stamp_ns: found.stamp_ns,
                estimate: found.pose,
                truth: pose_at(truth, found.stamp_ns, max_gap_ns)?,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(stamp_ns: i64, x: f64) -> StampedPose {
        StampedPose {
            stamp_ns,
            pose: Pose::from_yaw(x, 0.0, 0.0),
        }
    }

    #[test]
    fn between_two_true_poses_and_never_outside_or_across_a_gap() {
        let truth = [at(10, 1.0), at(20, 2.0), at(100, 3.0), at(105, 4.0)];
        let estimate: Vec<_> = [9, 10, 15, 50, 100, 104, 105, 106]
            .into_iter()
            .map(|stamp| at(stamp, 0.0))
            .collect();
        let pairs = associate(&estimate, &truth, 10);
        let found: Vec<_> = pairs
            .iter()
            .map(|pair| (pair.stamp_ns, pair.truth.translation.x))
            .collect();
        let expected = [(10, 1.0), (15, 1.5), (100, 3.0), (104, 3.8), (105, 4.0)];
        assert_eq!(found, expected);
        assert!(associate(&estimate, &[], 10).is_empty());
    }
}
