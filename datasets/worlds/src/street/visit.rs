//! One visit of the street: where it drives, when it looks, and what cars it meets.

use crate::drive::Drive;
use crate::ground::Ground;
use crate::odometry::{WheelErrors, Wheels, nanoseconds, normal};
use crate::random::stream;
use crate::route::PathPoint;
use crate::street::course::Place;
use crate::street::params::Street;
use crate::street::sight::Scenery;
use crate::street::things::Thing;
use crate::street::traffic::Traffic;
use evermap_algorithms::geometry::pose::Pose;
use rand::Rng;

/// Three years, ns.
const BETWEEN_NS: u64 = 3 * 365 * 86_400_000_000_000;
/// Distance between points of the path, metres.
const STEP_M: f64 = 0.25;

/// A visit, before anything is rendered.
pub struct Visit {
    /// Counted from 0.
    pub index: usize,
    /// `visit_a`, …
    pub name: String,
    /// When it starts, ns since the epoch.
    pub start_ns: u64,
    /// How it drives.
    pub drive: Drive,
    /// When panoramas are taken, ns since the epoch.
    pub stamps: Vec<u64>,
    /// Other road users.
    pub traffic: Traffic,
    /// What the wheels report.
    pub wheels: Wheels,
    /// Offset to the left of the usual line, metres.
    pub offset_m: f64,
}

impl Visit {
    /// A visit of a world.
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
        let drive = Drive::new(path, world.speed_mps, flat);
        let start_ns = world.start_ns + index as u64 * BETWEEN_NS;
        let stamps = (0..world.views())
            .map(|k| {
                let late = 3e-4 * normal(&mut rng).clamp(-3.0, 3.0);
                let t = drive.time_at((k as f64 + 0.02) * world.spacing_m);
                start_ns + nanoseconds(t + late)
            })
            .collect();
        Self {
            index,
            name: world
                .session_names()
                .get(index)
                .cloned()
                .unwrap_or_default(),
            start_ns,
            drive,
            stamps,
            traffic: Traffic::new(world, &scenery.land, &scenery.town, index),
            wheels: Wheels {
                seed: world.seed,
                session: index as u64,
                rate_hz: world.odometry_rate_hz,
                errors: WheelErrors::of_session(world.seed, index as u64, 0.0),
            },
            offset_m,
        }
    }

    /// Seconds since the visit's start.
    pub fn seconds(&self, stamp_ns: u64) -> f64 {
        stamp_ns.saturating_sub(self.start_ns) as f64 * 1e-9
    }

    /// `map_from_vehicle` of a shot.
    pub fn pose(&self, shot: usize) -> Pose {
        self.drive.map_from_vehicle(self.seconds(self.stamps[shot]))
    }

    /// The cars near enough to a shot to be seen.
    pub fn cars(&self, scenery: &Scenery, shot: usize) -> Vec<Thing> {
        let t = self.seconds(self.stamps[shot]);
        let at = self.drive.planar(t);
        let near = |car: &Thing| {
            let away = (car.at[0] - at.x).hypot(car.at[1] - at.y);
            away < car.sight() + 10.0
        };
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
    let at = |k: usize| {
        let s = begin + k as f64 * STEP_M;
        course.point(Place {
            s,
            d: -1.4 + offset_m,
        })
    };
    let mut path: Vec<PathPoint> = Vec::with_capacity(points);
    for k in 0..points {
        let [x, y] = at(k);
        let s = path
            .last()
            .map_or(0.0, |last| last.s + (x - last.x).hypot(y - last.y));
        let raw = course.yaw(begin + k as f64 * STEP_M);
        let before = path.last().map_or(raw, |last| last.yaw);
        let turn = (raw - before + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU);
        path.push(PathPoint {
            s,
            x,
            y,
            yaw: before + turn - std::f64::consts::PI,
            curvature: course.station(begin + k as f64 * STEP_M).curvature,
        });
        if s >= wanted {
            break;
        }
    }
    path
}
