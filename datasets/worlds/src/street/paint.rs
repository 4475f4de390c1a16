//! Colours: what the surfaces of a street look like in a visit's light.

use super::classes::Class;
use super::course::Frenet;
use super::ground::GroundPoint;
use super::params::Street;
use super::sight::{Hit, SKY, Scenery, Sight};
use super::things::{FACES, Finish, Surface, Thing};
use crate::random::{lattice, noise2, noise3, scramble, stream};
use crate::render::box_sides;
use nalgebra::Vector3;
use rand::Rng;

type Rgb = [f32; 3];

/// The light of a visit.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    sun: Vector3<f32>,
    sunny: f32,
    warm: Rgb,
    gain: f32,
    clouds: u64,
    cover: f32,
    haze_m: f32,
    /// Standard deviation of the sensor's noise, grey values.
    pub noise: f32,
}

impl Light {
    /// The light of a visit.
    pub fn new(world: &Street, visit: usize) -> Self {
        let mut rng = stream(world.seed, "light", visit as u64);
        let azimuth: f32 = rng.random_range(0.0..std::f32::consts::TAU);
        let height: f32 = rng.random_range(0.35..1.1);
        let tint = rng.random_range(-0.05..0.05);
        Self {
            sun: Vector3::new(
                azimuth.cos() * height.cos(),
                azimuth.sin() * height.cos(),
                height.sin(),
            ),
            sunny: rng.random_range(0.25..0.75),
            warm: [1.0 + tint, 1.0, 1.0 - tint],
            gain: rng.random_range(0.85..1.12),
            clouds: rng.random(),
            cover: rng.random_range(0.3..0.7),
            haze_m: rng.random_range(250.0..900.0),
            noise: rng.random_range(1.2..2.6),
        }
    }

    /// The colours of a panorama, row by row, before the sensor's noise.
    pub fn panorama(&self, scenery: &Scenery, sight: &Sight<'_>, exact: &[Class]) -> Vec<u8> {
        let colour = |pixel: usize| {
            let lit = self.colour(scenery, sight, exact[pixel], &sight.hit(&sight.hits, pixel));
            lit.map(|value| value.clamp(0.0, 255.0) as u8)
        };
        (0..sight.lens.pixels()).flat_map(colour).collect()
    }

    /// The colour of a pixel, 8 bits a channel.
    fn colour(&self, scenery: &Scenery, sight: &Sight<'_>, class: Class, hit: &Hit) -> Rgb {
        let lit = if hit.face == SKY {
            match class {
                Class::Tree => [0.22, 0.3, 0.24],
                _ => self.sky(&Vector3::from(hit.ray)),
            }
        } else {
            let point = sight.point(hit);
            let (albedo, normal) = match sight.surface(hit.face) {
                Some(surface) => finished(surface, hit.face as u32 % FACES, point),
                None => {
                    let ground = scenery.land.at([point[0], point[1]]);
                    (paving(&ground, point), Vector3::z())
                }
            };
            let lit = self.on(albedo, &normal);
            let haze = 1.0 - (-hit.range_m / self.haze_m).exp();
            [0, 1, 2].map(|k| lit[k] * (1.0 - haze) + [0.66, 0.7, 0.76][k] * haze)
        };
        lit.map(|part| 255.0 * (part * self.gain).max(0.0).powf(0.8))
    }

    fn on(&self, albedo: Rgb, normal: &Vector3<f32>) -> Rgb {
        let direct = normal.dot(&self.sun).max(0.0) * self.sunny;
        let ambient = (0.42 + 0.16 * normal.z) * (1.25 - 0.5 * self.sunny);
        [0, 1, 2].map(|k| albedo[k] * (ambient + direct) * self.warm[k])
    }

    fn sky(&self, ray: &Vector3<f32>) -> Rgb {
        let up = ray.z.max(0.02);
        let p = [ray.x / (up + 0.15) * 1.3, ray.y / (up + 0.15) * 1.3];
        let wave = |k: u64, finer: f32| noise2(self.clouds ^ k, p.map(|c| f64::from(finer * c)));
        let wisps = 0.6 * wave(0, 1.0) + 0.3 * wave(1, 2.7) + 0.1 * wave(2, 7.1);
        let cloud = ((wisps - self.cover) * 4.0).clamp(0.0, 1.0);
        let glare = ray.dot(&self.sun).max(0.0).powi(24) * self.sunny * 0.5;
        let blue = [0.42 + 0.25 * (1.0 - up), 0.6 + 0.17 * (1.0 - up), 0.85];
        [0, 1, 2].map(|k| (blue[k] * (1.0 - cloud) + 0.86 * cloud + glare) * self.warm[k])
    }
}

fn grain(seed: u64, point: [f64; 3], size_m: f64) -> f32 {
    noise3(seed, point.map(|part| (part / size_m) as f32))
}

fn paving(ground: &GroundPoint, point: [f64; 3]) -> Rgb {
    let fine = grain(11, point, 0.07) - 0.5;
    let broad = grain(12, point, 2.3) - 0.5;
    let Frenet { s, d } = ground.place;
    match ground.class {
        Class::Road => [0.33, 0.33, 0.34].map(|c| c + 0.1 * fine + 0.1 * broad),
        Class::GroundSign => [0.88, 0.88, 0.85].map(|c| c + 0.1 * fine - 0.25 * broad.max(0.0)),
        Class::Sidewalk => {
            let joint = s.rem_euclid(0.5) < 0.025 || d.rem_euclid(0.5) < 0.025;
            let slab = lattice(13, (s / 0.5).floor() as i64, (d / 0.5).floor() as i64) - 0.5;
            let dark = if joint { 0.14 } else { 0.0 };
            [0.56, 0.54, 0.51].map(|c| c + 0.08 * fine + 0.07 * slab - dark)
        }
        _ => {
            let dry = 0.5 + broad;
            [0.25 + 0.16 * dry, 0.4 + 0.05 * dry, 0.16 + 0.05 * dry].map(|c| c + 0.22 * fine)
        }
    }
}

/// A colour that a seed picks from a palette, a little changed.
fn picked(seed: u32, palette: &[Rgb]) -> Rgb {
    let bits = scramble(u64::from(seed));
    let colour = palette[(bits % palette.len() as u64) as usize];
    let shift = |k: u32| ((bits >> (8 + 8 * k) & 255) as f32 / 255.0 - 0.5) * 0.1;
    [0, 1, 2].map(|k| colour[k as usize] + shift(k))
}

const WALLS: [Rgb; 7] = [
    [0.72, 0.66, 0.55],
    [0.55, 0.3, 0.24],
    [0.8, 0.78, 0.74],
    [0.66, 0.5, 0.36],
    [0.5, 0.5, 0.52],
    [0.76, 0.6, 0.5],
    [0.45, 0.36, 0.3],
];
const ROOFS: [Rgb; 3] = [[0.5, 0.22, 0.16], [0.28, 0.27, 0.28], [0.4, 0.3, 0.24]];
const LEAVES: [Rgb; 4] = [
    [0.2, 0.34, 0.12],
    [0.28, 0.4, 0.14],
    [0.16, 0.28, 0.15],
    [0.34, 0.38, 0.14],
];
const BODIES: [Rgb; 8] = [
    [0.1, 0.1, 0.11],
    [0.72, 0.73, 0.74],
    [0.9, 0.9, 0.9],
    [0.6, 0.08, 0.08],
    [0.1, 0.16, 0.4],
    [0.4, 0.42, 0.44],
    [0.2, 0.3, 0.22],
    [0.55, 0.5, 0.42],
];
const BOARDS: [Rgb; 5] = [
    [0.1, 0.2, 0.7],
    [0.8, 0.1, 0.1],
    [0.9, 0.85, 0.2],
    [0.92, 0.92, 0.92],
    [0.1, 0.45, 0.25],
];
const PLAINS: [Rgb; 4] = [
    [0.35, 0.36, 0.36],
    [0.5, 0.5, 0.48],
    [0.25, 0.3, 0.25],
    [0.45, 0.38, 0.3],
];

/// Albedo and normal of a thing's surface at a point.
fn finished(surface: &Surface, face: u32, point: [f64; 3]) -> (Rgb, Vector3<f32>) {
    let Thing { pose, seed, .. } = surface.thing;
    let [ahead, left] = pose.own([point[0], point[1]]);
    let own = [ahead, left, point[2]];
    let normal = match surface.ball {
        Some((centre, radii)) => Vector3::new(
            (point[0] - centre[0]) / radii[0].powi(2),
            (point[1] - centre[1]) / radii[0].powi(2),
            (point[2] - centre[2]) / radii[1].powi(2),
        )
        .normalize(),
        None => {
            let side = box_sides([0.0; 3], [0.0; 3]).into_iter().nth(face as usize);
            let own = side.map_or(Vector3::z(), |(normal, ..)| normal);
            pose.upright(0.0).rotate(&own)
        }
    }
    .map(|part| part as f32);
    let (fine, broad) = (grain(21, point, 0.12) - 0.5, grain(22, point, 1.1) - 0.5);
    let albedo = match surface.finish {
        Finish::Facade => facade(seed, face, own, fine, broad),
        Finish::Roof => {
            let row = if own[1].rem_euclid(0.33) < 0.06 {
                0.1
            } else {
                0.0
            };
            picked(seed, &ROOFS).map(|c| c + 0.12 * fine - row)
        }
        Finish::Leaves => {
            let clump = grain(23, point, 0.45) - 0.5;
            picked(seed, &LEAVES).map(|c| (c * (1.0 + 1.1 * clump + 1.2 * fine)).max(0.02))
        }
        Finish::Bark => [0.3, 0.24, 0.19].map(|c| c + 0.2 * fine),
        Finish::Plain => picked(seed, &PLAINS).map(|c| c + 0.05 * fine + 0.08 * broad),
        Finish::Board => board(seed, own),
        Finish::Body => picked(seed, &BODIES).map(|c| c + 0.03 * broad),
        Finish::Glass => [0.09, 0.1, 0.12].map(|c| c + 0.06 * broad),
    };
    (albedo, normal)
}

/// Storeys of windows, and a door now and then.
fn facade(seed: u32, face: u32, own: [f64; 3], fine: f32, broad: f32) -> Rgb {
    let wall = picked(seed, &WALLS);
    if face > 3 {
        return [0.4; 3];
    }
    let along = own[usize::from(face < 2)];
    let bits = scramble(u64::from(seed) ^ 9);
    let pitch = 1.9 + (bits % 16) as f64 * 0.1;
    let wide = 0.32 + (bits >> 8 & 15) as f64 * 0.018;
    let (column, storey) = ((along / pitch).floor(), (own[2] / 3.05).floor());
    let (u, v) = (
        (along / pitch).fract().rem_euclid(1.0),
        own[2] / 3.05 - storey,
    );
    let inside = (u - 0.5).abs() < wide && (0.3..0.82).contains(&v);
    let frame = (u - 0.5).abs() > wide - 0.04 || !(0.34..0.78).contains(&v);
    let chance = lattice(u64::from(seed), column as i64, storey as i64);
    let door = storey == 0.0 && chance < 0.18 && (u - 0.5).abs() < 0.25 && v < 0.72;
    if door {
        return [0.3 * chance + 0.2, 0.2, 0.15];
    }
    if inside && chance < 0.93 {
        return if frame {
            [0.85, 0.84, 0.8]
        } else {
            [0.12, 0.14, 0.17].map(|c| c + 0.25 * (chance - 0.4).max(0.0) + 0.05 * broad)
        };
    }
    let course = if own[2].rem_euclid(0.25) < 0.03 {
        0.05
    } else {
        0.0
    };
    wall.map(|c| c + 0.1 * fine + 0.09 * broad - course)
}

/// Blocks of another colour on a ground: letters, from afar.
fn board(seed: u32, own: [f64; 3]) -> Rgb {
    let across = if own[0].abs() > own[1].abs() {
        own[0]
    } else {
        own[1]
    };
    let letter = lattice(
        u64::from(seed),
        (across / 0.16).floor() as i64,
        (own[2] / 0.22).floor() as i64,
    );
    let base = picked(seed, &BOARDS);
    if letter > 0.62 {
        base.map(|c| if c > 0.5 { c - 0.45 } else { c + 0.5 })
    } else {
        base
    }
}
