//! What a fisheye sees of the hall, in grey.
//!
//! Each pixel takes one look into a texture. Mip levels are chosen per pixel from the area it covers, and blend instead
//! of showing edges.

use super::exposure::Exposure;
use super::rig::CIRCLE_RAD;
use super::scene::{Face, Scene};
use super::visit::Visit;
use crate::random::{normal, scramble};
use crate::render::{Eye, FAR, Lanes, Lens, PIXELS, Scratch, cast, seen_from};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// A face with the eye's position worked in.
#[derive(Clone, Copy)]
struct PaintedFace {
    texture: usize,
    light: f32,
    u: [f32; 4],
    v: [f32; 4],
    /// Normal of the texture plane, times texels per square metre.
    normal: [f32; 3],
    /// Its length, and its square times the pixel's solid angle.
    density: f32,
    area: f32,
}

impl PaintedFace {
    fn new(face: &Face, eye: [f32; 3], omega: f32) -> Self {
        let at = |a: [f32; 4]| {
            let origin = a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2] + a[3];
            [256.0 * a[0], 256.0 * a[1], 256.0 * a[2], 256.0 * origin]
        };
        let u = Vector3::new(face.u[0], face.u[1], face.u[2]);
        let v = Vector3::new(face.v[0], face.v[1], face.v[2]);
        let normal = u.cross(&v);
        let density = normal.norm();
        Self {
            texture: usize::from(face.texture),
            light: face.light,
            u: at(face.u),
            v: at(face.v),
            normal: [normal.x, normal.y, normal.z],
            density,
            area: omega * density * density,
        }
    }

    /// Texel column and row (1/256 texels) and mip level where a ray meets the face at `t`.
    #[inline(always)]
    fn texel(&self, t: f32, d: [f32; 3]) -> (i32, i32, f32) {
        let along = |a: &[f32; 4]| a[3] + t * (a[0] * d[0] + a[1] * d[1] + a[2] * d[2]);
        let n = self.normal;
        let slant = (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]).abs();
        let cosine = slant / self.density;
        // A slanted pixel covers a long strip: lean towards its longer side.
        let texels = t * t * self.area / slant / cosine.sqrt();
        // Half the binary logarithm, a straight line between powers of two.
        let level = 0.5 * (texels.to_bits() as f32 * (1.0 / 8_388_608.0) - 127.0);
        (along(&self.u) as i32, along(&self.v) as i32, level)
    }
}

/// All that is needed to render one session.
pub struct Studio<'a> {
    /// The world's seed.
    pub seed: u64,
    /// The cameras' rays.
    pub lenses: &'a [Lens],
    /// The session.
    pub visit: &'a Visit,
    /// What it sees.
    pub scene: Scene,
    /// How bright that appears.
    pub exposure: Exposure,
}

impl Studio<'_> {
    /// The grey image of one camera at one shot, row by row.
    pub fn image(&self, shot: usize, camera: usize) -> Vec<u8> {
        let (scene, visit, lens) = (&self.scene, self.visit, &self.lenses[camera]);
        let stamp = visit.session.stamps[shot];
        let eye = Eye::new(lens, &visit.session.map_from_vehicle(stamp));
        let at = eye.position();
        let faces = scene.faces.iter();
        let painted: Vec<PaintedFace> = faces
            .map(|face| PaintedFace::new(face, at, lens.omega))
            .collect();
        let moving = scene.walkers_at(&visit.walkers, visit.session.seconds(stamp));
        let seen = seen_from(at, scene.solids.iter().chain(&moving));
        let noise = self.noise_seed(shot, camera);
        let mut image = vec![0; lens.pixels()];
        cast(
            lens,
            &eye,
            [&seen],
            |scratch| meet_room(scene, at, scratch),
            |tile, _, scratch| {
                shade(scene, &painted, scratch);
                let noise = self.exposure.noise(scramble(noise ^ (tile as u64) << 20));
                let grey = self.develop(&lens.tiles[tile].theta, noise, &scratch.grey);
                lens.put(tile, &grey, &mut image);
            },
        );
        image
    }

    /// What a camera without light sees: the noise of its sensor.
    pub fn darkness(&self, shot: usize, camera: usize) -> Vec<u8> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.noise_seed(shot, camera));
        let deviation = f64::from(self.exposure.noise_at(0.0));
        let black = f64::from(self.exposure.black);
        (0..self.lenses[camera].pixels())
            .map(|_| (black + deviation * normal(&mut rng)).clamp(0.0, 255.0) as u8)
            .collect()
    }

    fn noise_seed(&self, shot: usize, camera: usize) -> u64 {
        let index = self.visit.session.index as u64;
        let place = index << 40 | (shot as u64) << 8 | camera as u64;
        scramble(scramble(self.seed) ^ place)
    }

    /// From light to grey values: lens shading, exposure and sensor noise.
    fn develop(&self, theta: &Lanes, noise: &[f32; PIXELS], light: &Lanes) -> [u8; PIXELS] {
        let exposure = &self.exposure;
        let mut out = [0; PIXELS];
        for i in 0..PIXELS {
            let value = exposure.at(theta[i]) * light[i];
            let grey = exposure.black + value + noise[i] * exposure.noise_at(value);
            let seen = theta[i] < CIRCLE_RAD as f32;
            let grey = if seen { grey } else { 0.0 };
            let grey = if grey > 255.0 { 255.0 } else { grey };
            out[i] = (if grey > 0.0 { grey } else { 0.0 }) as i32 as u8;
        }
        out
    }
}

/// Every ray leaves the hall through the nearest of the planes it heads for: a wall of each pair,
/// the ceiling, and the floor's two halves.
fn meet_room(scene: &Scene, eye: [f32; 3], scratch: &mut Scratch) {
    let Scratch { rays, t, face, .. } = scratch;
    let (room, slope) = (scene.room, scene.ground.slope as f32);
    // Height of the eye above both halves, each continued beyond the drain.
    let beside = slope * (eye[1] - scene.ground.drain_y as f32);
    let above = [eye[2] - beside, eye[2] + beside];
    for i in 0..PIXELS {
        let way = |axis: usize| {
            let d = rays[axis][i];
            let goal = if d > 0.0 { room[axis] } else { 0.0 };
            (goal - eye[axis]) / d
        };
        let floor = |above: f32, slope: f32| {
            let sinking = slope * rays[1][i] - rays[2][i];
            let t = above / sinking;
            if sinking > 0.0 { t } else { FAR }
        };
        let (x, y) = (way(0), way(1));
        let (south, north) = (floor(above[1], -slope), floor(above[0], slope));
        let floor = if south < north { south } else { north };
        let rising = (room[2] - eye[2]) / rays[2][i];
        let ceiling = if rays[2][i] > 0.0 { rising } else { FAR };
        let z = if floor < ceiling { floor } else { ceiling };
        let face_x = if rays[0][i] > 0.0 { 5.0 } else { 4.0 };
        let face_y = if rays[1][i] > 0.0 { 3.0 } else { 2.0 };
        let face_z = if floor < ceiling { 0.0 } else { 1.0 };
        let (side, side_face) = if x < y { (x, face_x) } else { (y, face_y) };
        t[i] = if z < side { z } else { side };
        face[i] = if z < side { face_z } else { side_face };
    }
}

/// How bright everything is where the rays end.
fn shade(scene: &Scene, painted: &[PaintedFace], scratch: &mut Scratch) {
    let Scratch {
        rays,
        t,
        face,
        grey,
        ..
    } = scratch;
    for i in 0..PIXELS {
        let Some(face) = painted.get(face[i] as usize) else {
            continue;
        };
        let Some(texture) = scene.textures.get(face.texture) else {
            continue;
        };
        let (u, v, level) = face.texel(t[i], [rays[0][i], rays[1][i], rays[2][i]]);
        grey[i] = face.light * texture.blend(u, v, level);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::car_park::canvas::Canvas;
    use crate::car_park::rig::rig;
    use crate::car_park::{CarPark, Layout};
    use crate::render::{Window, meet_solid, meet_solids};

    /// Culling is an optimisation: asking every tile about every solid gives the same hits.
    #[test]
    fn culling_loses_nothing() {
        let world = CarPark {
            width_px: 160,
            height_px: 120,
            floor_texels_per_m: 10.0,
            ..CarPark::default()
        };
        let layout = Layout::new(&world);
        let visit = Visit::new(&world, &layout, 1);
        let floor = Canvas::new(layout.width_m, layout.depth_m, 10.0, 99);
        let scene = Scene::build(&world, &layout, &floor, &visit);
        let mut met = 0;
        for (camera, t) in rig(&world).iter().zip([0.0, 9.0, 20.0, 31.0]) {
            let lens = camera.lens();
            let eye = Eye::new(&lens, &visit.session.drive.map_from_vehicle(t));
            let at = eye.position();
            let moving = scene.walkers_at(&visit.walkers, t);
            let seen = seen_from(at, scene.solids.iter().chain(&moving));
            let (mut fast, mut slow) = (Scratch::default(), Scratch::default());
            for tile in lens.tiles.iter().filter(|tile| tile.cone.is_some()) {
                for scratch in [&mut fast, &mut slow] {
                    eye.turn_rays(&tile.rays, &mut scratch.rays);
                    meet_room(&scene, at, scratch);
                }
                let window = Window::of(tile.cone.as_ref().unwrap(), &eye);
                meet_solids(&seen, &window, &mut fast);
                for seen in &seen {
                    meet_solid(seen, &mut slow);
                }
                for i in (0..PIXELS).filter(|i| tile.theta[*i] < CIRCLE_RAD as f32) {
                    assert_eq!(fast.t[i], slow.t[i]);
                    met += usize::from(slow.face[i] > 5.0);
                }
            }
        }
        assert!(met > 3000, "only {met} pixels meet a solid");
    }
}
