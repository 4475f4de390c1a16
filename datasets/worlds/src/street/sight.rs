//! What a panorama sees: for every pixel how far it looks, and at what.

use crate::cast::{FAR, Scratch, Seen, meet_solids, turn_rays};
use crate::lens::{Lens, PIXELS, TILE, Window};
use crate::odometry::normal;
use crate::random::{lattice, stream};
use crate::rig::looking;
use crate::street::classes::Class;
use crate::street::course::Course;
use crate::street::ground::Land;
use crate::street::params::Street;
use crate::street::stretch::Plan;
use crate::street::things::{FACES, Stage, Surface, Thing};
use crate::street::town::Town;
use evermap_algorithms::geometry::camera::{Camera, Equirectangular, Model};
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Side of a cell of the index of things, metres.
const CELL_M: f64 = 32.0;
/// Ground farther away than this is hidden behind the woods at the horizon, metres.
const HORIZON_M: f32 = 300.0;
/// The optical frame.
pub const PANORAMA_FRAME: &str = "panorama_optical_frame";

/// A panorama camera.
pub struct PanoramaCamera {
    /// Rays.
    pub lens: Lens,
    /// Pixels per radian.
    pub focal: f64,
    /// Principal point, pixels.
    pub centre: [f64; 2],
}

impl PanoramaCamera {
    /// The camera of a world: the centre column looks forward.
    pub fn new(world: &Street) -> Self {
        let focal = f64::from(world.width_px) / TAU;
        let centre = [world.width_px, world.height_px].map(|side| 0.5 * (f64::from(side) - 1.0));
        let model = Model::Equirectangular(Equirectangular::new([focal; 2], centre));
        let camera = Camera::new(model, world.width_px, world.height_px);
        let mut rng = stream(world.seed, "mount", 0);
        let mut draw = |sigma: f64| sigma * normal(&mut rng).clamp(-2.0, 2.0);
        let place = Vector3::new(0.1 + draw(0.02), draw(0.02), 1.85 + draw(0.03));
        let vehicle_from_camera = Pose::new(place, looking(draw(0.01), draw(0.004)));
        Self {
            lens: Lens::new(&camera, &vehicle_from_camera, [focal; 2], 4.0),
            focal,
            centre,
        }
    }
}

/// All that stays, indexed by place.
pub struct Scenery {
    /// The ground.
    pub land: Land,
    /// What stands on it.
    pub town: Town,
    cells: BTreeMap<[i32; 2], Vec<u32>>,
    horizon: u64,
}

/// What one panorama sees, row by row.
#[derive(Default)]
pub struct Sight {
    /// Distance along the ray, metres; [`FAR`] for the sky.
    pub range_m: Vec<f32>,
    /// Number of the face; negative for ground and sky.
    pub face: Vec<f32>,
    /// What the faces are of.
    pub surfaces: Vec<Surface>,
    /// The eye, metres.
    pub eye: [f64; 3],
    /// Rotation `map_from_vehicle`.
    pub turn: [[f32; 3]; 3],
    /// The same without cars.
    pub bare: Option<Bare>,
}

/// What would be seen without cars.
#[derive(Default)]
pub struct Bare {
    /// Distance along the ray, metres.
    pub range_m: Vec<f32>,
    /// Number of the face.
    pub face: Vec<f32>,
}

/// Face of the ground.
pub const GROUND: f32 = -1.0;
/// Face of the sky, and of the woods at the horizon.
pub const SKY: f32 = -2.0;

impl Scenery {
    /// The scenery of a world.
    pub fn new(world: &Street) -> Self {
        let course = Course::new(world.seed, world.length_m);
        let plan = Plan::new(world.seed, &course);
        let land = Land::new(course, plan);
        let town = Town::new(world.seed, &land);
        let mut cells: BTreeMap<[i32; 2], Vec<u32>> = BTreeMap::new();
        for (index, thing) in town.things.iter().enumerate() {
            cells.entry(cell(thing.at)).or_default().push(index as u32);
        }
        Self {
            land,
            town,
            cells,
            horizon: world.seed,
        }
    }

    /// The things that may be seen from a place.
    fn near(&self, eye: [f64; 3]) -> impl Iterator<Item = &Thing> {
        let reach = (200.0 / CELL_M) as i32;
        let [x, y] = cell([eye[0], eye[1]]);
        (-reach..=reach)
            .flat_map(move |dy| (-reach..=reach).map(move |dx| [x + dx, y + dy]))
            .filter_map(|cell| self.cells.get(&cell))
            .flatten()
            .filter_map(|index| self.town.things.get(*index as usize))
    }

    /// What is seen from a pose; with `bare`, also what would be seen without the cars.
    pub fn look(
        &self,
        camera: &PanoramaCamera,
        map_from_vehicle: &Pose,
        cars: &[Thing],
        bare: bool,
        scratch: &mut Scratch,
    ) -> Sight {
        let eye = map_from_vehicle.transform(&camera.lens.vehicle_from_camera.translation);
        let eye = [eye.x, eye.y, eye.z];
        let matrix = map_from_vehicle.rotation.to_rotation_matrix();
        let turn = [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)] as f32));
        let mut stage = Stage::default();
        stand_all(self.near(eye), eye, &mut stage);
        let mut still = std::mem::take(&mut stage.seen);
        stand_all(cars.iter(), eye, &mut stage);
        let mut moving = std::mem::take(&mut stage.seen);
        for seen in [&mut still, &mut moving] {
            seen.sort_by(|a, b| a.extent.near.total_cmp(&b.extent.near));
        }
        let pixels = camera.lens.width * camera.lens.height;
        let mut sight = Sight {
            range_m: vec![0.0; pixels],
            face: vec![0.0; pixels],
            surfaces: stage.surfaces,
            eye,
            turn,
            bare: bare.then(|| Bare {
                range_m: vec![0.0; pixels],
                face: vec![0.0; pixels],
            }),
        };
        cast(&camera.lens, &still, &moving, &mut sight, scratch);
        sight
    }

    /// The class of a pixel from its range, face and ray.
    pub fn class(&self, sight: &Sight, range_m: f32, face: f32, ray: [f32; 3]) -> Class {
        if face == GROUND {
            return self.land.at(sight.on_ground(range_m, ray)).class;
        }
        if face == SKY {
            return self.sky(ray);
        }
        let surface = sight.surfaces.get(face as usize / FACES as usize);
        surface.map_or(Class::Other, |surface| surface.class)
    }

    /// Woods stand at the horizon, endlessly far away.
    fn sky(&self, ray: [f32; 3]) -> Class {
        let level = ray[0].hypot(ray[1]);
        if ray[2] > 0.06 * level {
            return Class::Sky;
        }
        let azimuth = ray[1].atan2(ray[0]) * (36.0 / std::f32::consts::TAU);
        let (k, f) = (azimuth.floor(), azimuth.fract().rem_euclid(1.0));
        let height = |k: f32| lattice(self.horizon, (k as i64).rem_euclid(36), 77);
        let line = 0.004 + 0.045 * (height(k) * (1.0 - f) + height(k + 1.0) * f);
        if ray[2] < line * level {
            Class::Tree
        } else {
            Class::Sky
        }
    }
}

impl Sight {
    /// Where a ray of this length ends on the ground, metres.
    pub fn on_ground(&self, range_m: f32, ray: [f32; 3]) -> [f64; 2] {
        [0, 1].map(|axis| self.eye[axis] + f64::from(range_m) * f64::from(ray[axis]))
    }

    /// The ray of a pixel of a tile in the map frame.
    pub fn turned(&self, own: [f32; 3]) -> [f32; 3] {
        self.turn
            .map(|row| row[0] * own[0] + row[1] * own[1] + row[2] * own[2])
    }
}

fn cell(at: [f64; 2]) -> [i32; 2] {
    at.map(|part| (part / CELL_M).floor() as i32)
}

/// Puts the things on the stage that are near enough to be seen, but not the eye's own place.
fn stand_all<'a>(things: impl Iterator<Item = &'a Thing>, eye: [f64; 3], stage: &mut Stage) {
    for thing in things {
        let away = (thing.at[0] - eye[0]).hypot(thing.at[1] - eye[1]);
        if away < thing.sight() + thing.reach() {
            thing.stand(eye, stage);
        }
    }
}

fn cast(lens: &Lens, still: &[Seen], moving: &[Seen], sight: &mut Sight, scratch: &mut Scratch) {
    let up = sight.eye[2] as f32;
    for block in &lens.blocks {
        let Some(cone) = &block.cone else { continue };
        let window = Window::of(cone, &sight.turn);
        let within = |seen: &&Seen| window.meets(&seen.extent);
        let still: Vec<&Seen> = still.iter().filter(within).collect();
        let moving: Vec<&Seen> = moving.iter().filter(within).collect();
        for index in &block.tiles {
            let tile = &lens.tiles[*index];
            let Some(cone) = &tile.cone else { continue };
            turn_rays(&tile.rays, &sight.turn, &mut scratch.rays);
            meet_ground(up, scratch);
            let window = Window::of(cone, &sight.turn);
            meet_solids(&still, &window, scratch);
            let target = (index % lens.columns * TILE, index / lens.columns * TILE);
            if let Some(bare) = &mut sight.bare {
                put(lens, target, &scratch.t, &mut bare.range_m);
                put(lens, target, &scratch.face, &mut bare.face);
            }
            meet_solids(&moving, &window, scratch);
            put(lens, target, &scratch.t, &mut sight.range_m);
            put(lens, target, &scratch.face, &mut sight.face);
        }
    }
}

fn meet_ground(eye_z: f32, scratch: &mut Scratch) {
    let Scratch { rays, t, face, .. } = scratch;
    for i in 0..PIXELS {
        let down = -rays[2][i];
        let here = eye_z / down;
        let meets = (down > 0.0) & (here < HORIZON_M);
        t[i] = if meets { here } else { FAR };
        face[i] = if meets { GROUND } else { SKY };
    }
}

fn put(lens: &Lens, (left, top): (usize, usize), from: &[f32; PIXELS], image: &mut [f32]) {
    let columns = TILE.min(lens.width - left);
    for (row, values) in from.chunks_exact(TILE).enumerate().take(lens.height - top) {
        let start = (top + row) * lens.width + left;
        if let Some(target) = image.get_mut(start..start + columns) {
            target.copy_from_slice(&values[..columns]);
        }
    }
}
