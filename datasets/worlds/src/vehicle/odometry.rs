//! Wheel odometry as a car really reports it: counted ticks, wheels that are not quite the size
//! the software believes, and a heading that slowly leans.

use super::Trajectory;
use super::ground::TRACK_M;
use crate::plane::Pose2;
use crate::random::{nanoseconds, normal, stream};
use evermap_messages::ros2::Odometry;
use evermap_recording::Times;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

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

/// One odometry message, before it is written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometrySample {
    /// When it was measured, and when the recorder got it.
    pub times: Times,
    /// Where the vehicle is in the odom frame.
    pub pose: Pose2,
    /// Forward speed, m/s.
    pub speed: f64,
    /// Turning rate, rad/s.
    pub yaw_rate: f64,
    /// Distance driven so far, metres.
    pub driven: f64,
}

/// The wheels of one session and who counts their ticks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wheels {
    /// Messages per second.
    pub rate_hz: f64,
    /// What is wrong with them.
    pub errors: WheelErrors,
}

impl Wheels {
    /// The wheels of a session, whose distances are besides too long by `scale_error` (relative).
    pub fn new(rate_hz: f64, seed: u64, session: usize, scale_error: f64) -> Self {
        let mut rng = stream(seed, "wheels", session as u64);
        let mut draw = |sigma: f64| sigma * normal(&mut rng).clamp(-2.0, 2.0);
        let errors = WheelErrors {
            scale: draw(0.008) + scale_error,
            track: draw(0.008),
            difference: draw(0.0004),
            yaw_bias: draw(0.0003),
        };
        Self { rate_hz, errors }
    }

    /// What they report during a drive. The odom frame starts at the first pose, (0, 0, 0).
    pub fn odometry(
        &self,
        drive: &Trajectory,
        start_ns: u64,
        mut rng: ChaCha8Rng,
    ) -> Vec<OdometrySample> {
        let errors = self.errors;
        let count = (drive.duration_s() * self.rate_hz).floor() as usize;
        let mut samples = Vec::with_capacity(count + 1);
        let mut ticks = TickCounters::default();
        let mut before = (0.0, drive.motion(0.0));
        let mut pose = Pose2::new([0.0; 2], 0.0);
        let (mut driven, mut lean) = (0.0, 1.0_f64);
        for k in 0..=count {
            let mut due = k as f64 / self.rate_hz;
            if k > 0 {
                due += 1e-4 * normal(&mut rng).clamp(-3.0, 3.0);
            }
            let stamp = nanoseconds(due);
            let t = stamp as f64 * 1e-9;
            let at = drive.motion(t);
            let span = t - before.0;
            lean = (lean + 0.02 * normal(&mut rng)).clamp(0.5, 1.5);
            let forward = at.s - before.1.s;
            let mut turned = at.pose.yaw - before.1.pose.yaw;
            if forward > 0.0 {
                turned += errors.yaw_bias * lean * span;
            }
            let [left, right] = ticks.roll(forward, turned, &errors, &mut rng);
            let moved = 0.5 * (left + right);
            let rotated = (right - left) / (TRACK_M * (1.0 + errors.track));
            pose.x += moved * (pose.yaw + 0.5 * rotated).cos();
            pose.y += moved * (pose.yaw + 0.5 * rotated).sin();
            pose.yaw += rotated;
            driven += moved.abs();
            let rate = if span > 0.0 { 1.0 / span } else { 0.0 };
            let stamp_ns = start_ns + stamp;
            let log_ns = stamp_ns + rng.random_range(400_000..2_200_000);
            samples.push(OdometrySample {
                times: Times { log_ns, stamp_ns },
                pose,
                speed: moved * rate,
                yaw_rate: rotated * rate,
                driven,
            });
            before = (t, at);
        }
        samples
    }
}

/// What the left and the right wheel have rolled, and what was counted of it, metres.
#[derive(Default)]
struct TickCounters {
    rolled: [f64; 2],
    counted: [f64; 2],
}

impl TickCounters {
    /// The vehicle moves (m) and turns (rad); gives how far each wheel is counted to have rolled, metres.
    fn roll(
        &mut self,
        forward: f64,
        turned: f64,
        errors: &WheelErrors,
        rng: &mut ChaCha8Rng,
    ) -> [f64; 2] {
        let mut step = [0.0; 2];
        for (wheel, side) in [(0, -0.5), (1, 0.5)] {
            let size = 1.0 + errors.scale + side * errors.difference;
            self.rolled[wheel] += (forward + side * TRACK_M * turned) * size;
            let slip = if forward > 0.0 {
                0.3 * TICK_M * normal(rng)
            } else {
                0.0
            };
            let ticks = ((self.rolled[wheel] + slip) / TICK_M).floor() * TICK_M;
            step[wheel] = ticks - self.counted[wheel];
            self.counted[wheel] = ticks;
        }
        step
    }
}

impl OdometrySample {
    /// As it is written. Its variances grow with the distance driven.
    pub fn message(&self) -> Odometry {
        let place = 1e-4 + (0.01 * self.driven).powi(2);
        let turn = 1e-5 + (0.001 * self.driven).powi(2);
        Odometry {
            stamp_ns: self.times.stamp_ns,
            pose: self.pose.upright(0.0).to_array(),
            pose_variances: [place, place, 0.01, 1e-4, 1e-4, turn],
            twist: [self.speed, 0.0, 0.0, 0.0, 0.0, self.yaw_rate],
            twist_variances: [0.01, 1e-4, 1e-6, 1e-6, 1e-6, 0.01],
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::car_park::{CarPark, Layout, Route};
    use crate::plane::distance;

    #[test]
    fn drift_is_there_and_bounded() {
        for seed in 0..8 {
            let world = CarPark {
                seed,
                ..CarPark::default()
            };
            let layout = Layout::new(&world);
            let path = Route::of_session(&world, 0).path(&layout, 0.0, 2.0);
            let drive = Trajectory::new(path, world.speed_mps, layout.ground);
            let wheels = Wheels::new(world.odometry_rate_hz, seed, 0, 0.0);
            let samples = wheels.odometry(&drive, 0, stream(seed, "ticks", 0));
            let map_from_odom = drive.motion(0.0).pose.upright(0.0);
            assert_eq!(samples[0].times.stamp_ns, 0);
            assert_eq!(samples[0].pose, Pose2::new([0.0; 2], 0.0));
            let mut worst = 0.0_f64;
            for sample in &samples {
                let truth = drive.motion(sample.times.stamp_ns as f64 * 1e-9);
                let there = map_from_odom.compose(&sample.pose.upright(0.0));
                let there = [there.translation.x, there.translation.y];
                let error = distance(there, truth.pose.at());
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
