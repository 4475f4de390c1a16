//! Houses, and what belongs to each.

use super::{Builder, Lot};
use crate::plane::Pose2;
use crate::random::maybe;
use crate::street::course::Frenet;
use crate::street::stretch::{Quarter, SIDE_STREET_M};
use crate::street::things::{Finish, Shape};
use rand::Rng;
use std::f64::consts::FRAC_PI_2;

impl Builder<'_> {
    /// Builds a house if there is room for it, its front at `place`.
    fn house(&mut self, place: Frenet, sizes: [f64; 4]) -> bool {
        let [a, b, ..] = sizes;
        let sign = place.d.signum();
        let course = &self.land.course;
        // A straight front on a bend: back until no corner stands on the street.
        let bend = (sign * course.station(place.s).curvature).min(0.0).abs();
        let back = b + bend * a * a * 0.5;
        let middle = course.pose(Frenet::new(place.s, place.d + sign * back));
        self.house_at(middle, sizes, 0.0)
    }

    /// Builds a house if there is room for it, and a margin (m) to the streets.
    fn house_at(&mut self, middle: Pose2, sizes: [f64; 4], margin: f64) -> bool {
        let points = Self::footprint(&middle, [sizes[0], sizes[1]]);
        let free = points.iter().all(|point| self.free(*point, margin));
        if free {
            points.into_iter().for_each(|point| self.take(point));
            self.add(middle, Shape::House(sizes));
        }
        free
    }

    /// A house across the end of each side street.
    pub(super) fn ends_of_side_streets(&mut self) {
        let land = self.land;
        for junction in &land.plan.junctions {
            for (arm, sign) in junction.arms.iter().zip([1.0, -1.0]) {
                if *arm && self.often(0.8) {
                    let d = sign * (SIDE_STREET_M + self.between(0.5, 2.0));
                    let a = junction.half_m + self.between(1.5, 6.0);
                    let wall = self.between(5.0, 13.0);
                    let roof = self.between(0.0, 4.0);
                    let middle = land.course.pose(Frenet::new(junction.s, d + sign * 2.5));
                    self.house_at(middle, [a, 2.5, wall, roof], -1.7);
                }
            }
        }
    }

    pub(super) fn houses(&mut self, lot: &Lot<'_>) {
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
            let place = Frenet::new(at + half, lot.sign * out);
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
                let roof = maybe(&mut self.rng, 0.6, 2.0..4.5);
                [half, self.between(4.0, 5.5), wall, roof]
            }
            Quarter::Villas => {
                let wall = 3.0 * self.between(1.0, 2.9).floor() + 0.6;
                let roof = maybe(&mut self.rng, 0.85, 2.2..4.8);
                [half, self.between(3.6, 5.2), wall, roof]
            }
            Quarter::Slabs => {
                let wall = 3.0 * storeys.max(3.0) + 4.0;
                [half, self.between(5.0, 6.5), wall, 0.0]
            }
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

    /// What belongs to one house: shop signs, hedges and walls along its garden, places for cars.
    fn front_of(&mut self, lot: &Lot<'_>, place: Frenet, half: f64, wall: f64) {
        let quarter = lot.side.quarter;
        let shop = match quarter {
            Quarter::Terraces => 0.3,
            Quarter::Shops => 0.9,
            Quarter::Slabs => 0.12,
            _ => 0.0,
        };
        if self.often(shop) {
            self.shop_sign(lot, place, half, wall);
        }
        let garden = place.d.abs() - lot.front();
        if quarter == Quarter::Shops {
            let bays = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|k: f64| 2.9 * k);
            for aside in bays.into_iter().filter(|aside| aside.abs() < half) {
                if lot.side.yard_m > 6.5 {
                    self.bay_before(lot, place.s + aside);
                }
            }
        } else if garden > 2.5 {
            self.garden_edge(lot, place.s, half);
            if quarter == Quarter::Villas && garden > 5.2 && self.often(0.5) {
                self.bay_before(lot, place.s);
            }
        }
    }

    fn shop_sign(&mut self, lot: &Lot<'_>, place: Frenet, half: f64, wall: f64) {
        let long = self.between(0.25, 0.7) * half;
        let aside = self.between(-0.5, 0.5) * (half - long);
        let tall = self.between(0.35, 0.8);
        let high = if lot.side.quarter == Quarter::Shops {
            wall - tall - 0.3
        } else {
            self.between(2.9, 3.3)
        };
        let station = Frenet::new(place.s + aside, place.d - lot.sign * 0.1);
        let course = &self.land.course;
        let sign = Pose2::new(course.point(station), course.yaw(place.s));
        let board = [long, 0.12, high, high + tall];
        self.add(sign, Shape::Block(Finish::Board, board));
    }

    /// A place for a car before the house, square to the street.
    fn bay_before(&mut self, lot: &Lot<'_>, s: f64) {
        let place = Frenet::new(s, lot.sign * (lot.front() + 2.9));
        self.town
            .bays
            .push(self.land.course.pose(place).turned(FRAC_PI_2));
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
            let (s, d) = (s + way * (1.2 + long), lot.sign * (lot.front() + 0.4));
            let course = &self.land.course;
            let ends = [-1.0, 0.0, 1.0].map(|end| course.point(Frenet::new(s + end * long, d)));
            if ends.iter().all(|end| self.free(*end, 0.1)) {
                let shape = if kind < 4 {
                    Shape::Block(Finish::Leaves, [long, 0.35, 0.0, tall])
                } else {
                    Shape::Block(Finish::Plain, [long, 0.1, 0.0, 0.7 * tall])
                };
                self.add(course.pose(Frenet::new(s, d)), shape);
            }
        }
    }
}
