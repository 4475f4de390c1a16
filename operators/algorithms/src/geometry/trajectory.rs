//! Trajectories: poses at instants, and the text that other programs exchange them as.

use super::pose::Pose;

/// Poses of a log farther apart than this are not interpolated, ns: a vehicle may have turned meanwhile.
pub const MAX_GAP_NS: i64 = 1_000_000_000;

/// A pose at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedPose {
    /// Nanoseconds since the epoch, UTC.
    pub stamp_ns: i64,
    /// The vehicle in the trajectory's frame.
    pub pose: Pose,
}

/// The pose at an instant, between those around it; `None` before the first and after the last one, and between poses
/// more than `max_gap_ns` apart. They must be ordered by stamp.
pub fn pose_at(poses: &[StampedPose], stamp_ns: i64, max_gap_ns: i64) -> Option<Pose> {
    let after = poses.partition_point(|pose| pose.stamp_ns < stamp_ns);
    let next = poses.get(after)?;
    if next.stamp_ns == stamp_ns {
        return Some(next.pose);
    }
    let before = poses.get(after.checked_sub(1)?)?;
    if next.stamp_ns.saturating_sub(before.stamp_ns) > max_gap_ns {
        return None;
    }
    let (a, b) = ((before.stamp_ns, &before.pose), (next.stamp_ns, &next.pose));
    Some(Pose::at_stamp(stamp_ns, a, b))
}

/// The text of the TUM RGB-D benchmark: `seconds x y z qx qy qz qw` on each line, after a remark that says so. evo and
/// others read it. It has all nine digits of the nanoseconds, and as many digits of the numbers as it takes to read the
/// same ones back.
pub fn tum(poses: &[StampedPose]) -> String {
    let mut text = String::from("# timestamp x y z qx qy qz qw\n");
    for StampedPose { stamp_ns, pose } in poses {
        let sign = if *stamp_ns < 0 { "-" } else { "" };
        let size = stamp_ns.unsigned_abs();
        let (seconds, below) = (size / 1_000_000_000, size % 1_000_000_000);
        text.push_str(&format!("{sign}{seconds}.{below:09}"));
        for value in pose.to_array() {
            // Adding zero writes minus zero as zero.
            text.push_str(&format!(" {}", value + 0.0));
        }
        text.push('\n');
    }
    text
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
    fn poses_are_between_two_and_never_outside_or_across_a_gap() {
        let poses = [at(10, 1.0), at(20, 2.0), at(100, 3.0), at(105, 4.0)];
        let found = [9, 10, 15, 50, 100, 104, 105, 106]
            .map(|stamp| pose_at(&poses, stamp, 10).map(|pose| pose.translation.x));
        let expected = [
            None,
            Some(1.0),
            Some(1.5),
            None,
            Some(3.0),
            Some(3.8),
            Some(4.0),
            None,
        ];
        assert_eq!(found, expected);
        assert!(pose_at(&[], 10, 10).is_none());
    }

    #[test]
    fn texts_have_all_digits() {
        let text = tum(&[at(1_780_300_800_000_000_001, 2.5), at(-1_500_000_000, -1.0)]);
        assert_eq!(
            text,
            "# timestamp x y z qx qy qz qw\n1780300800.000000001 2.5 0 0 0 0 0 1\n-1.500000000 -1 0 0 0 0 0 1\n"
        );
    }
}
