//! Speed and acceleration along a driven path.

use nalgebra::{Matrix3, Vector3};

use crate::geometry::pose::Pose;

/// How fast a vehicle drove.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Speed {
    /// Along its forward axis; negative in reverse.
    pub speed_mps: f64,
    /// Change of the speed.
    pub acceleration_mps2: f64,
}

/// The speed at each message of a drive's odometry (stamp in ns, ascending, and pose): that of the parabola nearest to
/// the path within half a window before and after it (Savitzky and Golay, 1964, for any spacing). None where the pose is
/// no rigid transform, the stamp repeats, or fewer than three poses lie in the window.
pub fn speeds(odometry: &[(i64, [f64; 7])], window_s: f64) -> Vec<Option<Speed>> {
    let known = path(odometry);
    let path: Vec<[f64; 2]> = known.iter().flatten().copied().collect();
    let speeds = known.iter().map(|at| speed(&path, (*at)?, window_s / 2.0));
    speeds.collect()
}

fn speed(path: &[[f64; 2]], [now_s, here_m]: [f64; 2], half_s: f64) -> Option<Speed> {
    let first = path.partition_point(|[second, _]| *second < now_s - half_s);
    let near = path[first..].iter();
    let near = near.map(|[second, path_m]| [(second - now_s) / half_s, path_m - here_m]);
    let [first, second] = derivatives(near.take_while(|[t, _]| *t <= 1.0))?;
    Some(Speed {
        speed_mps: first / half_s,
        acceleration_mps2: second / half_s.powi(2),
    })
}

/// By message: seconds since the first one, and metres driven forward.
fn path(odometry: &[(i64, [f64; 7])]) -> Vec<Option<[f64; 2]>> {
    let (mut before, mut path_m) = (None, 0.0);
    let mut at = |(stamp, pose): &(i64, [f64; 7])| {
        let pose = Pose::from_array(*pose).ok()?;
        let (last, last_pose) = before.unwrap_or((stamp.saturating_sub(1), pose));
        if *stamp <= last {
            return None;
        }
        path_m += last_pose.inverse().compose(&pose).translation.x;
        before = Some((*stamp, pose));
        let since = stamp.saturating_sub(odometry[0].0);
        Some([since as f64 * 1e-9, path_m])
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
    fn what_has_no_speed() {
        let drive = drive(|t| t, 1e9);
        assert_eq!(speeds(&drive[..2], 0.5), [None, None]);
        assert_eq!(speeds(&drive[..9], 0.03), [None; 9]);
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
