//! What grows where nothing is built.

use super::{Builder, Lot};
use crate::plane::Pose2;
use crate::street::course::Frenet;
use crate::street::stretch::Quarter;
use crate::street::things::{Finish, Shape};
use rand::Rng;

impl Builder<'_> {
    /// Trees and bushes where nothing is built.
    pub(super) fn gardens(&mut self, lot: &Lot<'_>) {
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
            let place = Frenet::new(s, lot.sign * (lot.front() + lot.side.yard_m + out));
            let course = &self.land.course;
            let at = course.point(place);
            let found = course.frenet(at);
            let inside = found.is_some_and(|found| course.apart(found.s, s) < 8.0);
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
            self.add(Pose2::new(at, 0.0), shape);
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
        let shape = if hedge {
            Shape::Block(Finish::Leaves, [3.05, 0.4, 0.0, tall])
        } else {
            Shape::Block(Finish::Plain, [3.0, 0.05, 0.0, tall])
        };
        let mut s = lot.stretch.from + 3.0;
        while s + 3.0 < lot.stretch.to {
            let place = Frenet::new(s, lot.sign * (lot.front() + 0.5));
            let pose = self.land.course.pose(place);
            if self.free(pose.at(), 0.1) && self.often(0.93) {
                self.add(pose, shape);
            }
            s += 6.0;
        }
    }

    pub(super) fn tree(&mut self, species: u8, scale: f64) -> Shape {
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
