//! A yard to look at: a floor, four walls, pillars, open sky, and a car where it is asked for.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::geometry::pose::Pose;
use crate::semantic_map::stable::sphere::{Lens, Sphere};
use crate::semantic_map::stable::warp::LabelledView;

pub const SKY: u8 = 0;
pub const FLOOR: u8 = 1;
pub const WALL: u8 = 2;
pub const PILLAR: u8 = 3;
pub const CAR: u8 = 4;
pub const SIGN: u8 = 5;

/// A box between two corners; y points down, the floor is at 1.5 m.
#[derive(Clone, Copy)]
pub struct Block {
    pub low: [f64; 3],
    pub high: [f64; 3],
    pub class: u8,
}

pub fn car(x: f64, z: f64) -> Block {
    Block {
        low: [x - 0.9, 0.1, z - 2.0],
        high: [x + 0.9, 1.5, z + 2.0],
        class: CAR,
    }
}

pub fn yard() -> Vec<Block> {
    let block = |low, high, class| Block { low, high, class };
    let pillar = |x: f64, z: f64| block([x - 0.3, -2.0, z - 0.3], [x + 0.3, 1.5, z + 0.3], PILLAR);
    vec![
        block([-40.0, 1.5, -40.0], [40.0, 2.0, 40.0], FLOOR),
        block([-8.0, -3.0, -15.0], [-7.0, 1.5, 15.0], WALL),
        block([6.0, -2.0, -15.0], [7.0, 1.5, 15.0], WALL),
        block([-8.0, -2.5, 14.0], [8.0, 1.5, 15.0], WALL),
        block([-8.0, -1.5, -16.0], [8.0, 1.5, -15.0], WALL),
        pillar(4.0, 5.0),
        pillar(-5.0, 2.0),
        pillar(3.0, -6.0),
        pillar(-4.0, -9.0),
        pillar(-3.5, 9.0),
    ]
}

pub struct View {
    pub lens: Lens,
    pub grey: Vec<u8>,
    pub range: Vec<u16>,
    pub labels: Vec<u8>,
}

pub fn lens(width: usize) -> Lens {
    let height = width / 3;
    let focal = width as f64 / TAU;
    let centre = [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0];
    Lens::new([width, height], [focal, focal], centre).unwrap()
}

impl View {
    /// From a pose in the yard; the light is a gain on brightness.
    pub fn new(blocks: &[Block], width: usize, pose: &Pose, light: f64) -> Self {
        let lens = lens(width);
        let mut view = Self {
            grey: Vec::new(),
            range: Vec::new(),
            labels: Vec::new(),
            lens: lens.clone(),
        };
        for row in 0..lens.height {
            for column in 0..lens.width {
                let ray = pose.rotate(&lens.ray(column, row));
                let hits = blocks
                    .iter()
                    .filter_map(|block| Some((hit(block, &pose.translation, &ray)?, block.class)));
                let (range, class) = hits
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .unwrap_or((0.0, SKY));
                let at = pose.translation + ray * range;
                let texture = (1.3 * at.x + 0.4 * at.y).sin() + (1.1 * at.z - 0.7 * at.y).sin();
                view.grey
                    .push((light * (110.0 + 40.0 * texture)).clamp(0.0, 255.0) as u8);
                view.range.push((range * 1000.0).round() as u16);
                view.labels.push(class);
            }
        }
        view
    }

    pub fn sphere(&self) -> Sphere<'_> {
        Sphere {
            lens: &self.lens,
            grey: &self.grey,
            range: &self.range,
            unit_m: 0.001,
        }
    }

    pub fn labelled(&self) -> LabelledView<'_> {
        LabelledView {
            lens: &self.lens,
            labels: &self.labels,
            range: &self.range,
            unit_m: 0.001,
        }
    }
}

fn hit(block: &Block, from: &Vector3<f64>, ray: &Vector3<f64>) -> Option<f64> {
    let (mut near, mut far) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let a = (block.low[axis] - from[axis]) / ray[axis];
        let b = (block.high[axis] - from[axis]) / ray[axis];
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    (near < far && near > 0.0 && near < 60.0).then_some(near)
}
