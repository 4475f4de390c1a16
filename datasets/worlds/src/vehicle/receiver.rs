//! A GNSS receiver: noise, a drift that changes within minutes, and a stretch without sky.

use super::Trajectory;
use crate::random::{nanoseconds, normal, stream};
use evermap_algorithms::geometry::geodesy::{Geodetic, Tangent};
use evermap_algorithms::geometry::pose::Pose;
use evermap_messages::ros2::{Header, NavSatFix};
use evermap_recording::Times;
use nalgebra::Vector3;

/// The frame of its antenna.
pub const ANTENNA: &str = "gnss";
/// Where the antenna sits on the vehicle, m.
pub const MOUNT: [f64; 3] = [-0.4, 0.1, 1.6];
/// Where the world's origin lies; x is east, y is north.
pub const PLACE: Geodetic = Geodetic {
    latitude_deg: 52.2646,
    longitude_deg: 10.5236,
    height_m: 81.0,
};

/// Fixes a second.
const RATE_HZ: f64 = 5.0;
/// Time in which the drift forgets itself, s.
const DRIFT_S: f64 = 60.0;
/// From the measurement to the recorder, ns.
const DELAY_NS: u64 = 30_000_000;

/// What a receiver does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Receiver {
    /// White noise along east and along north; half as much again along up, m.
    pub noise_m: f64,
    /// Standard deviation of the drift, m.
    pub drift_m: f64,
    /// It hears nothing in the middle of a drive for so long, s.
    pub outage_s: f64,
}

impl Receiver {
    /// `vehicle_from_antenna`.
    pub fn mount() -> Pose {
        Pose::new(Vector3::from(MOUNT), Pose::identity().rotation)
    }

    /// What it says during a drive: it knows its noise, and nothing of its drift.
    pub fn fixes(
        &self,
        drive: &Trajectory,
        start_ns: u64,
        seed: u64,
        index: usize,
    ) -> Vec<(Times, NavSatFix<'static>)> {
        let mut rng = stream(seed, "gnss", index as u64);
        let tangent = Tangent::at(PLACE);
        let mut draw = |sd: [f64; 3]| Vector3::from(sd.map(|sd| sd * normal(&mut rng)));
        let spread = |sd: f64| [sd, sd, 1.5 * sd];
        let kept = (-1.0 / RATE_HZ / DRIFT_S).exp();
        let fresh = self.drift_m * (1.0 - kept * kept).sqrt();
        let mut drift = draw(spread(self.drift_m));
        let variance = self.noise_m.powi(2);
        let count = (drive.duration_s() * RATE_HZ).floor() as usize;
        let fix = |step: usize| {
            let seconds = step as f64 / RATE_HZ;
            drift = kept * drift + draw(spread(fresh));
            let antenna = drive
                .map_from_vehicle(seconds)
                .transform(&Vector3::from(MOUNT));
            let stamp_ns = start_ns + nanoseconds(seconds);
            let place = tangent.geodetic(&(antenna + drift + draw(spread(self.noise_m))));
            let is_lost = (seconds - drive.duration_s() / 2.0).abs() < self.outage_s / 2.0;
            let log_ns = stamp_ns + DELAY_NS;
            let message = NavSatFix {
                header: Header {
                    stamp_ns,
                    frame_id: ANTENNA,
                },
                place: (!is_lost).then_some([
                    place.latitude_deg,
                    place.longitude_deg,
                    place.height_m,
                ]),
                variances: [variance, variance, 2.25 * variance],
            };
            (Times { log_ns, stamp_ns }, message)
        };
        (0..=count).map(fix).collect()
    }
}
