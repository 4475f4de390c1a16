//! The floor: cast concrete, its wear, and what is painted on it.

use super::CarPark;
use super::canvas::{Canvas, Octave, around, noise_at};
use super::layout::{
    AISLE_M, AISLES, BAY_DEPTH_M, Bay, LINE_M, Layout, NOSE_M, Node, Rect, runs_along_y,
};
use crate::plane::{Pose2, distance, heading};
use crate::random::stream;
use crate::vehicle::PathPoint;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Concrete: from cloudy patches down to the grain.
const CONCRETE: [Octave; 6] = [
    (6.1, 9.0),
    (1.7, 9.0),
    (0.53, 8.0),
    (0.17, 10.0),
    (0.055, 14.0),
    (0.021, 13.0),
];
const PAINT: f64 = 226.0;

/// The floor of the empty hall under even light; row 0 is south. `paths` leave tyre marks.
pub fn paint_floor(world: &CarPark, layout: &Layout, paths: &[&[PathPoint]]) -> Canvas {
    let mut canvas = Canvas::new(
        layout.width_m,
        layout.depth_m,
        world.floor_texels_per_m,
        112,
    );
    let mut rng = stream(world.seed, "floor", 0);
    canvas.add_noise(rng.random(), &CONCRETE);
    patches(&mut canvas, layout, &mut rng);
    grit(&mut canvas, layout, &mut rng);
    joints(&mut canvas, layout);
    cracks(&mut canvas, layout, &mut rng);
    let wear: u64 = rng.random();
    for bay in &layout.bays {
        bay_marking(&mut canvas, bay);
    }
    for island in &layout.islands {
        noses(&mut canvas, island);
    }
    for crossing in &layout.crossings {
        zebra(&mut canvas, &crossing.rect);
    }
    arrows(&mut canvas, layout);
    stop_lines(&mut canvas, layout);
    worn_paint(&mut canvas, layout, wear);
    for path in paths {
        tyre_marks(&mut canvas, path, &mut rng);
    }
    drains(&mut canvas, layout);
    stains(&mut canvas, layout, 90, &mut rng);
    canvas
}

/// Squares of younger or older concrete with a sawn edge.
fn patches(canvas: &mut Canvas, layout: &Layout, rng: &mut ChaCha8Rng) {
    let count = (layout.width_m * layout.depth_m / 35.0) as usize;
    for _ in 0..count {
        let [x, y] = somewhere(layout, rng);
        let (w, h) = (rng.random_range(0.4..2.6), rng.random_range(0.4..2.6));
        let grey = rng.random_range(70.0..165.0);
        canvas.fill([x, y, x + w, y + h], grey, rng.random_range(0.25..0.55));
        let corners = [[x, y], [x + w, y], [x + w, y + h], [x, y + h]];
        for k in 0..4 {
            canvas.line(corners[k], corners[(k + 1) % 4], 0.012, 45.0, 0.6);
        }
    }
}

/// Pits and pebbles.
fn grit(canvas: &mut Canvas, layout: &Layout, rng: &mut ChaCha8Rng) {
    let count = (layout.width_m * layout.depth_m * 45.0) as usize;
    for _ in 0..count {
        let [x, y] = somewhere(layout, rng);
        let radius = 0.005 + 0.02 * rng.random_range(0.0..1.0_f64).powi(3);
        let grey = if rng.random_bool(0.6) { 42.0 } else { 190.0 };
        canvas.disc([x, y], radius, grey, rng.random_range(0.4..0.9));
    }
}

/// The joints between slabs.
fn joints(canvas: &mut Canvas, layout: &Layout) {
    let (w, h) = (layout.width_m, layout.depth_m);
    let columns = (w / 5.6).round() as usize;
    for k in 1..columns {
        let x = k as f64 * w / columns as f64;
        canvas.line([x, 0.0], [x, h], 0.016, 50.0, 0.75);
    }
    let rows = (h / 5.2).round() as usize;
    for k in 1..rows {
        let y = k as f64 * h / rows as f64;
        canvas.line([0.0, y], [w, y], 0.016, 50.0, 0.75);
    }
}

fn cracks(canvas: &mut Canvas, layout: &Layout, rng: &mut ChaCha8Rng) {
    let count = (layout.width_m * layout.depth_m / 22.0) as usize;
    for _ in 0..count {
        let [mut x, mut y] = somewhere(layout, rng);
        let mut angle = rng.random_range(0.0..TAU);
        let grey = rng.random_range(35.0..70.0);
        for _ in 0..rng.random_range(8..40) {
            let step = rng.random_range(0.05..0.22);
            let to = [x + step * f64::cos(angle), y + step * f64::sin(angle)];
            canvas.line([x, y], to, rng.random_range(0.006..0.016), grey, 0.7);
            [x, y] = to;
            angle += rng.random_range(-0.6..0.6);
        }
    }
}

/// Lines on both sides of a bay, a bar at its end, and its label at the mouth.
fn bay_marking(canvas: &mut Canvas, bay: &Bay) {
    let Rect { x0, y0, x1, y1 } = bay.rect;
    let upright = runs_along_y(bay.entry_yaw);
    let sides = if upright {
        [([x0, y0], [x0, y1]), ([x1, y0], [x1, y1])]
    } else {
        [([x0, y0], [x1, y0]), ([x0, y1], [x1, y1])]
    };
    for (from, to) in sides {
        canvas.line(from, to, LINE_M, PAINT, 0.95);
    }
    let entry = bay.entry();
    let place = |along: f64, left: f64| entry.point([along - 0.5 * BAY_DEPTH_M, left]);
    canvas.line(place(4.7, -0.8), place(4.7, 0.8), 0.14, 185.0, 0.8);
    let size = 0.42;
    let half = 0.5 * size * 6.0 / 7.0 * bay.label.len() as f64;
    let at = Pose2::new(place(0.3, half), entry.yaw - FRAC_PI_2);
    canvas.text(&bay.label, at, size, PAINT, 0.9);
}

/// Diagonal hatching on the walkways at both ends of an island.
fn noses(canvas: &mut Canvas, island: &Rect) {
    for x0 in [island.x0, island.x1 - NOSE_M] {
        let (x1, y0, y1) = (x0 + NOSE_M, island.y0, island.y1);
        canvas.repaint([x0, y0, x1, y1], |x, y, old| {
            let edge = (x - x0).min(x1 - x).min(y - y0).min(y1 - y);
            let stripe = ((x + y) / 0.9).rem_euclid(1.0);
            if edge < LINE_M || stripe < 0.28 {
                old + 0.85 * (200.0 - old)
            } else {
                old
            }
        });
    }
}

/// Bars along the direction of travel, side by side across the aisle.
fn zebra(canvas: &mut Canvas, rect: &Rect) {
    let count = ((rect.y1 - rect.y0) / 1.0).round() as usize;
    let pitch = (rect.y1 - rect.y0) / count as f64;
    for k in 0..count {
        let y = rect.y0 + (k as f64 + 0.25) * pitch;
        canvas.fill([rect.x0, y, rect.x1, y + 0.5 * pitch], PAINT, 0.95);
    }
}

/// Two arrows on every aisle, one for each lane.
fn arrows(canvas: &mut Canvas, layout: &Layout) {
    for (from, to) in AISLES {
        let (a, b) = (layout.node(from), layout.node(to));
        let yaw = heading(a, b);
        let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        if from == Node::Gate {
            arrow(canvas, &Pose2::new([middle[0] + 1.0, middle[1]], yaw));
            continue;
        }
        for yaw in [yaw, yaw + PI] {
            let lane = Pose2::new(middle, yaw).point([1.3, -0.95]);
            arrow(canvas, &Pose2::new(lane, yaw));
        }
        dashes(canvas, a, b);
    }
}

fn arrow(canvas: &mut Canvas, at: &Pose2) {
    let shaft = [[-1.1, 0.0], [0.35, 0.0]].map(|place| at.point(place));
    canvas.line(shaft[0], shaft[1], 0.16, PAINT, 0.95);
    let head = [[0.3, -0.36], [1.1, 0.0], [0.3, 0.36]];
    canvas.polygon(&head.map(|place| at.point(place)), PAINT, 0.95);
}

/// The dashed line between the lanes of an aisle.
fn dashes(canvas: &mut Canvas, a: [f64; 2], b: [f64; 2]) {
    let length = distance(a, b);
    let unit = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
    let mut at = 4.2;
    while at + 1.0 < length - 4.0 {
        let from = [a[0] + at * unit[0], a[1] + at * unit[1]];
        let to = [from[0] + unit[0], from[1] + unit[1]];
        canvas.line(from, to, 0.1, PAINT, 0.85);
        at += 2.2;
    }
}

/// Where the cross aisle and the gate meet the others, one gives way.
fn stop_lines(canvas: &mut Canvas, layout: &Layout) {
    let reach = 0.5 * AISLE_M + 0.3;
    for (node, side) in [(Node::SC, 1.0), (Node::NC, -1.0), (Node::SC, -1.0)] {
        let [x, y] = layout.node(node);
        let y = y + side * reach;
        let [x0, x1] = if side > 0.0 { [-2.6, -0.2] } else { [0.2, 2.6] };
        canvas.line([x + x0, y], [x + x1, y], 0.3, PAINT, 0.9);
    }
}

/// Paint has gone where wheels and brooms went: bright texels fall back to concrete in spots.
fn worn_paint(canvas: &mut Canvas, layout: &Layout, seed: u64) {
    canvas.repaint([0.0, 0.0, layout.width_m, layout.depth_m], |x, y, old| {
        if old < 165.0 {
            return old;
        }
        let wear = 0.6 * noise_at(seed, x, y, 0.33)
            + 0.5 * noise_at(seed ^ 1, x, y, 0.06)
            + 0.25 * noise_at(seed ^ 2, x, y, 2.1);
        old - 75.0 * ((wear - 0.22) * 3.0).clamp(0.0, 1.0)
    });
}

/// Two dark tracks along where cars turn.
fn tyre_marks(canvas: &mut Canvas, path: &[PathPoint], rng: &mut ChaCha8Rng) {
    let every = 12;
    for offset in [-0.76, 0.76] {
        let shift = offset + rng.random_range(-0.1..0.1);
        let side = |point: &PathPoint| point.pose.point([0.0, shift]);
        let ends = path.iter().skip(every).step_by(every);
        for (from, to) in path.iter().step_by(every).zip(ends) {
            let alpha = (0.05 + 0.9 * from.curvature.abs()) * (0.6 + 0.4 * (0.21 * from.s).sin());
            canvas.line(side(from), side(to), 0.17, 52.0, alpha.clamp(0.0, 0.35));
        }
    }
}

/// Gratings in the middle of the aisles.
fn drains(canvas: &mut Canvas, layout: &Layout) {
    for node in [Node::SW, Node::SE, Node::NC, Node::SC] {
        let [x, y] = layout.node(node);
        canvas.fill([x - 0.3, y - 0.3, x + 0.3, y + 0.3], 60.0, 0.9);
        for k in 0..6 {
            let y = y - 0.25 + 0.1 * f64::from(k);
            canvas.line([x - 0.25, y], [x + 0.25, y], 0.03, 18.0, 0.95);
        }
    }
}

/// Oil and water, mostly where cars stand.
pub fn stains(canvas: &mut Canvas, layout: &Layout, count: usize, rng: &mut ChaCha8Rng) {
    for index in 0..count {
        let bays = &layout.bays;
        let [x, y] = match bays.get(rng.random_range(0..bays.len().max(1))) {
            Some(bay) if index % 3 != 0 => {
                let [x, y] = bay.rect.centre();
                let aside = rng.random_range(-1.0..1.0);
                [x + aside, y + rng.random_range(-1.5..1.5)]
            }
            _ => somewhere(layout, rng),
        };
        let radius = rng.random_range(0.06..0.45);
        let seed: u64 = rng.random();
        let grey = if rng.random_bool(0.8) { 38.0 } else { 160.0 };
        let alpha = rng.random_range(0.2..0.65);
        canvas.repaint(around(&[[x, y]], 1.5 * radius), |px, py, old| {
            let rim = radius * (1.0 + 0.4 * noise_at(seed, px, py, 0.6 * radius));
            let inside = (rim - (px - x).hypot(py - y)) / (0.35 * radius);
            old + (grey - old) * alpha * inside.clamp(0.0, 1.0)
        });
    }
}

fn somewhere(layout: &Layout, rng: &mut ChaCha8Rng) -> [f64; 2] {
    [layout.width_m, layout.depth_m].map(|side| rng.random_range(0.0..side))
}
