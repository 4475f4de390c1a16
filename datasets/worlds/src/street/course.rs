//! The street's centre line: a closed loop that winds through a town of any size.
//!
//! A tree grows at random over a coarse grid. Walking around it with the right hand on its trunk
//! visits every quarter of every cell once: a closed walk that never meets itself and leaves room
//! for houses on both sides. A cubic B-spline through the (displaced) quarters makes streets of it.

use crate::plane::{Pose2, between, distance};
use crate::random::stream;
use rand::Rng;
use std::collections::BTreeMap;

/// Wanted distance between neighbouring streets, metres.
const BLOCK_M: f64 = 80.0;
/// Distance between stations of the centre line, metres, about.
const STATION_M: f64 = 1.0;
/// Side of a cell of the map of nearest stations, metres.
pub const CELL_M: f64 = 2.0;
/// Beyond this distance from the centre line the map knows no station, metres.
const REACH_M: f64 = 46.0;

/// A place on the centre line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Station {
    /// Position, metres.
    pub at: [f64; 2],
    /// Direction of the street, unit vector.
    pub along: [f64; 2],
    /// Curvature, 1/m, positive to the left.
    pub curvature: f64,
}

/// A closed centre line, and for every place which part of it is nearest.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    /// Stations, equally far apart.
    pub stations: Vec<Station>,
    /// Length, metres.
    pub length_m: f64,
    corner: [f64; 2],
    size: [usize; 2],
    nearest: Vec<u32>,
}

/// A place given along and across the street: Frenet coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frenet {
    /// Distance along the centre line, metres.
    pub s: f64,
    /// Distance to the left of it, metres.
    pub d: f64,
}

impl Frenet {
    /// From both distances.
    pub fn new(s: f64, d: f64) -> Self {
        Self { s, d }
    }
}

impl Course {
    /// A course of a seed.
    pub fn new(seed: u64, length_m: f64) -> Self {
        let cells = ((length_m / (3.6 * BLOCK_M)).round() as usize).max(1);
        let mut rng = stream(seed, "course", 0);
        let mut corners = walk_around(&grown_tree(cells, &mut rng));
        for corner in &mut corners {
            for part in corner {
                *part += rng.random_range(-0.13..0.13);
            }
        }
        let line = spline(&corners);
        let unscaled = closed_length(&line);
        let line = line
            .iter()
            .map(|p| p.map(|part| part * length_m / unscaled));
        let mut course = Self {
            stations: stations(&line.collect::<Vec<_>>(), length_m),
            length_m,
            corner: [0.0; 2],
            size: [0; 2],
            nearest: Vec::new(),
        };
        course.survey();
        course
    }

    /// Distance between stations, metres.
    pub fn step_m(&self) -> f64 {
        self.length_m / self.stations.len() as f64
    }

    /// The point of the centre line at a distance along it, metres.
    pub fn station(&self, s: f64) -> Station {
        let count = self.stations.len();
        let place = s.rem_euclid(self.length_m) / self.step_m();
        let (a, f) = (place.floor() as usize % count, place.fract());
        let (a, b) = (&self.stations[a], &self.stations[(a + 1) % count]);
        let along = between(a.along, b.along, f);
        let norm = along[0].hypot(along[1]);
        Station {
            at: between(a.at, b.at, f),
            along: along.map(|part| part / norm),
            curvature: a.curvature + f * (b.curvature - a.curvature),
        }
    }

    /// The point at a place, metres.
    pub fn point(&self, place: Frenet) -> [f64; 2] {
        let Station { at, along, .. } = self.station(place.s);
        [at[0] - place.d * along[1], at[1] + place.d * along[0]]
    }

    /// Direction of the street, radians.
    pub fn yaw(&self, s: f64) -> f64 {
        let along = self.station(s).along;
        along[1].atan2(along[0])
    }

    /// The point at a place, and the direction of the street there.
    pub fn pose(&self, place: Frenet) -> Pose2 {
        Pose2::new(self.point(place), self.yaw(place.s))
    }

    /// Distance between two places along the loop, metres, the shorter way.
    pub fn apart(&self, a: f64, b: f64) -> f64 {
        let way = (a - b).rem_euclid(self.length_m);
        way.min(self.length_m - way)
    }

    /// Where a point is along and across the street; `None` far from it.
    pub fn frenet(&self, [x, y]: [f64; 2]) -> Option<Frenet> {
        let cell = self.cell([x, y])?;
        let index = *self.nearest.get(cell)?;
        let station = self.stations.get(index as usize)?;
        let (ex, ey) = (x - station.at[0], y - station.at[1]);
        let ahead = ex * station.along[0] + ey * station.along[1];
        let left = ey * station.along[0] - ex * station.along[1];
        // On the circle that the street is here.
        let bend = (1.0 - station.curvature * left).max(0.2);
        let s = f64::from(index) * self.step_m() + ahead / bend;
        Some(Frenet::new(
            s.rem_euclid(self.length_m),
            left - 0.5 * station.curvature * ahead * ahead / bend,
        ))
    }

    /// Index of the cell around a point, of [`Course::cells`].
    pub fn cell(&self, [x, y]: [f64; 2]) -> Option<usize> {
        let column = (x - self.corner[0]) / CELL_M;
        let row = (y - self.corner[1]) / CELL_M;
        let within = |at: f64, size: usize| (0.0..size as f64).contains(&at);
        let inside = within(column, self.size[0]) && within(row, self.size[1]);
        inside.then(|| row as usize * self.size[0] + column as usize)
    }

    /// Number of cells of the map of nearest stations.
    pub fn cells(&self) -> usize {
        self.nearest.len()
    }

    /// Fills the map of nearest stations.
    fn survey(&mut self) {
        let parts = |axis: usize| self.stations.iter().map(move |station| station.at[axis]);
        let low = [0, 1].map(|axis| parts(axis).fold(f64::MAX, f64::min) - REACH_M);
        let high = [0, 1].map(|axis| parts(axis).fold(f64::MIN, f64::max) + REACH_M);
        self.corner = low;
        self.size = [0, 1].map(|axis| ((high[axis] - low[axis]) / CELL_M).ceil() as usize + 1);
        self.nearest = vec![u32::MAX; self.size[0] * self.size[1]];
        let mut distance = vec![f32::MAX; self.nearest.len()];
        let reach = (REACH_M / CELL_M) as usize;
        for (index, station) in self.stations.iter().enumerate() {
            let own = [0, 1].map(|axis| ((station.at[axis] - low[axis]) / CELL_M) as usize);
            for row in own[1].saturating_sub(reach)..(own[1] + reach).min(self.size[1]) {
                for column in own[0].saturating_sub(reach)..(own[0] + reach).min(self.size[0]) {
                    let x = low[0] + (column as f64 + 0.5) * CELL_M - station.at[0];
                    let y = low[1] + (row as f64 + 0.5) * CELL_M - station.at[1];
                    let squared = (x * x + y * y) as f32;
                    let cell = row * self.size[0] + column;
                    if squared < distance[cell] {
                        distance[cell] = squared;
                        self.nearest[cell] = index as u32;
                    }
                }
            }
        }
    }
}

/// Cells of a tree that grew over the grid, each with the links to its neighbours (east, north,
/// west, south).
fn grown_tree(cells: usize, rng: &mut impl Rng) -> BTreeMap<[i32; 2], [bool; 4]> {
    let mut tree = BTreeMap::from([([0, 0], [false; 4])]);
    let mut grown = vec![[0, 0]];
    while tree.len() < cells {
        // Mostly from the youngest cell: long arms instead of a clump.
        let pick = if rng.random_bool(0.6) {
            grown.len() - 1
        } else {
            rng.random_range(0..grown.len())
        };
        let from = grown[pick];
        let way = rng.random_range(0..4);
        let to = beside(from, way);
        if tree.contains_key(&to) {
            let shut = (0..4).all(|way| tree.contains_key(&beside(from, way)));
            if shut {
                grown.swap_remove(pick);
            }
            continue;
        }
        if let Some(links) = tree.get_mut(&from) {
            links[way] = true;
        }
        let mut links = [false; 4];
        links[(way + 2) % 4] = true;
        tree.insert(to, links);
        grown.push(to);
    }
    tree
}

fn beside([x, y]: [i32; 2], way: usize) -> [i32; 2] {
    let [dx, dy] = [[1, 0], [0, 1], [-1, 0], [0, -1]][way];
    [x + dx, y + dy]
}

/// The quarters of the tree's cells in the order of a walk around it, anticlockwise.
fn walk_around(tree: &BTreeMap<[i32; 2], [bool; 4]>) -> Vec<[f64; 2]> {
    let Some((first, _)) = tree.first_key_value() else {
        return Vec::new();
    };
    // Quarters: 0 south-east, 1 north-east, 2 north-west, 3 south-west. From quarter q the walk
    // goes on in direction (q + 1) % 4, unless the tree goes that way out of the cell at q's side.
    let (mut cell, mut quarter) = (*first, 0_usize);
    let mut corners = Vec::with_capacity(4 * tree.len());
    loop {
        let (qx, qy) = [(0.5, 0.0), (0.5, 0.5), (0.0, 0.5), (0.0, 0.0)][quarter];
        corners.push([f64::from(cell[0]) + qx, f64::from(cell[1]) + qy]);
        let linked = tree.get(&cell).is_some_and(|links| links[quarter]);
        if linked {
            cell = beside(cell, quarter);
            quarter = (quarter + 3) % 4;
        } else {
            quarter = (quarter + 1) % 4;
        }
        if cell == *first && quarter == 0 {
            return corners;
        }
    }
}

/// A closed uniform cubic B-spline, finely sampled.
fn spline(corners: &[[f64; 2]]) -> Vec<[f64; 2]> {
    const FINE: usize = 256;
    let count = corners.len();
    let mut line = Vec::with_capacity(FINE * count);
    for k in 0..count {
        let p = [0, 1, 2, 3].map(|i| corners[(k + i) % count]);
        for step in 0..FINE {
            let t = step as f64 / FINE as f64;
            let (t2, t3) = (t * t, t * t * t);
            let weights = [
                (1.0 - 3.0 * t + 3.0 * t2 - t3) / 6.0,
                (4.0 - 6.0 * t2 + 3.0 * t3) / 6.0,
                (1.0 + 3.0 * t + 3.0 * t2 - 3.0 * t3) / 6.0,
                t3 / 6.0,
            ];
            line.push([0, 1].map(|axis| (0..4).map(|i| weights[i] * p[i][axis]).sum()));
        }
    }
    line
}

fn closed_length(line: &[[f64; 2]]) -> f64 {
    (0..line.len())
        .map(|k| distance(line[k], line[(k + 1) % line.len()]))
        .sum()
}

/// Stations equally far apart on a closed line.
fn stations(line: &[[f64; 2]], length_m: f64) -> Vec<Station> {
    let count = (length_m / STATION_M).round().max(8.0) as usize;
    let step = closed_length(line) / count as f64;
    let mut points: Vec<[f64; 2]> = Vec::with_capacity(count);
    let mut driven = 0.0;
    for k in 0..line.len() {
        let (a, b) = (line[k], line[(k + 1) % line.len()]);
        let long = distance(a, b);
        while points.len() < count && points.len() as f64 * step <= driven + long {
            let f = (points.len() as f64 * step - driven) / long.max(1e-12);
            points.push(between(a, b, f));
        }
        driven += long;
    }
    let count = points.len();
    let at = |k: usize| points[k % count];
    let way = |from: [f64; 2], to: [f64; 2]| [to[0] - from[0], to[1] - from[1]];
    let station = |k: usize| {
        let (before, here, after) = (at(k + count - 1), at(k), at(k + 1));
        let ([ax, ay], [bx, by]) = (way(before, here), way(here, after));
        let turn = (ax * by - ay * bx).atan2(ax * bx + ay * by);
        let norm = distance(before, after);
        Station {
            at: here,
            along: way(before, after).map(|part| part / norm),
            curvature: turn / (0.5 * (ax.hypot(ay) + bx.hypot(by))),
        }
    };
    (0..count).map(station).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn the_loop_closes_has_its_length_and_never_meets_itself() {
        for (seed, length_m) in [(1, 90.0), (2, 300.0), (3, 3000.0), (4, 12_000.0)] {
            let course = Course::new(seed, length_m);
            let line: Vec<[f64; 2]> = course.stations.iter().map(|s| s.at).collect();
            assert!((closed_length(&line) / length_m - 1.0).abs() < 2e-3);
            for (k, a) in line.iter().enumerate().step_by(7) {
                for (l, b) in line.iter().enumerate().step_by(7) {
                    let along =
                        course.apart(k as f64 * course.step_m(), l as f64 * course.step_m());
                    if length_m > 200.0 && along > 120.0 {
                        assert!(distance(*a, *b) > 35.0, "seed {seed}: {a:?} {b:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn places_and_points_are_inverse() {
        let course = Course::new(5, 1500.0);
        for k in 0..600 {
            let place = Frenet::new(f64::from(k) * 2.5 + 0.3, f64::from(k % 21) - 10.0);
            let found = course.frenet(course.point(place)).unwrap();
            assert!(course.apart(found.s, place.s) < 0.3, "{place:?} {found:?}");
            assert!((found.d - place.d).abs() < 0.1, "{place:?} {found:?}");
        }
    }
}
