//! Wheel odometry as a car really reports it: counted ticks, wheels that are not quite the size
//! the software believes, and a heading that slowly leans.

use crate::drive::Drive;
use crate::random::stream;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

/// Distance between the wheels, metres.
const TRACK_M: f64 = 1.55;
/// Distance rolled per tick of a wheel sensor, metres.
const TICK_M: f64 = 0.004;

/// The errors of one session's odometry. Each is drawn from a normal distribution with the
/// standard deviation given here, cut at two of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WheelErrors {
    /// Relative error of distance (0.008), beside the one that was asked for.
    pub scale: f64,
    /// Relative error of the distance between the wheels (0.008).
    pub track: f64,
    /// Relative difference between the right and the left wheel's size (0.0004).
    pub difference: f64,
    /// Drift of the heading while moving, rad/s (0.0003).
    pub yaw_bias: f64,
}

impl WheelErrors {
    /// The errors of a session, whose distances are besides too long by `scale_error` (relative).
    pub fn of_session(seed: u64, session: u64, scale_error: f64) -> Self {
        let mut rng = stream(seed, "wheels", session);
        let mut draw = |sigma: f64| sigma * normal(&mut rng).clamp(-2.0, 2.0);
        Self {
            scale: draw(0.008) + scale_error,
            track: draw(0.008),
            difference: draw(0.0004),
            yaw_bias: draw(0.0003),
        }
    }
}

/// One odometry message, before it is written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometrySample {
    /// When it was measured, ns since the epoch.
    pub stamp_ns: u64,
    /// When the recorder got it, ns since the epoch.
    pub log_ns: u64,
    /// Position in the odom frame, metres.
    pub x: f64,
    /// Position in the odom frame, metres.
    pub y: f64,
    /// Heading in the odom frame, radians.
    pub yaw: f64,
    /// Forward speed, m/s.
    pub speed: f64,
    /// Turning rate, rad/s.
    pub yaw_rate: f64,
    /// Distance driven so far, metres.
    pub driven: f64,
}

/// A standard normal number.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// The wheels of one session and who counts their ticks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wheels {
    /// Everything random is drawn from this number.
    pub seed: u64,
    /// Number of the session.
    pub session: u64,
    /// Messages per second.
    pub rate_hz: f64,
    /// What is wrong with them.
    pub errors: WheelErrors,
}

impl Wheels {
    /// What they report during a drive. The odom frame starts at the first pose, (0, 0, 0).
    pub fn odometry(&self, drive: &Drive, start_ns: u64) -> Vec<OdometrySample> {
        wheel_odometry(self, drive, start_ns)
    }
}

fn wheel_odometry(wheels: &Wheels, drive: &Drive, start_ns: u64) -> Vec<OdometrySample> {
    let errors = wheels.errors;
    let mut rng = stream(wheels.seed, "ticks", wheels.session);
    let count = (drive.duration_s() * wheels.rate_hz).floor() as usize;
    let mut samples: Vec<OdometrySample> = Vec::with_capacity(count + 1);
    let mut counters = [0.0_f64; 2];
    let mut rolled = [0.0_f64; 2];
    let mut before = (0.0, drive.planar(0.0));
    let (mut x, mut y, mut yaw, mut driven, mut lean) = (0.0, 0.0, 0.0, 0.0, 1.0_f64);
    for k in 0..=count {
        let jitter = if k == 0 {
            0.0
        } else {
            1e-4 * normal(&mut rng).clamp(-3.0, 3.0)
        };
        let stamp = nanoseconds(k as f64 / wheels.rate_hz + jitter);
        let t = stamp as f64 * 1e-9;
        let at = drive.planar(t);
        let span = t - before.0;
        lean = (lean + 0.02 * normal(&mut rng)).clamp(0.5, 1.5);
        let forward = at.s - before.1.s;
        let lean_rad = if forward > 0.0 {
            errors.yaw_bias * lean * span
        } else {
            0.0
        };
        let turned = at.yaw - before.1.yaw + lean_rad;
        let mut step = [0.0; 2];
        for (wheel, side) in [(0, -0.5), (1, 0.5)] {
            let size = 1.0 + errors.scale + side * errors.difference;
            rolled[wheel] += (forward + side * TRACK_M * turned) * size;
            let slip = if forward > 0.0 {
                0.3 * TICK_M * normal(&mut rng)
            } else {
                0.0
            };
            let ticks = ((rolled[wheel] + slip) / TICK_M).floor() * TICK_M;
            step[wheel] = ticks - counters[wheel];
            counters[wheel] = ticks;
        }
        let moved = 0.5 * (step[0] + step[1]);
        let rotated = (step[1] - step[0]) / (TRACK_M * (1.0 + errors.track));
        x += moved * (yaw + 0.5 * rotated).cos();
        y += moved * (yaw + 0.5 * rotated).sin();
        yaw += rotated;
        driven += moved.abs();
        let rate = if span > 0.0 { 1.0 / span } else { 0.0 };
        samples.push(OdometrySample {
            stamp_ns: start_ns + stamp,
            log_ns: start_ns + stamp + rng.random_range(400_000..2_200_000),
            x,
            y,
            yaw,
            speed: moved * rate,
            yaw_rate: rotated * rate,
            driven,
        });
        before = (t, at);
    }
    samples
}

/// Seconds (not negative) to whole nanoseconds.
pub fn nanoseconds(seconds: f64) -> u64 {
    (seconds.max(0.0) * 1e9).round() as u64
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::layout::Layout;
    use crate::params::CarPark;
    use crate::route::Route;
    use evermap_algorithms::geometry::pose::Pose;

    #[test]
    fn drift_is_there_and_bounded() {
        for seed in 0..8 {
            let world = CarPark {
                seed,
                ..CarPark::default()
            };
            let layout = Layout::new(&world);
            let path = Route::of_session(&world, 0).path(&layout, 2.0);
            let drive = Drive::new(path, world.speed_mps, layout.ground);
            let wheels = Wheels {
                seed,
                session: 0,
                rate_hz: world.odometry_rate_hz,
                errors: WheelErrors::of_session(seed, 0, 0.0),
            };
            let samples = wheels.odometry(&drive, 0);
            let map_from_odom = {
                let first = drive.planar(0.0);
                Pose::from_yaw(first.x, first.y, first.yaw)
            };
            assert_eq!(samples[0].stamp_ns, 0);
            assert_eq!(
                (samples[0].x, samples[0].y, samples[0].yaw),
                (0.0, 0.0, 0.0)
            );
            let mut worst = 0.0_f64;
            for sample in &samples {
                let truth = drive.planar(sample.stamp_ns as f64 * 1e-9);
                let there = map_from_odom.compose(&Pose::from_yaw(sample.x, sample.y, sample.yaw));
                let error = (there.translation.x - truth.x).hypot(there.translation.y - truth.y);
                worst = worst.max(error);
                assert!(error < 0.03 + 0.05 * truth.s, "{error} after {} m", truth.s);
                assert!((sample.speed - truth.speed).abs() < 0.6);
            }
            assert!(
                worst > 0.05,
                "an odometry this good ({worst} m) tests nothing"
            );
        }
    }
}
