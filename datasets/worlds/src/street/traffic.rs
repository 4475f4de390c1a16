//! The cars of one visit.

use super::course::Frenet;
use super::ground::Land;
use super::params::Street;
use super::things::{Shape, Thing};
use super::town::Town;
use crate::plane::Pose2;
use crate::random::stream;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

/// Share of the cars that drive.
const DRIVING: f64 = 0.06;
/// Share of the parked cars that stand in the same bay in every visit.
const RESIDENTS: f64 = 0.15;

/// Length, width, height (m), share of the length that the cabin takes.
const MODELS: [[f64; 4]; 6] = [
    [4.1, 1.75, 1.48, 0.62],
    [4.6, 1.82, 1.45, 0.55],
    [3.6, 1.65, 1.5, 0.66],
    [4.7, 1.88, 1.7, 0.7],
    [5.2, 1.98, 2.1, 0.78],
    [4.3, 1.8, 1.6, 0.66],
];

/// A car that drives towards the robot on the other lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Driver {
    s: f64,
    speed: f64,
    model: usize,
    seed: u32,
}

/// The cars of one visit.
#[derive(Debug, Clone, PartialEq)]
pub struct Traffic {
    /// Those that stand.
    pub parked: Vec<Thing>,
    /// Those that drive.
    pub drivers: Vec<Driver>,
}

impl Traffic {
    /// The cars of a visit.
    pub fn new(world: &Street, land: &Land, town: &Town, visit: usize) -> Self {
        let wanted = world.cars * 0.01 * land.course.length_m;
        let share = ((1.0 - DRIVING) * wanted / town.bays.len().max(1) as f64).clamp(0.0, 0.97);
        let mut residents = stream(world.seed, "residents", 0);
        let mut rng = stream(world.seed, "traffic", visit as u64);
        let mut parked = Vec::new();
        for bay in &town.bays {
            // Both are asked for every bay, so that one bay's fate changes no other's.
            let own = in_bay(bay, &mut residents);
            let stays = residents.random_bool(RESIDENTS * share);
            let other = in_bay(bay, &mut rng);
            let visited = rng.random_bool(share);
            parked.extend(stays.then_some(own).or(visited.then_some(other)));
        }
        let drivers = (0..(DRIVING * wanted).round() as usize)
            .map(|_| Driver {
                s: rng.random_range(0.0..land.course.length_m),
                speed: -rng.random_range(4.0..8.5),
                model: rng.random_range(0..MODELS.len()),
                seed: rng.random(),
            })
            .collect();
        Self { parked, drivers }
    }

    /// The driving cars, `t` seconds after the visit's start.
    pub fn driving<'a>(&'a self, land: &'a Land, t: f64) -> impl Iterator<Item = Thing> + 'a {
        self.drivers.iter().map(move |driver| {
            let s = (driver.s + driver.speed * t).rem_euclid(land.course.length_m);
            let d = 0.5 * land.stretch(s).half_m;
            let pose = land.course.pose(Frenet::new(s, d)).turned(PI);
            car(pose, driver.model, driver.seed)
        })
    }

    /// All cars at the visit's start, the parked ones first, and how fast each is (m/s).
    pub fn at_start<'a>(&'a self, land: &'a Land) -> impl Iterator<Item = (Thing, f64)> + 'a {
        let speeds = self.drivers.iter().map(|driver| driver.speed.abs());
        let parked = self.parked.iter().map(|car| (*car, 0.0));
        parked.chain(self.driving(land, 0.0).zip(speeds))
    }
}

fn car(pose: Pose2, model: usize, seed: u32) -> Thing {
    let shape = Shape::Car(MODELS[model]);
    Thing { pose, shape, seed }
}

/// A car as it might stand in a bay.
fn in_bay(bay: &Pose2, rng: &mut ChaCha8Rng) -> Thing {
    let (model, seed) = (rng.random_range(0..MODELS.len()), rng.random());
    let [ahead, left, turn] = [0.35, 0.12, 0.03].map(|most| rng.random_range(-most..most));
    let pose = Pose2::new(bay.point([ahead, left]), bay.yaw + turn);
    car(pose, model, seed)
}
