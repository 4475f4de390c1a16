//! What is built and planted along the street.

use crate::random::stream;
use crate::street::classes::Class;
use crate::street::course::Place;
use crate::street::ground::Land;
use crate::street::stretch::{Quarter, SIDE_STREET_M, Side, Stretch};
use crate::street::things::{Shape, Thing};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// A place where a car may stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bay {
    /// Its middle, metres.
    pub at: [f64; 2],
    /// Direction of a car in it, radians.
    pub yaw: f64,
}

/// All that stays.
#[derive(Debug, Clone, PartialEq)]
pub struct Town {
    /// Houses, trees, signs and the rest.
    pub things: Vec<Thing>,
    /// Where cars may stand.
    pub bays: Vec<Bay>,
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

    /// Distance from the centre line to the kerb, metres.
    fn kerb(&self) -> f64 {
        self.stretch.half_m + self.side.parking_m
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

    fn add(&mut self, at: [f64; 2], yaw: f64, shape: Shape, class: Class) {
        let seed = self.rng.random();
        self.town.things.push(Thing {
            at,
            yaw,
            shape,
            class,
            seed,
        });
    }

    /// Points of a rectangle around a place, at most 1.5 m apart.
    fn footprint(at: [f64; 2], yaw: f64, half: [f64; 2]) -> Vec<[f64; 2]> {
        let (sin, cos) = yaw.sin_cos();
        let steps = half.map(|half| (2.0 * half / 1.5).ceil().max(1.0) as i32);
        let mut points = Vec::new();
        for i in 0..=steps[0] {
            for j in 0..=steps[1] {
                let a = half[0] * (2.0 * f64::from(i) / f64::from(steps[0]) - 1.0);
                let b = half[1] * (2.0 * f64::from(j) / f64::from(steps[1]) - 1.0);
                points.push([at[0] + cos * a - sin * b, at[1] + sin * a + cos * b]);
            }
        }
        points
    }

    /// Whether a point is private, free, and off the streets.
    fn free(&self, point: [f64; 2], margin: f64) -> bool {
        let Some(place) = self.land.course.place(point) else {
            return true;
        };
        let stretch = self.land.stretch(place.s);
        let side = &stretch.sides[usize::from(place.d < 0.0)];
        let private = place.d.abs() > stretch.half_m + side.kerb_to_front() + margin - 0.4;
        let cell = self.land.course.cell(point);
        let taken = cell.is_some_and(|cell| self.taken[cell]);
        private && !taken && !self.land.in_side_street(place, 1.7 + margin)
    }

    fn take(&mut self, point: [f64; 2]) {
        if let Some(cell) = self.land.course.cell(point) {
            self.taken[cell] = true;
        }
    }

    /// Builds a house if there is room for it, its front at `place`.
    fn house(&mut self, place: Place, sizes: [f64; 4]) -> bool {
        let [a, b, ..] = sizes;
        let sign = place.d.signum();
        let course = &self.land.course;
        let station = course.station(place.s);
        // A straight front on a bend: back until no corner stands on the street.
        let inward = (sign * station.curvature).min(0.0).abs() * a * a * 0.5;
        let middle = Place {
            s: place.s,
            d: place.d + sign * (b + inward),
        };
        let (at, yaw) = (course.point(middle), course.yaw(place.s));
        let points = Self::footprint(at, yaw, [a, b]);
        if !points.iter().all(|point| self.free(*point, 0.0)) {
            return false;
        }
        for point in points {
            self.take(point);
        }
        self.add(at, yaw, Shape::House(sizes), Class::Building);
        true
    }

    /// A house across the end of each side street.
    fn ends_of_side_streets(&mut self) {
        let land = self.land;
        for junction in &land.plan.junctions {
            for (arm, sign) in junction.arms.iter().zip([1.0, -1.0]) {
                if *arm && self.often(0.8) {
                    let d = sign * (SIDE_STREET_M + self.between(0.5, 2.0));
                    let a = junction.half_m + self.between(1.5, 6.0);
                    let wall = self.between(5.0, 13.0);
                    let roof = self.between(0.0, 4.0);
                    let place = Place { s: junction.s, d };
                    let course = &land.course;
                    let middle = Place {
                        d: d + sign * 2.5,
                        ..place
                    };
                    let (at, yaw) = (course.point(middle), course.yaw(junction.s));
                    let points = Self::footprint(at, yaw, [a, 2.5]);
                    if points.iter().all(|point| self.free(*point, -1.7)) {
                        points.into_iter().for_each(|point| self.take(point));
                        self.add(at, yaw, Shape::House([a, 2.5, wall, roof]), Class::Building);
                    }
                }
            }
        }
    }

    fn houses(&mut self, lot: &Lot<'_>) {
        let quarter = lot.side.quarter;
        if matches!(quarter, Quarter::Park | Quarter::Meadow) {
            return;
        }
        let mut storeys = self.between(2.0, 6.5).floor();
        let lawn = match quarter {
            Quarter::Villas => self.between(3.0, 8.0),
            Quarter::Slabs => self.between(4.0, 11.0),
            _ => 0.0,
        };
        let mut at = lot.stretch.from;
        while at < lot.stretch.to {
            let half = match quarter {
                Quarter::Terraces => self.between(3.0, 7.5),
                Quarter::Villas => self.between(3.8, 6.8),
                Quarter::Slabs => self.between(8.0, 18.0),
                _ => self.between(7.0, 15.0),
            };
            if self.often(0.35) {
                storeys = self.between(2.0, 6.5).floor();
            }
            let sizes = self.sizes(quarter, half, storeys);
            let back = if quarter == Quarter::Villas {
                self.between(0.0, 2.5)
            } else {
                0.0
            };
            let out = lot.front() + lot.side.yard_m + lawn + back + 0.2;
            let place = Place {
                s: at + half,
                d: lot.sign * out,
            };
            let beyond = at + 2.0 * half > lot.stretch.to + 3.0;
            if beyond || !self.house(place, sizes) {
                at += 3.0;
                continue;
            }
            self.front_of(lot, place, half, sizes[2]);
            at += 2.0 * half + self.gap(quarter);
        }
    }

    fn sizes(&mut self, quarter: Quarter, half: f64, storeys: f64) -> [f64; 4] {
        match quarter {
            Quarter::Terraces => {
                let wall = 3.1 * storeys + self.between(0.0, 1.0);
                let roof = if self.often(0.6) {
                    self.between(2.0, 4.5)
                } else {
                    0.0
                };
                [half, self.between(4.0, 5.5), wall, roof]
            }
            Quarter::Villas => {
                let wall = 3.0 * self.between(1.0, 2.9).floor() + 0.6;
                let roof = if self.often(0.85) {
                    self.between(2.2, 4.8)
                } else {
                    0.0
                };
                [half, self.between(3.6, 5.2), wall, roof]
            }
            Quarter::Slabs => [
                half,
                self.between(5.0, 6.5),
                3.0 * storeys.max(3.0) + 4.0,
                0.0,
            ],
            _ => [half, self.between(6.0, 8.0), self.between(4.2, 8.5), 0.0],
        }
    }

    fn gap(&mut self, quarter: Quarter) -> f64 {
        match quarter {
            Quarter::Terraces if self.often(0.82) => 0.0,
            Quarter::Terraces => self.between(2.5, 7.0),
            Quarter::Villas => self.between(3.0, 12.0),
            Quarter::Slabs => self.between(9.0, 22.0),
            _ => self.between(5.0, 18.0),
        }
    }

    /// What belongs to one house: shop signs, boards, hedges and walls along its garden, a car
    /// place.
    fn front_of(&mut self, lot: &Lot<'_>, place: Place, half: f64, wall: f64) {
        let quarter = lot.side.quarter;
        let shop = match quarter {
            Quarter::Terraces => 0.3,
            Quarter::Shops => 0.9,
            Quarter::Slabs => 0.12,
            _ => 0.0,
        };
        let land = self.land;
        if self.often(shop) {
            let long = self.between(0.25, 0.7) * half;
            let aside = self.between(-0.5, 0.5) * (half - long);
            let tall = self.between(0.35, 0.8);
            let high = if quarter == Quarter::Shops {
                wall - tall - 0.3
            } else {
                self.between(2.9, 3.3)
            };
            let station = Place {
                s: place.s + aside,
                d: place.d - lot.sign * 0.1,
            };
            let shape = Shape::Block([long, 0.12, high, high + tall]);
            let (at, yaw) = (land.course.point(station), land.course.yaw(place.s));
            self.add(at, yaw, shape, Class::Sign);
        }
        let garden = place.d.abs() - lot.front();
        if garden > 2.5 && quarter != Quarter::Shops {
            self.garden_edge(lot, place.s, half);
            if quarter == Quarter::Villas && garden > 5.2 && self.often(0.5) {
                let d = lot.sign * (lot.front() + 2.8);
                let at = land.course.point(Place { s: place.s, d });
                let yaw = land.course.yaw(place.s) + std::f64::consts::FRAC_PI_2;
                self.town.bays.push(Bay { at, yaw });
            }
        }
        if quarter == Quarter::Shops {
            for k in -2..=2 {
                let s = place.s + 2.9 * f64::from(k);
                let d = lot.sign * (lot.front() + 2.9);
                if f64::from(k).abs() * 2.9 < half && lot.side.yard_m > 6.5 {
                    let at = land.course.point(Place { s, d });
                    let yaw = land.course.yaw(s) + std::f64::consts::FRAC_PI_2;
                    self.town.bays.push(Bay { at, yaw });
                }
            }
        }
    }

    /// A hedge, a wall or nothing along the front of a garden, with a gap for the door.
    fn garden_edge(&mut self, lot: &Lot<'_>, s: f64, half: f64) {
        let kind = self.rng.random_range(0..10);
        if kind >= 7 {
            return;
        }
        let tall = self.between(0.7, 1.9);
        for way in [-1.0, 1.0] {
            let long = 0.5 * (half - 1.2);
            let place = Place {
                s: s + way * (1.2 + long),
                d: lot.sign * (lot.front() + 0.4),
            };
            let at = self.land.course.point(place);
            let yaw = self.land.course.yaw(place.s);
            let ends = [-1.0, 0.0, 1.0].map(|end| {
                self.land.course.point(Place {
                    s: place.s + end * long,
                    d: place.d,
                })
            });
            if !ends.iter().all(|end| self.free(*end, 0.1)) {
                continue;
            }
            if kind < 4 {
                self.add(at, yaw, Shape::Hedge([long, 0.35, tall]), Class::Tree);
            } else {
                let shape = Shape::Block([long, 0.1, 0.0, 0.7 * tall]);
                self.add(at, yaw, shape, Class::Other);
            }
        }
    }

    /// Trees, lamps, bins and car places along the kerb.
    fn kerb(&mut self, lot: &Lot<'_>) {
        let Lot { stretch, side, .. } = lot;
        let (kerb, land) = (lot.kerb(), self.land);
        let place = |s: f64, out: f64| Place {
            s,
            d: lot.sign * (kerb + out),
        };
        if side.tree_step_m > 0.0 {
            let out = if side.verge_m > 0.0 {
                0.5 * side.verge_m
            } else {
                0.6
            };
            let mut s = stretch.from + 0.5 * side.tree_step_m;
            while s < stretch.to - 2.0 {
                let here = place(s + self.between(-0.5, 0.5), out);
                if !land.in_side_street(here, 2.0) && self.often(0.88) {
                    let shape = self.tree(side.species, 0.8);
                    self.add(land.course.point(here), 0.0, shape, Class::Tree);
                }
                s += side.tree_step_m;
            }
        }
        let step = self.between(22.0, 36.0);
        let mut s = stretch.from + self.between(2.0, 12.0);
        while side.lamps && s < stretch.to {
            let here = place(s, 0.35);
            if !land.in_side_street(here, 0.5) {
                let yaw = land.course.yaw(s) - lot.sign * std::f64::consts::FRAC_PI_2;
                let shape = Shape::Lamp([self.between(4.5, 8.0), self.between(0.6, 1.8)]);
                self.add(land.course.point(here), yaw, shape, Class::Other);
            }
            s += step;
        }
        self.street_furniture(lot);
        if side.parking_m > 0.0 {
            let mut s = stretch.from + 3.0;
            while s < stretch.to - 3.0 {
                let here = place(s, -0.5 * side.parking_m);
                let zebra = stretch
                    .zebras
                    .iter()
                    .any(|z| land.course.apart(*z, s) < 5.0);
                if !zebra && !land.in_side_street(place(s, 1.0), 5.0) {
                    let yaw = land.course.yaw(s)
                        + if lot.sign > 0.0 {
                            std::f64::consts::PI
                        } else {
                            0.0
                        };
                    self.town.bays.push(Bay {
                        at: land.course.point(here),
                        yaw,
                    });
                }
                s += 6.0;
            }
        }
    }

    /// Bins, boxes, bollards and benches on the sidewalk.
    fn street_furniture(&mut self, lot: &Lot<'_>) {
        let long = lot.stretch.to - lot.stretch.from;
        for _ in 0..(long / 16.0) as usize {
            if lot.side.walk_m == 0.0 || self.often(0.4) {
                continue;
            }
            let s = lot.stretch.from + self.between(0.0, long);
            let out = lot.side.verge_m + lot.side.walk_m - 0.35;
            let place = Place {
                s,
                d: lot.sign * (lot.kerb() + out),
            };
            if self.land.in_side_street(place, 1.0) {
                continue;
            }
            let size = match self.rng.random_range(0..4) {
                0 => [0.3, 0.28, 0.0, 1.0],
                1 => [0.9, 0.3, 0.0, 0.8],
                2 => [0.55, 0.3, 0.0, 1.4],
                _ => [1.3, 0.4, 0.0, 2.4],
            };
            let at = self.land.course.point(place);
            let yaw = self.land.course.yaw(s);
            self.add(at, yaw, Shape::Block(size), Class::Other);
        }
    }

    /// Traffic signs: at the stretch's end, and here and there.
    fn traffic_signs(&mut self, lot: &Lot<'_>) {
        let long = lot.stretch.to - lot.stretch.from;
        let mut spots = Vec::new();
        if self.often(0.7) {
            spots.push(if lot.sign < 0.0 { long - 5.5 } else { 5.5 });
        }
        for zebra in &lot.stretch.zebras {
            spots.push(zebra - lot.stretch.from + 2.2 * lot.sign);
        }
        for _ in 0..(long / 35.0) as usize {
            if self.often(0.5) {
                spots.push(self.between(0.0, long));
            }
        }
        for spot in spots {
            let s = lot.stretch.from + spot;
            let place = Place {
                s,
                d: lot.sign * (lot.kerb() + 0.5),
            };
            if self.land.in_side_street(place, 0.3) {
                continue;
            }
            let (half, tall, middle) = match self.rng.random_range(0..10) {
                0..6 => (0.36, 0.36, 2.4),
                6..8 => (0.45, 0.65, 2.3),
                8 => (1.1, 0.55, 2.9),
                _ => (1.6, 1.1, 3.4),
            };
            // Seen by those who drive on this side.
            let yaw = self.land.course.yaw(s)
                + if lot.sign > 0.0 {
                    0.0
                } else {
                    std::f64::consts::PI
                };
            let at = self.land.course.point(place);
            self.add(at, yaw, Shape::Post([half, tall, middle]), Class::Sign);
        }
    }

    /// Trees and bushes where nothing is built.
    fn gardens(&mut self, lot: &Lot<'_>) {
        let long = lot.stretch.to - lot.stretch.from;
        let per_metre = match lot.side.quarter {
            Quarter::Terraces => 0.03,
            Quarter::Villas => 0.16,
            Quarter::Slabs => 0.13,
            Quarter::Shops => 0.05,
            Quarter::Park => 0.55,
            Quarter::Meadow => 0.05,
        };
        let density = per_metre * self.between(0.5, 1.5);
        let mixed = self.rng.random_range(0..5);
        for _ in 0..(density * long).round() as usize {
            let s = lot.stretch.from + self.between(0.0, long);
            let out = self.between(1.2, 30.0);
            let place = Place {
                s,
                d: lot.sign * (lot.front() + lot.side.yard_m + out),
            };
            let at = self.land.course.point(place);
            let inside = self
                .land
                .course
                .place(at)
                .is_some_and(|found| self.land.course.apart(found.s, s) < 8.0);
            if !inside || !self.free(at, 0.8) {
                continue;
            }
            self.take(at);
            let species = if self.often(0.7) {
                mixed
            } else {
                self.rng.random_range(0..5)
            };
            let shape = if out < 12.0 && self.often(0.35) {
                Shape::Bush([self.between(0.8, 2.4), self.between(0.6, 1.8)])
            } else {
                self.tree(species, 1.0)
            };
            self.add(at, 0.0, shape, Class::Tree);
        }
        let fence = lot.side.quarter == Quarter::Meadow || lot.side.quarter == Quarter::Park;
        if fence && self.often(0.5) {
            self.long_edge(lot);
        }
    }

    /// A hedge or fence along a park or meadow.
    fn long_edge(&mut self, lot: &Lot<'_>) {
        let hedge = self.often(0.5);
        let tall = self.between(0.8, 1.8);
        let mut s = lot.stretch.from + 3.0;
        while s + 3.0 < lot.stretch.to {
            let place = Place {
                s,
                d: lot.sign * (lot.front() + 0.5),
            };
            let at = self.land.course.point(place);
            if self.free(at, 0.1) && self.often(0.93) {
                let yaw = self.land.course.yaw(s);
                if hedge {
                    self.add(at, yaw, Shape::Hedge([3.05, 0.4, tall]), Class::Tree);
                } else {
                    self.add(at, yaw, Shape::Block([3.0, 0.05, 0.0, tall]), Class::Other);
                }
            }
            s += 6.0;
        }
    }

    fn tree(&mut self, species: u8, scale: f64) -> Shape {
        let size = scale * self.between(0.75, 1.25);
        match species {
            0 => Shape::Broadleaf([9.0 * size, 3.2 * size, 2.4]),
            1 => Shape::Broadleaf([12.5 * size, 4.0 * size, 3.0]),
            2 => Shape::Broadleaf([6.0 * size, 2.0 * size, 2.0]),
            3 => Shape::Poplar([14.0 * size, 1.5 * size]),
            _ => Shape::Conifer([11.0 * size, 2.7 * size]),
        }
    }
}
