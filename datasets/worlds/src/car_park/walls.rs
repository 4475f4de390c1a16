//! Walls, pillars, beams and the ceiling.

use super::canvas::{Canvas, Octave};
use super::layout::{CEILING_M, Layout};
use super::lighting::Lighting;
use crate::plane::Pose2;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

const WALL_NOISE: [Octave; 5] = [
    (3.1, 10.0),
    (0.9, 9.0),
    (0.27, 8.0),
    (0.09, 8.0),
    (0.03, 7.0),
];
const CEILING_NOISE: [Octave; 3] = [(4.0, 8.0), (0.9, 8.0), (0.2, 8.0)];
/// Texels per metre of walls.
pub const WALL_SCALE: f64 = 110.0;
/// Texels per metre of the ceiling.
pub const CEILING_SCALE: f64 = 50.0;

/// A wall of this length, seen from inside: columns run to the viewer's right, rows up from the
/// floor.
pub fn paint_wall(length_m: f64, name: char, rng: &mut ChaCha8Rng) -> Canvas {
    let mut wall = Canvas::new(length_m, CEILING_M, WALL_SCALE, 142);
    wall.add_noise(rng.random(), &WALL_NOISE);
    formwork(&mut wall, length_m);
    wall.fill([0.0, 0.0, length_m, 0.95], 88.0, 0.6);
    wall.fill([0.0, 0.95, length_m, 1.07], 205.0, 0.85);
    wall.fill([0.0, 0.0, length_m, 0.1], 50.0, 0.7);
    let mut at = rng.random_range(0.4..1.4);
    let mut number = 1;
    while at + 2.4 < length_m {
        at += match rng.random_range(0..7) {
            0 => sign(&mut wall, at, &format!("{name}{number}"), rng),
            1 => door(&mut wall, at, rng),
            2 => vent(&mut wall, at),
            3 => hose_box(&mut wall, at),
            4 => graffiti(&mut wall, at, rng),
            _ => poster(&mut wall, at, rng),
        };
        at += rng.random_range(0.5..2.2);
        number += 1;
    }
    pipes(&mut wall, length_m, rng);
    drips(&mut wall, length_m, rng);
    wall
}

/// Panel joints and tie holes left by the casting.
fn formwork(wall: &mut Canvas, length_m: f64) {
    let panels = (length_m / 2.5).ceil() as usize;
    for k in 0..panels {
        let x = 2.5 * k as f64;
        wall.line([x, 0.0], [x, CEILING_M], 0.015, 95.0, 0.8);
        for (dx, y) in [
            (0.6, 0.5),
            (1.9, 0.5),
            (0.6, 1.5),
            (1.9, 1.5),
            (0.6, 2.4),
            (1.9, 2.4),
        ] {
            wall.disc([x + dx, y], 0.025, 60.0, 0.9);
        }
    }
    wall.line([0.0, 1.45], [length_m, 1.45], 0.012, 100.0, 0.7);
}

fn sign(wall: &mut Canvas, x: f64, text: &str, rng: &mut ChaCha8Rng) -> f64 {
    let width = 0.75 + 0.5 * text.len() as f64;
    let dark = rng.random_bool(0.5);
    let (back, front) = if dark { (35.0, 235.0) } else { (230.0, 30.0) };
    wall.fill([x, 1.2, x + width, 2.2], back, 1.0);
    wall.fill([x + 0.04, 1.24, x + width - 0.04, 1.3], front, 1.0);
    let at = Pose2::new([x + 0.3, 1.4], 0.0);
    wall.text(text, at, 0.65, front, 1.0);
    width
}

fn door(wall: &mut Canvas, x: f64, rng: &mut ChaCha8Rng) -> f64 {
    let grey = rng.random_range(60.0..200.0);
    wall.fill([x - 0.06, 0.0, x + 1.06, 2.12], 40.0, 1.0);
    wall.fill([x, 0.02, x + 1.0, 2.06], grey, 1.0);
    wall.disc([x + 0.9, 1.0], 0.04, 230.0, 1.0);
    wall.fill([x + 0.25, 1.4, x + 0.75, 1.85], 25.0, 1.0);
    wall.fill([x + 0.2, 2.2, x + 0.8, 2.45], 240.0, 1.0);
    let at = Pose2::new([x + 0.24, 2.25], 0.0);
    wall.text("EXIT", at, 0.15, 40.0, 1.0);
    1.1
}

fn vent(wall: &mut Canvas, x: f64) -> f64 {
    wall.fill([x, 1.75, x + 1.2, 2.3], 185.0, 1.0);
    for k in 0..7 {
        let y = 1.81 + 0.07 * f64::from(k);
        wall.line([x + 0.06, y], [x + 1.14, y], 0.03, 45.0, 1.0);
    }
    1.2
}

fn hose_box(wall: &mut Canvas, x: f64) -> f64 {
    wall.fill([x, 0.75, x + 0.75, 1.55], 70.0, 1.0);
    wall.fill([x + 0.05, 0.8, x + 0.7, 1.5], 105.0, 1.0);
    wall.disc([x + 0.375, 1.15], 0.26, 215.0, 1.0);
    wall.disc([x + 0.375, 1.15], 0.19, 90.0, 1.0);
    wall.disc([x + 0.375, 1.15], 0.07, 220.0, 1.0);
    0.75
}

fn graffiti(wall: &mut Canvas, x: f64, rng: &mut ChaCha8Rng) -> f64 {
    let mut from = [x + 0.2, 1.3];
    for _ in 0..14 {
        let to = [x + rng.random_range(0.1..1.9), rng.random_range(0.5..1.9)];
        let grey = rng.random_range(20.0..60.0);
        wall.line(from, to, rng.random_range(0.03..0.07), grey, 0.75);
        from = to;
    }
    2.0
}

/// A poster: a frame and an arrangement of blocks, discs and words that is like no other.
fn poster(wall: &mut Canvas, x: f64, rng: &mut ChaCha8Rng) -> f64 {
    let (w, h) = (rng.random_range(0.7..1.6), rng.random_range(0.8..1.3));
    let y = rng.random_range(1.12..1.4);
    wall.fill([x, y, x + w, y + h], rng.random_range(170.0..240.0), 1.0);
    for _ in 0..rng.random_range(6..14) {
        let (px, py) = (
            rng.random_range(0.0..0.8 * w),
            rng.random_range(0.0..0.8 * h),
        );
        let grey = rng.random_range(15.0..250.0);
        if rng.random_bool(0.6) {
            let (bw, bh) = (
                rng.random_range(0.05..0.5 * w),
                rng.random_range(0.04..0.4 * h),
            );
            let (x1, y1) = ((px + bw).min(w), (py + bh).min(h));
            wall.fill([x + px, y + py, x + x1, y + y1], grey, 0.95);
        } else {
            let radius = rng.random_range(0.03..0.16);
            wall.disc([x + px + 0.1 * w, y + py + 0.1 * h], radius, grey, 0.95);
        }
    }
    let letters: String = (0..4)
        .map(|_| char::from(b'A' + rng.random_range(0..26u8)))
        .collect();
    let at = Pose2::new([x + 0.08, y + 0.08], 0.0);
    wall.text(&letters, at, 0.15, 20.0, 1.0);
    for (from, to) in [([x, y], [x + w, y]), ([x, y + h], [x + w, y + h])] {
        wall.line(from, to, 0.03, 40.0, 1.0);
    }
    w
}

fn pipes(wall: &mut Canvas, length_m: f64, rng: &mut ChaCha8Rng) {
    for _ in 0..2 {
        let (y, d) = (rng.random_range(2.35..2.8), rng.random_range(0.06..0.16));
        let grey = rng.random_range(110.0..210.0);
        wall.shape([0.0, y - d, length_m, y + d], grey, 1.0, |_, py| {
            (py - y).abs() - 0.5 * d
        });
        wall.line(
            [0.0, y - 0.35 * d],
            [length_m, y - 0.35 * d],
            0.3 * d,
            50.0,
            0.5,
        );
        let mut x = rng.random_range(0.3..1.5);
        while x < length_m {
            wall.fill([x, y - 0.7 * d, x + 0.07, y + 0.7 * d], 60.0, 0.9);
            x += rng.random_range(1.4..2.6);
        }
    }
}

/// Lime and rust running down.
fn drips(wall: &mut Canvas, length_m: f64, rng: &mut ChaCha8Rng) {
    let count = (1.6 * length_m) as usize;
    for _ in 0..count {
        let x = rng.random_range(0.0..length_m);
        let (top, run) = (rng.random_range(0.8..CEILING_M), rng.random_range(0.3..1.6));
        let grey = if rng.random_bool(0.5) { 60.0 } else { 200.0 };
        let width = rng.random_range(0.02..0.09);
        wall.line([x, (top - run).max(0.0)], [x, top], width, grey, 0.4);
    }
}

/// The roller door of the gate, drawn over a wall from column `x0` to `x1` (m).
pub fn roller_door(wall: &mut Canvas, x0: f64, x1: f64) {
    wall.fill([x0, 0.0, x1, 2.6], 165.0, 1.0);
    let mut y = 0.08;
    while y < 2.55 {
        wall.line([x0, y], [x1, y], 0.03, 85.0, 0.9);
        y += 0.16;
    }
    for x in [x0, x1] {
        wall.line([x, 0.0], [x, 2.6], 0.2, 40.0, 1.0);
    }
    let at = Pose2::new([x0 + 0.5 * (x1 - x0) - 1.1, 1.3], 0.0);
    wall.text("GATE", at, 0.62, 35.0, 1.0);
}

/// Dims a wall by the light of a session; `place` maps metres along the wall to the floor.
pub fn light_wall(wall: &Canvas, lighting: &Lighting, place: impl Fn(f64) -> [f64; 2]) -> Canvas {
    let mut lit = wall.clone();
    let cell = 0.25;
    let columns = (wall.width as f64 / wall.scale / cell) as usize + 2;
    let rows = (CEILING_M / cell) as usize + 2;
    let grid: Vec<f64> = (0..rows * columns)
        .map(|i| {
            let [x, y] = place((i % columns) as f64 * cell);
            0.12 + 0.8 * lighting.at(x, y, ((i / columns) as f64 * cell).min(2.2))
        })
        .collect();
    let region = [0.0, 0.0, wall.width as f64 / wall.scale, CEILING_M];
    lit.repaint(region, |x, y, old| {
        let (gx, gy) = (x / cell, y / cell);
        let (ix, iy) = (gx as usize, gy as usize);
        let at = |dx: usize, dy: usize| grid[(iy + dy) * columns + ix + dx];
        let south = at(0, 0) + (at(1, 0) - at(0, 0)) * gx.fract();
        let north = at(0, 1) + (at(1, 1) - at(0, 1)) * gx.fract();
        old * (south + (north - south) * gy.fract())
    });
    lit
}

/// One side of a pillar: a hazard band below, its number above.
pub fn paint_pillar(label: &str, rng: &mut ChaCha8Rng) -> Canvas {
    let width = 0.5;
    let mut pillar = Canvas::new(width, CEILING_M, 150.0, 158);
    pillar.add_noise(rng.random(), &WALL_NOISE);
    pillar.repaint([0.0, 0.0, width, 1.0], |x, y, old| {
        let dark = ((x + y) / 0.3).rem_euclid(1.0) < 0.5;
        old + 0.85 * (if dark { 38.0 } else { 205.0 } - old)
    });
    pillar.fill([0.0, 1.3, width, 1.95], rng.random_range(40.0..235.0), 0.9);
    let letters = label.len() as f64;
    let size = 0.34;
    let x = 0.5 * width - 0.5 * size * (6.0 * letters - 1.0) / 7.0;
    let plate = pillar.grey[(1.35 * pillar.scale) as usize * pillar.width + 3];
    let ink = if plate > 128 { 25.0 } else { 230.0 };
    pillar.text(label, Pose2::new([x, 1.45], 0.0), size, ink, 1.0);
    pillar
}

/// Plain cast concrete, for beams and closed rooms' tops.
pub fn paint_concrete(width_m: f64, height_m: f64, rng: &mut ChaCha8Rng) -> Canvas {
    let mut concrete = Canvas::new(width_m, height_m, 60.0, 120);
    concrete.add_noise(rng.random(), &WALL_NOISE);
    concrete
}

/// The ceiling as seen from below, columns along x, rows along y, with this session's lamps.
pub fn paint_ceiling(layout: &Layout, lighting: &Lighting, rng: &mut ChaCha8Rng) -> Canvas {
    let (w, h) = (layout.width_m, layout.depth_m);
    let mut ceiling = Canvas::new(w, h, CEILING_SCALE, 78);
    ceiling.add_noise(rng.random(), &CEILING_NOISE);
    for _ in 0..5 {
        let y = rng.random_range(1.0..h - 1.0);
        ceiling.line([0.0, y], [w, y], rng.random_range(0.08..0.25), 125.0, 0.9);
        let x = rng.random_range(1.0..w - 1.0);
        ceiling.line([x, 0.0], [x, h], rng.random_range(0.05..0.12), 50.0, 0.9);
    }
    for _ in 0..(w * h / 9.0) as usize {
        let at = [rng.random_range(0.0..w), rng.random_range(0.0..h)];
        ceiling.disc(
            at,
            rng.random_range(0.04..0.1),
            rng.random_range(30.0..190.0),
            0.9,
        );
    }
    for ([x, y], power) in &lighting.lamps {
        ceiling.fill([x - 0.85, y - 0.16, x + 0.85, y + 0.16], 60.0, 1.0);
        let glow = 70.0 + 185.0 * power.min(1.0);
        ceiling.fill([x - 0.75, y - 0.08, x + 0.75, y + 0.08], glow, 1.0);
    }
    ceiling
}
