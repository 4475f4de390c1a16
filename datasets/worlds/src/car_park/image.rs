//! What a fisheye sees of the hall, in grey.
//!
//! Each pixel takes one look into a texture. Mip levels are chosen per pixel from the area it covers, and blend instead
//! of showing edges.

use super::exposure::Exposure;
use super::rig::CIRCLE_RAD;
use super::scene::{Face, Scene};
use crate::random::scramble;
use crate::render::{Eye, FAR, Lanes, Lens, PIXELS, Scratch, Solid, cast, seen_from};
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::Vector3;

/// A face with the eye's position worked in.
#[derive(Clone, Copy)]
struct Painted {
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

impl Painted {
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

/// Renders one image, row by row, grey. `shot` seeds the sensor noise.
pub fn render(
    scene: &Scene,
    moving: &[Solid],
    lens: &Lens,
    map_from_vehicle: &Pose,
    exposure: &Exposure,
    shot: u64,
    scratch: &mut Scratch,
) -> Vec<u8> {
    let mut image = vec![0; lens.pixels()];
    let eye = Eye::new(lens, map_from_vehicle);
    let at = eye.position();
    let faces = scene.faces.iter();
    let painted: Vec<Painted> = faces
        .map(|face| Painted::new(face, at, lens.omega))
        .collect();
    let seen = seen_from(at, scene.solids.iter().chain(moving));
    let surround = |scratch: &mut Scratch| meet_room(scene, at, scratch);
    cast(
        lens,
        &eye.turn,
        [&seen],
        scratch,
        surround,
        |tile, _, scratch| {
            let noise = scramble(shot ^ (tile as u64) << 20);
            shade(scene, &painted, scratch);
            let theta = &lens.tiles[tile].theta;
            lens.put(
                tile,
                &develop(exposure, theta, noise, &scratch.grey),
                &mut image,
            );
        },
    );
    image
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

fn shade(scene: &Scene, painted: &[Painted], scratch: &mut Scratch) {
    let Scratch {
        rays,
        t,
        face,
        grey,
        ..
    } = scratch;
    let first = face[0];
    if face.iter().all(|face| *face == first) {
        if let Some(face) = painted.get(first as usize) {
            shade_one_face(scene, face, rays, t, grey);
        }
        return;
    }
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

fn shade_one_face(scene: &Scene, face: &Painted, rays: &[Lanes; 3], t: &Lanes, grey: &mut Lanes) {
    let Some(texture) = scene.textures.get(face.texture) else {
        return;
    };
    let mut texels = [[0_i32; PIXELS]; 2];
    let mut levels = [0.0_f32; PIXELS];
    for i in 0..PIXELS {
        let (u, v, level) = face.texel(t[i], [rays[0][i], rays[1][i], rays[2][i]]);
        texels[0][i] = u;
        texels[1][i] = v;
        levels[i] = level;
    }
    for i in 0..PIXELS {
        grey[i] = face.light * texture.blend(texels[0][i], texels[1][i], levels[i]);
    }
}

/// From light to grey values: lens shading, exposure and sensor noise.
fn develop(exposure: &Exposure, theta: &Lanes, noise: u64, light: &Lanes) -> [u8; PIXELS] {
    let mut out = [0; PIXELS];
    let Some(noise) = exposure.noise(noise).first_chunk::<PIXELS>() else {
        return out;
    };
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::car_park::canvas::Canvas;
    use crate::car_park::rig::rig;
    use crate::car_park::{CarPark, Layout, Visit};
    use crate::render::{Seen, Window, meet_solid, meet_solids, turn_rays};

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
        let visit = Visit::new(&world, &layout, 1, "revisit_1");
        let floor = Canvas::new(layout.width_m, layout.depth_m, 10.0, 99);
        let scene = Scene::build(&world, &layout, 1, &floor, &visit.parked, &visit.walkers);
        let mut met = 0;
        for (camera, t) in rig(&world).iter().zip([0.0, 9.0, 20.0, 31.0]) {
            let lens = camera.lens();
            let eye = Eye::new(&lens, &visit.session.drive.map_from_vehicle(t));
            let at = eye.position();
            let moving = scene.walkers_at(&visit.walkers, t);
            let seen = seen_from(at, scene.solids.iter().chain(&moving));
            let all: Vec<&Seen> = seen.iter().collect();
            let (mut fast, mut slow) = (Scratch::default(), Scratch::default());
            for tile in lens.tiles.iter().filter(|tile| tile.cone.is_some()) {
                for scratch in [&mut fast, &mut slow] {
                    turn_rays(&tile.rays, &eye.turn, &mut scratch.rays);
                    meet_room(&scene, at, scratch);
                }
                let window = Window::of(tile.cone.as_ref().unwrap(), &eye.turn);
                meet_solids(&all, &window, &mut fast);
                for seen in &all {
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
