//! One session in the car park, and whom it meets.

use super::CarPark;
use super::cars::{ParkedCar, parked_cars};
use super::layout::Layout;
use super::route::Route;
use super::walkers::{Walker, walkers};
use crate::random::stream;
use crate::record::{SimulatedSession, shutter};
use crate::vehicle::{Imu, Receiver, Trajectory, Wheels};

const DAY_NS: u64 = 86_400_000_000_000;

/// A session before it is rendered.
pub struct Visit {
    /// The drive.
    pub session: SimulatedSession,
    /// Where it goes.
    pub route: Route,
    /// Who is parked.
    pub parked: Vec<ParkedCar>,
    /// Who walks around.
    pub walkers: Vec<Walker>,
}

impl AsRef<SimulatedSession> for Visit {
    fn as_ref(&self) -> &SimulatedSession {
        &self.session
    }
}

impl Visit {
    /// The visit of this number: `initial`, `revisit_1`, …
    pub fn new(world: &CarPark, layout: &Layout, index: usize) -> Self {
        let route = Route::of_session(world, index);
        let path = route.path(layout, world.start_m, world.loops);
        let drive = Trajectory::new(path, world.speed_mps, layout.ground);
        let mut jitter = stream(world.seed, "shutter", index as u64);
        let shots = (drive.duration_s() * world.rate_hz).floor() as usize;
        let start_ns = world.start_ns + index as u64 * DAY_NS;
        let seconds = |k: usize| 0.02 / world.rate_hz + k as f64 / world.rate_hz;
        let stamps = (0..=shots).map(|k| shutter(start_ns, seconds(k), &mut jitter));
        let (rate_hz, scale_error) = (world.odometry_rate_hz, world.odometry_scale_error);
        Self {
            route,
            parked: parked_cars(world, layout, index),
            walkers: walkers(world, layout, index, &drive),
            session: SimulatedSession {
                seed: world.seed,
                index,
                name: match index {
                    0 => "initial".to_owned(),
                    _ => format!("revisit_{index}"),
                },
                start_ns,
                drive,
                stamps: stamps.collect(),
                wheels: Wheels::new(rate_hz, world.seed, index, scale_error),
                receiver: world.gnss.then_some(Receiver {
                    noise_m: world.gnss_noise_m,
                    drift_m: world.gnss_drift_m,
                    outage_s: world.gnss_outage_s,
                }),
                imu: world.imu.then(|| Imu::new(world.seed, index)),
            },
        }
    }
}
