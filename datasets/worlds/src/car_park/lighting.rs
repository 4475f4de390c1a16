//! Lamps, some of them broken, and how bright they make things.

use super::CarPark;
use super::canvas::{Canvas, around};
use super::cars::ParkedCar;
use super::layout::{CEILING_M, Layout};
use crate::random::stream;
use rand::Rng;

/// The light of one session.
#[derive(Debug, Clone, PartialEq)]
pub struct Lighting {
    /// For each lamp of the layout: its place and its power (0 when broken, about 1 otherwise).
    pub lamps: Vec<([f64; 2], f64)>,
    ambient: f64,
}

impl Lighting {
    /// The light of a session.
    pub fn of_session(world: &CarPark, layout: &Layout, session: usize) -> Self {
        let mut rng = stream(world.seed, "lamps", session as u64);
        let lamps = layout.lamps.iter().map(|place| {
            let power = match rng.random_range(0.0..1.0) {
                draw if draw < 0.06 => 0.0,
                draw if draw < 0.12 => 0.5,
                _ => rng.random_range(0.85..1.1),
            };
            (*place, power)
        });
        Self {
            lamps: lamps.collect(),
            ambient: rng.random_range(0.42..0.55),
        }
    }

    /// Brightness (about 1) of a surface facing up at a place, metres.
    pub fn at(&self, x: f64, y: f64, z: f64) -> f64 {
        let drop = (CEILING_M - z).max(0.4);
        let lamps = self.lamps.iter().map(|(place, power)| {
            let away = (x - place[0]).powi(2) + (y - place[1]).powi(2);
            power * drop * drop * 2.6 / (away + drop * drop).powf(1.5)
        });
        self.ambient + 0.42 * lamps.sum::<f64>()
    }

    /// The floor under this light, with the darkness beneath parked cars.
    pub fn on_floor(&self, floor: &Canvas, cars: &[ParkedCar]) -> Canvas {
        let mut lit = floor.clone();
        lit.dim(|x, y| self.at(x, y, 0.0));
        for car in cars {
            shade_beneath(&mut lit, car);
        }
        lit
    }
}

/// Dark under the car, fading out within half a metre around it.
fn shade_beneath(floor: &mut Canvas, car: &ParkedCar) {
    let (half_x, half_y) = (0.5 * car.shape.length - 0.1, 0.5 * car.shape.width - 0.05);
    let reach = half_x + 0.9;
    let ([cx, cy], (sin, cos)) = (car.pose.at(), car.pose.yaw.sin_cos());
    floor.repaint(around(&[[cx, cy]], reach), |x, y, old| {
        let (dx, dy) = (x - cx, y - cy);
        let (ahead, left) = ((dx * cos + dy * sin).abs(), (dy * cos - dx * sin).abs());
        let (ox, oy) = (ahead - half_x, left - half_y);
        let distance = ox.max(0.0).hypot(oy.max(0.0)) + ox.max(oy).min(0.0);
        let open = ((distance + 0.25) / 0.75).clamp(0.0, 1.0);
        old * (0.25 + 0.75 * open * open * (3.0 - 2.0 * open))
    });
}
