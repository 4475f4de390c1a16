//! An IMU as cars have them: it feels the road and the engine, and its gyroscopes turn a little when nothing does.

use super::Trajectory;
use crate::random::{nanoseconds, normal, stream};
use evermap_algorithms::geometry::lie::so3;
use evermap_algorithms::geometry::pose::Pose;
use evermap_messages::ros2::{self, Header};
use evermap_recording::Times;
use nalgebra::Vector3;

/// The frame that it measures in.
pub const SENSOR: &str = "imu";
/// Where it sits on the vehicle, m, and how it is turned, rad: connectors point where there is room.
const PLACE: [f64; 3] = [0.6, -0.2, 0.4];
const TURNED: [f64; 3] = [0.0, 0.0, -1.5];

/// Measurements a second.
const RATE_HZ: f64 = 100.0;
/// It answers to motion over this long, s.
const ANSWER_S: f64 = 0.04;
/// Gravity, m/s².
const GRAVITY: f64 = 9.81;
/// White noise of a measurement: rad/s, and m/s² with the engine running.
const GYRO_NOISE: f64 = 0.003;
const FORCE_NOISE: f64 = 0.08;
/// Standard deviations of what it says at rest: rad/s and m/s².
const GYRO_BIAS: f64 = 0.004;
const FORCE_BIAS: f64 = 0.02;
/// From the measurement to the recorder, ns.
const DELAY_NS: u64 = 2_000_000;

/// The IMU of one session, and what it says at rest, along its axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imu {
    /// Rate of turn, rad/s.
    turn: Vector3<f64>,
    /// Acceleration beside gravity's, m/s².
    force: Vector3<f64>,
}

impl Imu {
    /// The IMU of a session.
    pub fn new(seed: u64, session: usize) -> Self {
        let mut rng = stream(seed, "imu bias", session as u64);
        let mut draw = |sd: f64| Vector3::from_fn(|_, _| sd * normal(&mut rng).clamp(-2.0, 2.0));
        Self {
            turn: draw(GYRO_BIAS),
            force: draw(FORCE_BIAS),
        }
    }

    /// `vehicle_from_imu`.
    pub fn mount() -> Pose {
        Pose::new(Vector3::from(PLACE), so3::exp(&Vector3::from(TURNED)))
    }

    /// What it measures during a drive.
    pub fn samples(
        &self,
        drive: &Trajectory,
        start_ns: u64,
        seed: u64,
        session: usize,
    ) -> Vec<(Times, ros2::Imu<'static>)> {
        let mut rng = stream(seed, "imu", session as u64);
        let mut draw = |sd: f64| Vector3::from_fn(|_, _| sd * normal(&mut rng));
        let count = (drive.duration_s() * RATE_HZ).floor() as usize;
        let sample = |step: usize| {
            let seconds = step as f64 / RATE_HZ;
            let [turn, force] = measured(drive, seconds);
            let stamp_ns = start_ns + nanoseconds(seconds);
            let log_ns = stamp_ns + DELAY_NS;
            let message = ros2::Imu {
                header: Header {
                    stamp_ns,
                    frame_id: SENSOR,
                },
                angular_velocity: (turn + self.turn + draw(GYRO_NOISE)).into(),
                linear_acceleration: (force + self.force + draw(FORCE_NOISE)).into(),
            };
            (Times { log_ns, stamp_ns }, message)
        };
        (0..=count).map(sample).collect()
    }
}

/// Rate of turn and felt acceleration along the sensor's axes, without any error.
fn measured(drive: &Trajectory, seconds: f64) -> [Vector3<f64>; 2] {
    let at = |step: f64| {
        drive
            .map_from_vehicle(seconds + step * ANSWER_S)
            .compose(&Imu::mount())
    };
    let [before, here, after] = [-1.0, 0.0, 1.0].map(at);
    let turned = so3::log(&(before.rotation.inverse() * after.rotation));
    let bent = after.translation - 2.0 * here.translation + before.translation;
    let felt = bent / (ANSWER_S * ANSWER_S) + GRAVITY * Vector3::z();
    [turned / (2.0 * ANSWER_S), here.rotation.inverse() * felt]
}
