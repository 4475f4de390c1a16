//! What is built and planted along the street.

mod gardens;
mod houses;
mod kerb;

use crate::plane::Pose2;
use crate::random::stream;
use crate::street::course::Frenet;
use crate::street::ground::Land;
use crate::street::stretch::{Side, Stretch};
use crate::street::things::{Shape, Thing};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// All that stays.
#[derive(Debug, Clone, PartialEq)]
pub struct Town {
    /// Houses, trees, signs and the rest.
    pub things: Vec<Thing>,
    /// Where cars may stand.
    pub bays: Vec<Pose2>,
}

/// Builds a town, one stretch after the other.
struct Builder<'a> {
    land: &'a Land,
    /// For each cell of the course's map: something is built there.
    taken: Vec<bool>,
    town: Town,
    rng: ChaCha8Rng,
}

/// One side of a stretch that is being built.
#[derive(Clone, Copy)]
struct Lot<'a> {
    stretch: &'a Stretch,
    side: &'a Side,
    /// +1 left, −1 right.
    sign: f64,
}

impl Lot<'_> {
    /// Distance from the centre line to private ground, metres.
    fn front(&self) -> f64 {
        self.stretch.half_m + self.side.kerb_to_front()
    }

    /// The place `out` metres behind the kerb.
    fn beside_kerb(&self, s: f64, out: f64) -> Frenet {
        Frenet::new(
            s,
            self.sign * (self.stretch.half_m + self.side.parking_m + out),
        )
    }
}

impl Town {
    /// The town of a seed.
    pub fn new(seed: u64, land: &Land) -> Self {
        let mut builder = Builder {
            land,
            taken: vec![false; land.course.cells()],
            town: Self {
                things: Vec::new(),
                bays: Vec::new(),
            },
            rng: stream(seed, "town", 0),
        };
        builder.ends_of_side_streets();
        for stretch in &land.plan.stretches {
            for (side, sign) in stretch.sides.iter().zip([1.0, -1.0]) {
                let lot = Lot {
                    stretch,
                    side,
                    sign,
                };
                builder.houses(&lot);
                builder.kerb(&lot);
                builder.traffic_signs(&lot);
                builder.gardens(&lot);
            }
        }
        builder.town
    }
}

impl Builder<'_> {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.rng.random_range(low..high)
    }

    fn often(&mut self, chance: f64) -> bool {
        self.rng.random_bool(chance)
    }

    fn add(&mut self, pose: Pose2, shape: Shape) {
        let seed = self.rng.random();
        self.town.things.push(Thing { pose, shape, seed });
    }

    /// Points of a rectangle around a place, at most 1.5 m apart.
    fn footprint(middle: &Pose2, half: [f64; 2]) -> Vec<[f64; 2]> {
        let steps = half.map(|half| (2.0 * half / 1.5).ceil().max(1.0) as i32);
        let mut points = Vec::new();
        for i in 0..=steps[0] {
            for j in 0..=steps[1] {
                let a = half[0] * (2.0 * f64::from(i) / f64::from(steps[0]) - 1.0);
                let b = half[1] * (2.0 * f64::from(j) / f64::from(steps[1]) - 1.0);
                points.push(middle.point([a, b]));
            }
        }
        points
    }

    /// Whether a point is private, free, and off the streets.
    fn free(&self, point: [f64; 2], margin: f64) -> bool {
        let Some(place) = self.land.course.frenet(point) else {
            return true;
        };
        let stretch = self.land.stretch(place.s);
        let kerb = stretch.half_m + stretch.side(place).kerb_to_front();
        let private = place.d.abs() > kerb + margin - 0.4;
        let cell = self.land.course.cell(point);
        let taken = cell.is_some_and(|cell| self.taken[cell]);
        private && !taken && !self.land.in_side_street(place, 1.7 + margin)
    }

    fn take(&mut self, point: [f64; 2]) {
        if let Some(cell) = self.land.course.cell(point) {
            self.taken[cell] = true;
        }
    }
}
