//! The true motion of the vehicle: a path driven with bounded acceleration.

use super::{Ground, PathPoint};
use crate::plane::{Pose2, between};
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};

/// Acceleration and braking, m/s².
const ACCELERATION: f64 = 1.2;
/// Sideways acceleration in bends, m/s².
const LATERAL: f64 = 1.5;
/// The vehicle stands this long at both ends, seconds.
const STAND_S: f64 = 0.5;
/// The springs give this much per acceleration, rad/(m/s²).
const SWAY: f64 = 0.0025;

/// A drive: position as a function of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    ground: Ground,
    path: Vec<PathPoint>,
    speed: Vec<f64>,
    time: Vec<f64>,
}

/// How the vehicle moves at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Distance driven, metres.
    pub s: f64,
    /// The rear axle's middle, and the heading, unwrapped.
    pub pose: Pose2,
    /// Speed, m/s.
    pub speed: f64,
    /// Curvature, 1/m.
    pub curvature: f64,
}

impl Trajectory {
    /// Drives a path of at least two points on `ground`, at most `top_speed` (m/s) fast.
    pub fn new(path: Vec<PathPoint>, top_speed: f64, ground: Ground) -> Self {
        let speed = speeds(&path, top_speed);
        let mut time = vec![STAND_S];
        for k in 1..path.len() {
            let mean = (0.5 * (speed[k] + speed[k - 1])).max(1e-3);
            time.push(time[k - 1] + (path[k].s - path[k - 1].s) / mean);
        }
        Self {
            ground,
            path,
            speed,
            time,
        }
    }

    /// Length of the session, seconds.
    pub fn duration_s(&self) -> f64 {
        self.time.last().copied().unwrap_or(0.0) + STAND_S
    }

    /// Length of the path, metres.
    pub fn length_m(&self) -> f64 {
        self.path.last().map_or(0.0, |point| point.s)
    }

    /// When the vehicle has driven `s` metres, seconds after the session's start.
    pub fn time_at(&self, s: f64) -> f64 {
        let after = self.path.partition_point(|point| point.s <= s);
        let b = after.clamp(1, self.path.len() - 1);
        let a = b - 1;
        let way = (s - self.path[a].s).clamp(0.0, self.path[b].s - self.path[a].s);
        let span = self.time[b] - self.time[a];
        let gain = (self.speed[b] - self.speed[a]) / span;
        // way = v t + gain t² / 2, written so that no difference of nearly equal numbers is taken.
        let v = self.speed[a];
        let end = (v * v + 2.0 * gain * way).max(0.0).sqrt();
        let tau = if v + end > 1e-9 {
            2.0 * way / (v + end)
        } else {
            0.0
        };
        self.time[a] + tau.min(span)
    }

    /// Where the vehicle is `t` seconds after the session's start.
    pub fn motion(&self, t: f64) -> Motion {
        let after = self.time.partition_point(|time| *time <= t);
        let after = after.clamp(1, self.path.len() - 1);
        let before = after - 1;
        let (a, b) = (&self.path[before], &self.path[after]);
        let span = self.time[after] - self.time[before];
        let tau = (t - self.time[before]).clamp(0.0, span);
        let gain = (self.speed[after] - self.speed[before]) / span;
        let speed = self.speed[before] + gain * tau;
        let step = self.speed[before] * tau + 0.5 * gain * tau * tau;
        let f = (step / (b.s - a.s)).clamp(0.0, 1.0);
        let mix = |a: f64, b: f64| a + f * (b - a);
        let moving = t > STAND_S && t < self.duration_s() - STAND_S;
        Motion {
            s: mix(a.s, b.s),
            pose: Pose2::new(
                between(a.pose.at(), b.pose.at(), f),
                mix(a.pose.yaw, b.pose.yaw),
            ),
            speed: if moving { speed } else { 0.0 },
            curvature: mix(a.curvature, b.curvature),
        }
    }

    /// `map_from_vehicle` at `t` seconds: on its wheels, with a little roll and pitch from the
    /// springs.
    pub fn map_from_vehicle(&self, t: f64) -> Pose {
        let at = self.motion(t);
        let window = 0.25;
        let mut sideways = 0.0;
        for k in 0..9 {
            let then = self.motion(t + window * (f64::from(k) / 4.0 - 1.0));
            sideways += then.speed * then.speed * then.curvature / 9.0;
        }
        let faster = self.motion(t + window).speed - self.motion(t - window).speed;
        let forward = faster / (2.0 * window);
        let sway = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -SWAY * forward)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), SWAY * sideways);
        let sway = Pose::new(Vector3::zeros(), sway);
        self.ground.stand(&at.pose).compose(&sway)
    }
}

/// The fastest speeds within the limits: one pass forwards, one backwards.
fn speeds(path: &[PathPoint], top_speed: f64) -> Vec<f64> {
    let mut speed: Vec<f64> = path
        .iter()
        .map(|point| top_speed.min((LATERAL / point.curvature.abs().max(1e-9)).sqrt()))
        .collect();
    let last = speed.len() - 1;
    speed[0] = 0.0;
    speed[last] = 0.0;
    let reach = |from: f64, a: &PathPoint, b: &PathPoint| {
        (from * from + 2.0 * ACCELERATION * (b.s - a.s)).sqrt()
    };
    for k in 1..=last {
        speed[k] = speed[k].min(reach(speed[k - 1], &path[k - 1], &path[k]));
    }
    for k in (0..last).rev() {
        speed[k] = speed[k].min(reach(speed[k + 1], &path[k], &path[k + 1]));
    }
    speed
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::car_park::{CarPark, Layout, Route};
    use crate::plane::distance;

    #[test]
    fn stands_accelerates_and_never_jumps() {
        let world = CarPark::default();
        let layout = Layout::new(&world);
        let path = Route::of_session(&world, 0).path(&layout, 0.0, 2.0);
        let drive = Trajectory::new(path, world.speed_mps, layout.ground);
        let duration = drive.duration_s();
        assert!((45.0..90.0).contains(&duration), "{duration}");
        assert_eq!(
            drive.map_from_vehicle(0.0).translation,
            drive.map_from_vehicle(0.2).translation
        );
        let mut before = drive.motion(0.0);
        let mut k = 1;
        while f64::from(k) * 0.01 < duration {
            let now = drive.motion(f64::from(k) * 0.01);
            let moved = distance(now.pose.at(), before.pose.at());
            assert!(moved <= 0.011 * world.speed_mps);
            assert!(
                (now.speed - before.speed).abs() < 0.05,
                "{before:?} {now:?}"
            );
            assert!((now.s - before.s - moved).abs() < 1e-3);
            before = now;
            k += 1;
        }
    }
}
