//! Speed and acceleration along a driven path.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::MotionLimits;
use super::continuity::{Continued, Continuity};
use crate::geometry::pose::Pose;

/// A parabola needs so many points.
const FEWEST: usize = 3;

/// Messages farther away than this (s) say nothing of the speed: odometry at 1 Hz has the third one there at its ends.
const LONGEST_S: f64 = 2.0;

/// How fast a vehicle drove.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Speed {
    /// Along its forward axis; negative in reverse.
    pub speed_mps: f64,
    /// Change of the speed.
    pub acceleration_mps2: f64,
}

/// The speed at each message of a drive's odometry (stamp in ns, ascending, and pose): that of the parabola nearest to
/// the path within half a window before and after it (Savitzky and Golay, 1964, for any spacing), or to the nearest three
/// messages within two seconds where the window has fewer. None where the pose is not a rigid transform, the stamp repeats,
/// or there are no three. Nothing is laid across a jump that leaves open how the vehicle moved.
pub fn speeds(odometry: &[(i64, [f64; 7])], window_s: f64) -> Vec<Option<Speed>> {
    let known = path(odometry);
    let path: Vec<Passed> = known.iter().flatten().copied().collect();
    let mut here = 0..;
    let mut at = |known: &Option<Passed>| {
        let here = known.and_then(|_| here.next())?;
        speed(&path, here, window_s / 2.0)
    };
    known.iter().map(&mut at).collect()
}

/// Where a message found the vehicle.
#[derive(Debug, Clone, Copy)]
struct Passed {
    /// Since the first message.
    second: f64,
    /// Driven forward.
    path_m: f64,
    /// Stretch of unbroken odometry.
    stretch: u32,
}

fn speed(path: &[Passed], here: usize, half_s: f64) -> Option<Speed> {
    let window = window(path, here, half_s)?;
    let Passed { second, path_m, .. } = path[here];
    let near = &path[window];
    let reach_s = near.iter().map(|at| (at.second - second).abs());
    let scale_s = reach_s.fold(half_s, f64::max);
    let points = near
        .iter()
        .map(|at| [(at.second - second) / scale_s, at.path_m - path_m]);
    let [first, second] = derivatives(points)?;
    Some(Speed {
        speed_mps: first / scale_s,
        acceleration_mps2: second / scale_s.powi(2),
    })
}

/// The messages of one stretch that are at most `half_s` from one of them, or else the nearest three.
fn window(path: &[Passed], here: usize, half_s: f64) -> Option<Range<usize>> {
    let away = |at: usize| {
        let other = path.get(at).filter(|at| at.stretch == path[here].stretch)?;
        Some((other.second - path[here].second).abs())
    };
    let (mut from, mut to) = (here, here + 1);
    loop {
        let before = from.checked_sub(1).and_then(away).unwrap_or(f64::INFINITY);
        let after = away(to).unwrap_or(f64::INFINITY);
        let nearest = before.min(after);
        if nearest > half_s && (to - from >= FEWEST || nearest > LONGEST_S) {
            return (to - from >= FEWEST).then_some(from..to);
        }
        if before < after {
            from -= 1;
        } else {
            to += 1;
        }
    }
}

fn path(odometry: &[(i64, [f64; 7])]) -> Vec<Option<Passed>> {
    let mut continuity = Continuity::new(MotionLimits::default());
    let (mut last, mut path_m, mut stretch) = (None, 0.0, 0);
    let mut at = |(stamp, pose): &(i64, [f64; 7])| {
        let pose = Pose::from_array(*pose).ok()?;
        let Continued { pose, anew } = continuity.push(*stamp, &pose)?;
        let before: Pose = last.replace(pose).unwrap_or(pose);
        if anew {
            stretch += 1;
        } else {
            path_m += before.inverse().compose(&pose).translation.x;
        }
        let since = stamp.saturating_sub(odometry[0].0);
        Some(Passed {
            second: since as f64 * 1e-9,
            path_m,
            stretch,
        })
    };
    odometry.iter().map(&mut at).collect()
}

/// First and second derivative, at t = 0, of the parabola nearest to points `[t, y]`; none for fewer than three.
fn derivatives(points: impl Iterator<Item = [f64; 2]>) -> Option<[f64; 2]> {
    let (mut normal, mut right, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
    for [t, y] in points {
        let powers = Vector3::new(1.0, t, t * t);
        normal += powers * powers.transpose();
        right += powers * y;
        count += 1;
    }
    let parabola = normal.cholesky()?.solve(&right);
    (count > 2).then_some([parabola.y, 2.0 * parabola.z])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Poses at 50 Hz, at these distances along a bend.
    fn drive(metres: impl Fn(f64) -> f64, radius_m: f64) -> Vec<(i64, [f64; 7])> {
        let at = |step: i64| {
            let yaw = metres(step as f64 * 0.02) / radius_m;
            let pose = Pose::from_yaw(radius_m * yaw.sin(), radius_m * (1.0 - yaw.cos()), yaw);
            (step * 20_000_000, pose.to_array())
        };
        (0..200).map(at).collect()
    }

    #[test]
    fn constant_acceleration_is_found_exactly_forwards_and_in_reverse() {
        let braking = |t: f64| 4.0 * t - t * t;
        for (step, found) in speeds(&drive(braking, 1e9), 0.5).into_iter().enumerate() {
            let (found, t) = (found.unwrap(), step as f64 * 0.02);
            assert!(
                (found.speed_mps - (4.0 - 2.0 * t)).abs() < 1e-4,
                "{found:?} at {t} s"
            );
            assert!(
                (found.acceleration_mps2 + 2.0).abs() < 1e-3,
                "{found:?} at {t} s"
            );
        }
    }

    #[test]
    fn a_bend_and_trembling_odometry_change_little() {
        let tremble = |t: f64| 0.001 * ((t * 50.0) as i64 * 7919 % 5 - 2) as f64;
        for found in speeds(&drive(|t| 3.0 * t + tremble(t), 6.0), 1.0) {
            let found = found.unwrap();
            assert!((found.speed_mps - 3.0).abs() < 0.05, "{found:?}");
            assert!(found.acceleration_mps2.abs() < 0.3, "{found:?}");
        }
    }

    #[test]
    fn a_hertz_is_enough_and_jumps_are_no_speed() {
        let slow: Vec<_> = drive(|t| 3.0 * t, 20.0).into_iter().step_by(50).collect();
        for found in speeds(&slow, 0.5) {
            assert!((found.unwrap().speed_mps - 3.0).abs() < 0.05, "{found:?}");
        }
        let mut reset = drive(|t| 3.0 * t, 20.0);
        let start = Pose::from_array(reset[100].1).unwrap();
        for (_, pose) in &mut reset[100..] {
            let here = Pose::from_array(*pose).unwrap();
            *pose = start.inverse().compose(&here).to_array();
        }
        for found in speeds(&reset, 0.5) {
            assert!((found.unwrap().speed_mps - 3.0).abs() < 0.05, "{found:?}");
        }
    }

    #[test]
    fn what_has_no_speed() {
        let drive = drive(|t| t, 1e9);
        assert_eq!(speeds(&drive[..2], 0.5), [None, None]);
        let mut broken = drive[..9].to_vec();
        broken[3].1 = [0.0; 7];
        broken[5].0 = broken[4].0;
        let known: Vec<bool> = speeds(&broken, 0.5).iter().map(Option::is_some).collect();
        assert_eq!(
            known,
            [true, true, true, false, true, false, true, true, true]
        );
    }
}
