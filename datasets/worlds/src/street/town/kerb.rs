//! What stands along the kerb: trees, lamps, furniture, signs, and places for cars.

use super::{Builder, Lot};
use crate::plane::Pose2;
use crate::street::things::{Finish, Shape};
use rand::Rng;
use std::f64::consts::{FRAC_PI_2, PI};

impl Builder<'_> {
    /// Trees, lamps, bins and car places along the kerb.
    pub(super) fn kerb(&mut self, lot: &Lot<'_>) {
        if lot.side.tree_step_m > 0.0 {
            self.street_trees(lot);
        }
        if lot.side.lamps {
            self.lamps(lot);
        }
        self.street_furniture(lot);
        if lot.side.parking_m > 0.0 {
            self.parking(lot);
        }
    }

    fn street_trees(&mut self, lot: &Lot<'_>) {
        let Lot { stretch, side, .. } = lot;
        let verge = side.verge_m;
        let out = if verge > 0.0 { 0.5 * verge } else { 0.6 };
        let mut s = stretch.from + 0.5 * side.tree_step_m;
        while s < stretch.to - 2.0 {
            let here = lot.beside_kerb(s + self.between(-0.5, 0.5), out);
            if !self.land.in_side_street(here, 2.0) && self.often(0.88) {
                let shape = self.tree(side.species, 0.8);
                self.add(Pose2::new(self.land.course.point(here), 0.0), shape);
            }
            s += side.tree_step_m;
        }
    }

    fn lamps(&mut self, lot: &Lot<'_>) {
        let step = self.between(22.0, 36.0);
        let mut s = lot.stretch.from + self.between(2.0, 12.0);
        while s < lot.stretch.to {
            let here = lot.beside_kerb(s, 0.35);
            if !self.land.in_side_street(here, 0.5) {
                let pose = self.land.course.pose(here).turned(-lot.sign * FRAC_PI_2);
                let shape = Shape::Lamp([self.between(4.5, 8.0), self.between(0.6, 1.8)]);
                self.add(pose, shape);
            }
            s += step;
        }
    }

    fn parking(&mut self, lot: &Lot<'_>) {
        let (land, stretch) = (self.land, lot.stretch);
        let turned = if lot.sign > 0.0 { PI } else { 0.0 };
        let mut s = stretch.from + 3.0;
        while s < stretch.to - 3.0 {
            let mut zebras = stretch.zebras.iter();
            let zebra = zebras.any(|z| land.course.apart(*z, s) < 5.0);
            if !zebra && !land.in_side_street(lot.beside_kerb(s, 1.0), 5.0) {
                let here = lot.beside_kerb(s, -0.5 * lot.side.parking_m);
                self.town.bays.push(land.course.pose(here).turned(turned));
            }
            s += 6.0;
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
            let place = lot.beside_kerb(s, out);
            if self.land.in_side_street(place, 1.0) {
                continue;
            }
            let size = match self.rng.random_range(0..4) {
                0 => [0.3, 0.28, 0.0, 1.0],
                1 => [0.9, 0.3, 0.0, 0.8],
                2 => [0.55, 0.3, 0.0, 1.4],
                _ => [1.3, 0.4, 0.0, 2.4],
            };
            self.add(
                self.land.course.pose(place),
                Shape::Block(Finish::Plain, size),
            );
        }
    }

    /// Traffic signs: at the stretch's end, and here and there.
    pub(super) fn traffic_signs(&mut self, lot: &Lot<'_>) {
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
            let place = lot.beside_kerb(s, 0.5);
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
            let turned = if lot.sign > 0.0 { 0.0 } else { PI };
            let pose = self.land.course.pose(place).turned(turned);
            self.add(pose, Shape::Post([half, tall, middle]));
        }
    }
}
