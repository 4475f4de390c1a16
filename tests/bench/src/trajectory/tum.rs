//! Reads the text of the TUM RGB-D benchmark: `seconds x y z qx qy qz qw` on each line, `#` before remarks.

use evermap_algorithms::geometry::pose::{Pose, PoseError};
use evermap_algorithms::geometry::trajectory::StampedPose;

/// A line that is none of a trajectory's.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TumError {
    /// Not eight numbers.
    #[error("line {line}: expected `seconds x y z qx qy qz qw`, found {found:?}")]
    Line {
        /// Counted from 1.
        line: usize,
        /// The line.
        found: String,
    },
    /// Eight numbers that are no pose.
    #[error("line {line}: {source}")]
    Pose {
        /// Counted from 1.
        line: usize,
        /// What is wrong with them.
        source: PoseError,
    },
}

/// The poses of a text, in its order. Stamps are read as decimal fractions, exact to the
/// nanosecond; digits beyond are cut off.
///
/// # Errors
/// [`TumError`] at the first line that is neither a pose, a remark, nor empty.
pub fn read(text: &str) -> Result<Vec<StampedPose>, TumError> {
    let lines = text
        .lines()
        .enumerate()
        .map(|(k, line)| (k + 1, line.trim()));
    let wanted = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    wanted
        .map(|(number, line)| read_line(number, line))
        .collect()
}

fn read_line(line: usize, text: &str) -> Result<StampedPose, TumError> {
    let fault = || TumError::Line {
        line,
        found: text.to_owned(),
    };
    let mut words = text.split([' ', '\t', ',']).filter(|word| !word.is_empty());
    let stamp_ns = words.next().and_then(nanoseconds).ok_or_else(fault)?;
    let mut numbers = [0.0; 7];
    for number in &mut numbers {
        *number = words
            .next()
            .and_then(|word| word.parse().ok())
            .ok_or_else(fault)?;
    }
    if words.next().is_some() {
        return Err(fault());
    }
    let pose = Pose::from_array(numbers).map_err(|source| TumError::Pose { line, source })?;
    Ok(StampedPose { stamp_ns, pose })
}

/// Nanoseconds of a decimal number of seconds. Exponents (`1.7e9`) go through a double.
fn nanoseconds(word: &str) -> Option<i64> {
    if word.contains(['e', 'E']) {
        let ns = word.parse::<f64>().ok()? * 1e9;
        return (ns.abs() < i64::MAX as f64).then_some(ns.round() as i64);
    }
    let (negative, digits) = match word.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, word),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let all_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if whole.is_empty() && fraction.is_empty() || !all_digits(whole) || !all_digits(fraction) {
        return None;
    }
    let seconds: i64 = if whole.is_empty() {
        0
    } else {
        whole.parse().ok()?
    };
    let kept = fraction.bytes().chain(std::iter::repeat(b'0')).take(9);
    let below = kept.fold(0, |sum, digit| 10 * sum + i64::from(digit - b'0'));
    let ns = seconds.checked_mul(1_000_000_000)?.checked_add(below)?;
    Some(if negative { -ns } else { ns })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use evermap_algorithms::geometry::trajectory::tum;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read(
            stamps in prop::collection::vec(-i64::MAX..i64::MAX, 0..20),
            t in prop::array::uniform3(-1e6..1e6f64), r in prop::array::uniform3(-3.0..3.0f64)
        ) {
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(r));
            let pose = Pose::from_array(Pose::new(Vector3::from(t), rotation).to_array()).unwrap();
            let poses: Vec<_> = stamps.into_iter().map(|stamp_ns| StampedPose { stamp_ns, pose }).collect();
            let read = read(&tum(&poses)).unwrap();
            prop_assert_eq!(read.len(), poses.len());
            for (a, b) in read.iter().zip(&poses) {
                prop_assert_eq!(a.stamp_ns, b.stamp_ns);
                prop_assert!((a.pose.translation - b.pose.translation).norm() == 0.0);
                prop_assert!(a.pose.rotation.angle_to(&b.pose.rotation) < 1e-7);
            }
        }

        #[test]
        fn any_text_is_poses_or_an_error(text in "[0-9eE.,# \\-\n+naif]{0,200}") {
            let _ = read(&text);
        }
    }

    #[test]
    fn stamps_are_exact() {
        let line = "1780300800.000000001 1 2 3 0 0 0 1";
        assert_eq!(read(line).unwrap()[0].stamp_ns, 1_780_300_800_000_000_001);
        for (word, ns) in [
            ("0.5", 500_000_000),
            (".25", 250_000_000),
            ("7", 7_000_000_000),
            ("-1.5", -1_500_000_000),
            ("1.0000000019", 1_000_000_001),
            ("1.5e1", 15_000_000_000),
        ] {
            assert_eq!(nanoseconds(word), Some(ns), "{word}");
        }
    }

    #[test]
    fn faults_name_their_line() {
        let short = read("# remark\n\n1 2 3\n").unwrap_err();
        assert!(matches!(short, TumError::Line { line: 3, .. }), "{short}");
        let zero = read("1 0 0 0 0 0 0 0").unwrap_err();
        assert!(matches!(zero, TumError::Pose { line: 1, .. }), "{zero}");
        for bad in [
            "x 0 0 0 0 0 0 1",
            "1 0 0 0 0 0 0 1 9",
            "-. 0 0 0 0 0 0 1",
            "99999999999 0 0 0 0 0 0 1",
        ] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }
}
