//! One visit of the street: where it drives, when it looks, and what cars it meets.

use super::course::Frenet;
use super::params::Street;
use super::sight::Scenery;
use super::things::Thing;
use super::traffic::Traffic;
use crate::plane::distance;
use crate::random::stream;
use crate::record::{SimulatedSession, shutter};
use crate::vehicle::{Ground, Path, PathPoint, Trajectory, Wheels};
use rand::Rng;

/// Three years, ns.
const BETWEEN_NS: u64 = 3 * 365 * 86_400_000_000_000;
/// Distance between points of the path, metres.
const STEP_M: f64 = 0.25;

/// A session before it is rendered.
pub struct Visit {
    /// The drive.
    pub session: SimulatedSession,
    /// Other road users.
    pub traffic: Traffic,
    /// Offset to the left of the usual line, metres.
    pub offset_m: f64,
}

impl AsRef<SimulatedSession> for Visit {
    fn as_ref(&self) -> &SimulatedSession {
        &self.session
    }
}

impl Visit {
    /// The visit of this number: `visit_a`, `visit_b`, …
    pub fn new(world: &Street, scenery: &Scenery, index: usize) -> Self {
        let mut rng = stream(world.seed, "visit", index as u64);
        let side = if index.is_multiple_of(2) { 1.0 } else { -1.0 };
        let offset_m = side * rng.random_range(0.07..0.23);
        let begin = rng.random_range(-1.0..1.0) + if index == 0 { 0.0 } else { 0.5 };
        let path = path(world, scenery, begin, offset_m);
        let flat = Ground {
            drain_y: 0.0,
            slope: 0.0,
        };
        let drive = Trajectory::new(path, world.speed_mps, flat);
        let start_ns = world.start_ns + index as u64 * BETWEEN_NS;
        let seconds = |k: usize| drive.time_at((k as f64 + 0.02) * world.spacing_m);
        let stamps = (0..world.views())
            .map(|k| shutter(start_ns, seconds(k), &mut rng))
            .collect();
        let letter = char::from(b'a' + index as u8);
        Self {
            traffic: Traffic::new(world, &scenery.land, &scenery.town, index),
            offset_m,
            session: SimulatedSession {
                seed: world.seed,
                index,
                name: format!("visit_{letter}"),
                start_ns,
                drive,
                stamps,
                wheels: Wheels::new(world.odometry_rate_hz, world.seed, index, 0.0),
                receiver: None,
                imu: None,
            },
        }
    }

    /// The cars near enough to be seen at a stamp, ns since the epoch.
    pub fn cars(&self, scenery: &Scenery, stamp_ns: u64) -> Vec<Thing> {
        let t = self.session.seconds(stamp_ns);
        let at = self.session.drive.motion(t).pose.at();
        let near = |car: &Thing| distance(at, car.pose.at()) < car.sight() + 10.0;
        let parked = self.traffic.parked.iter().copied();
        let driving = self.traffic.driving(&scenery.land, t);
        parked.chain(driving).filter(near).collect()
    }
}

/// Once around the loop on the right lane and a little more.
fn path(world: &Street, scenery: &Scenery, begin: f64, offset_m: f64) -> Vec<PathPoint> {
    let course = &scenery.land.course;
    let wanted = world.views() as f64 * world.spacing_m + 1.0;
    let points = (wanted / STEP_M).ceil() as usize * 13 / 10 + 8;
    let mut path = Path::default();
    for k in 0..points {
        let s = begin + k as f64 * STEP_M;
        let pose = course.pose(Frenet::new(s, -1.4 + offset_m));
        path.push(pose.at(), pose.yaw, course.station(s).curvature);
        if path.length() >= wanted {
            break;
        }
    }
    path.points
}
