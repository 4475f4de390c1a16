//! The path of the rear axle: lanes on the right of each aisle, joined by smooth bends.
//!
//! Bends are quintic Bézier curves whose first and last three control points lie on the lanes,
//! so curvature is continuous and starts and ends at zero.

use super::CarPark;
use super::layout::{Layout, Node};
use crate::plane::{between, distance};
use crate::random::stream;
use crate::vehicle::{Path, PathPoint};
use Node::{Gate, NC, NE, NW, SC, SE, SW};
use rand::Rng;

/// Distance between samples of a path, metres.
const STEP_M: f64 = 0.02;
/// Distance from the aisle's centre line to its lanes, metres.
const LANE_M: f64 = 0.95;
/// A bend starts and ends this far from the lanes' meeting point, metres.
const BEND_M: f64 = 4.9;

/// Where one session drives.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// Nodes of the round trip, in order; after the last comes the first.
    pub cycle: Vec<Node>,
    /// Nodes on the way to the round trip: the gate and what is behind it, or the round trip's last.
    approach: Vec<Node>,
    /// Share of the first aisle that is left out.
    fraction: f64,
    /// Offset to the right of the usual lane, metres.
    pub offset_m: f64,
}

/// Figure of eight (west loop anticlockwise, east loop clockwise), then the ring clockwise.
const EIGHT_THEN_RING: [Node; 14] = [NC, NW, SW, SC, NC, NE, SE, SC, SW, NW, NC, NE, SE, SC];
/// The ring first, then the eight.
const RING_THEN_EIGHT: [Node; 14] = [SC, SW, NW, NC, NE, SE, SC, NC, NW, SW, SC, NC, NE, SE];
/// The other way round: the cross aisle southwards, the ring anticlockwise.
const OTHER_WAY: [Node; 14] = [NW, NC, SC, SE, NE, NC, NW, SW, SC, SE, NE, NC, SC, SW];
/// From the gate to the right, both directions mixed.
const MIXED: [Node; 14] = [SE, NE, NC, NW, SW, SC, NC, NE, SE, SC, SW, NW, NC, SC];

impl Route {
    /// The route of a session; 0 is the initial drive.
    pub fn of_session(world: &CarPark, session: usize) -> Self {
        let mut rng = stream(world.seed, "route", session as u64);
        let offset_m = if session == 0 {
            0.0
        } else {
            rng.random_range(-0.3..0.3)
        };
        let fraction = rng.random_range(0.36..0.5);
        let cycle = match session % 4 {
            0 => EIGHT_THEN_RING,
            1 => RING_THEN_EIGHT,
            2 => OTHER_WAY,
            _ => MIXED,
        };
        let (approach, fraction) = if session == 0 || session % 4 == 3 {
            (vec![Gate, SC], 0.0)
        } else {
            (vec![cycle[cycle.len() - 1]], fraction)
        };
        Self {
            cycle: cycle.to_vec(),
            approach,
            fraction,
            offset_m,
        }
    }

    /// The path of `loops` loops (two are the whole cycle and a little more) that starts `start_m`
    /// metres ahead on the round trip.
    pub fn path(&self, layout: &Layout, start_m: f64, loops: f64) -> Vec<PathPoint> {
        let one = self.corners(layout, 1);
        let cycle_m: f64 = one.windows(2).map(|pair| distance(pair[0], pair[1])).sum();
        let repeats = (loops / 2.0 + start_m / cycle_m).ceil() as usize + 1;
        let wanted_m = start_m + (0.5 * loops * cycle_m).max(2.0);
        let mut path = follow(&self.corners(layout, repeats), wanted_m).points;
        path.retain(|point| point.s >= start_m);
        let skipped = path.first().map_or(0.0, |point| point.s);
        for point in &mut path {
            point.s -= skipped;
        }
        path
    }

    /// Where the drive starts, and the meeting points of successive lanes after it.
    fn corners(&self, layout: &Layout, repeats: usize) -> Vec<[f64; 2]> {
        let lane = LANE_M + self.offset_m;
        let trips = std::iter::repeat_n(&self.cycle, repeats).flatten();
        let nodes = self.approach.iter().chain(trips);
        let places: Vec<[f64; 2]> = nodes.map(|node| layout.node(*node)).collect();
        let first = direction(places[0], places[1]);
        let way = distance(places[0], places[1]) * self.fraction;
        let mut corners = vec![[
            places[0][0] + way * first[0] + lane * first[1],
            places[0][1] + way * first[1] - lane * first[0],
        ]];
        for triple in places.windows(3) {
            let [a, b] = [0, 1].map(|k| direction(triple[k], triple[k + 1]));
            if a[0] * b[0] + a[1] * b[1] < 0.5 {
                corners.push([
                    triple[1][0] + lane * (a[1] + b[1]),
                    triple[1][1] - lane * (a[0] + b[0]),
                ]);
            }
        }
        corners
    }
}

/// Unit vector from `a` to `b`, snapped to the axes.
fn direction(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    if dx.abs() > dy.abs() {
        [dx.signum(), 0.0]
    } else {
        [0.0, dy.signum()]
    }
}

/// Draws straight lanes and bends until `wanted_m` are driven.
fn follow(corners: &[[f64; 2]], wanted_m: f64) -> Path {
    let mut path = Path::default();
    let mut at = corners[0];
    for k in 1..corners.len() {
        let vertex = corners[k];
        let a = direction(at, vertex);
        let bend_start = [vertex[0] - BEND_M * a[0], vertex[1] - BEND_M * a[1]];
        straight(at, bend_start, wanted_m, &mut path);
        let Some(next) = corners.get(k + 1) else {
            break;
        };
        let b = direction(vertex, *next);
        bend(vertex, a, b, wanted_m, &mut path);
        at = [vertex[0] + BEND_M * b[0], vertex[1] + BEND_M * b[1]];
        if path.length() >= wanted_m {
            break;
        }
    }
    path
}

fn straight(from: [f64; 2], to: [f64; 2], wanted_m: f64, path: &mut Path) {
    let along = direction(from, to);
    let steps = (distance(from, to) / STEP_M).ceil().max(1.0);
    for k in 0..steps as usize {
        if path.length() >= wanted_m {
            return;
        }
        let f = k as f64 / steps;
        path.push(between(from, to, f), along[1].atan2(along[0]), 0.0);
    }
}

fn bend(vertex: [f64; 2], a: [f64; 2], b: [f64; 2], wanted_m: f64, path: &mut Path) {
    let along = |d: [f64; 2], m: f64| [vertex[0] + m * d[0], vertex[1] + m * d[1]];
    let control = [
        along(a, -BEND_M),
        along(a, -0.68 * BEND_M),
        along(a, -0.36 * BEND_M),
        along(b, 0.36 * BEND_M),
        along(b, 0.68 * BEND_M),
        along(b, BEND_M),
    ];
    let steps = (1.7 * BEND_M / STEP_M) as usize;
    for k in 0..steps {
        if path.length() >= wanted_m {
            return;
        }
        let (p, d, dd) = bezier(&control, k as f64 / steps as f64);
        let speed = d[0].hypot(d[1]);
        let curvature = (d[0] * dd[1] - d[1] * dd[0]) / (speed * speed * speed);
        path.push(p, d[1].atan2(d[0]), curvature);
    }
}

/// Point, first and second derivative of a quintic Bézier curve.
fn bezier(control: &[[f64; 2]; 6], t: f64) -> ([f64; 2], [f64; 2], [f64; 2]) {
    let evaluate = |points: &[[f64; 2]]| -> [f64; 2] {
        let mut row = points.to_vec();
        for level in (1..row.len()).rev() {
            for i in 0..level {
                row[i] = between(row[i], row[i + 1], t);
            }
        }
        row[0]
    };
    let differences = |points: &[[f64; 2]], scale: f64| -> Vec<[f64; 2]> {
        points
            .windows(2)
            .map(|pair| [0, 1].map(|axis| scale * (pair[1][axis] - pair[0][axis])))
            .collect()
    };
    let first = differences(control, 5.0);
    let second = differences(&first, 4.0);
    (evaluate(control), evaluate(&first), evaluate(&second))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::car_park::layout::{AISLES, Rect};

    fn outside(rect: &Rect, point: &PathPoint, by: f64) -> bool {
        let r = Rect::new(rect.x0 - by, rect.y0 - by, rect.x1 + by, rect.y1 + by);
        let [x, y] = point.pose.at();
        x < r.x0 || x > r.x1 || y < r.y0 || y > r.y1
    }

    #[test]
    fn paths_are_smooth_and_hit_nothing() {
        let world = CarPark::default();
        let layout = Layout::new(&world);
        for session in 0..6 {
            let path = Route::of_session(&world, session).path(&layout, 0.0, 2.0);
            for pair in path.windows(2) {
                let step = pair[1].s - pair[0].s;
                assert!(step > 1e-4 && step < 2.0 * STEP_M, "{pair:?}");
                assert!(
                    (pair[1].pose.yaw - pair[0].pose.yaw).abs() < 0.02,
                    "{pair:?}"
                );
                assert!((pair[1].curvature - pair[0].curvature).abs() < 0.02);
            }
            for point in &path {
                assert!(point.curvature.abs() < 1.0 / 3.4, "{point:?}");
                for pillar in &layout.pillars {
                    assert!(outside(pillar, point, 0.95), "{point:?} {pillar:?}");
                }
                for bay in &layout.bays {
                    assert!(outside(&bay.rect, point, 0.4), "{point:?} {bay:?}");
                }
            }
        }
    }

    #[test]
    fn a_drive_that_starts_ahead_is_the_rest_of_the_usual_one() {
        let world = CarPark::default();
        let layout = Layout::new(&world);
        for session in 0..5 {
            let route = Route::of_session(&world, session);
            let whole = route.path(&layout, 0.0, 2.0);
            let rest = route.path(&layout, 70.0, 1.0);
            let first = whole.iter().find(|point| point.s >= 70.0).unwrap();
            assert_eq!((rest[0].s, rest[0].pose.at()), (0.0, first.pose.at()));
            let half = 0.5 * whole.last().unwrap().s;
            assert!((rest.last().unwrap().s - half).abs() < 0.2);
        }
    }

    #[test]
    fn every_session_drives_every_aisle() {
        let world = CarPark::default();
        let layout = Layout::new(&world);
        for session in 0..6 {
            let path = Route::of_session(&world, session).path(&layout, 0.0, 2.0);
            for (a, b) in AISLES.iter().filter(|(a, _)| *a != Gate) {
                let (a, b) = (layout.node(*a), layout.node(*b));
                let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
                let near = path
                    .iter()
                    .any(|point| distance(point.pose.at(), middle) < 1.5);
                assert!(near, "session {session} misses {middle:?}");
            }
        }
    }
}
