//! What a panorama sees: for every pixel how far it looks, and at what.

use super::classes::Class;
use super::course::Course;
use super::ground::Land;
use super::params::Street;
use super::stretch::Plan;
use super::things::{FACES, Stage, Surface, Thing};
use super::town::Town;
use crate::random::{lattice, normal, stream};
use crate::record::CameraTopics;
use crate::render::{Eye, FAR, Lens, PIXELS, Scratch, cast, looking};
use evermap_algorithms::geometry::camera::{Camera, Equirectangular, Model};
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Side of a cell of the index of things, metres.
const CELL_M: f64 = 32.0;
/// Ground farther away than this is hidden behind the woods at the horizon, metres.
const HORIZON_M: f32 = 300.0;
/// Range images end here, metres.
const DEPTH_REACH_M: f32 = 65.0;
/// Steps of inverse range, 1/m.
const DEPTH_STEP: f32 = 2e-4;

/// The panorama camera of a world, whose centre column looks forward: its rays, and what is published of it.
pub fn panorama_camera(world: &Street) -> (Lens, CameraTopics) {
    let size = [world.width_px, world.height_px];
    let focal = [f64::from(world.width_px) / TAU; 2];
    let centre = size.map(|side| 0.5 * (f64::from(side) - 1.0));
    let model = Model::Equirectangular(Equirectangular::new(focal, centre));
    let camera = Camera::new(model, world.width_px, world.height_px);
    let mut rng = stream(world.seed, "mount", 0);
    let mut draw = |sigma: f64| sigma * normal(&mut rng).clamp(-2.0, 2.0);
    let place = Vector3::new(0.1 + draw(0.02), draw(0.02), 1.85 + draw(0.03));
    let vehicle_from_camera = Pose::new(place, looking(draw(0.01), draw(0.004)));
    let topics = CameraTopics {
        namespace: "/panorama".to_owned(),
        frame_id: "panorama_optical_frame".to_owned(),
        vehicle_from_camera,
        size,
        model: "equirectangular",
        distortion: Vec::new(),
        focal,
        centre,
    };
    let lens = Lens::new(&camera, &vehicle_from_camera, focal, 4.0);
    (lens, topics)
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

/// What the rays of a panorama met, row by row.
pub struct Hits {
    /// Distance along the ray, metres; [`FAR`] for the sky.
    pub range_m: Vec<f32>,
    /// Number of the face, [`GROUND`] or [`SKY`].
    pub face: Vec<f32>,
}

/// What one panorama sees.
pub struct Sight<'a> {
    /// Through which lens.
    pub lens: &'a Lens,
    /// From where.
    pub eye: Eye,
    /// What is seen.
    pub hits: Hits,
    /// What would be seen without cars.
    pub bare: Hits,
    /// What the faces are of.
    pub surfaces: Vec<Surface>,
}

/// What one ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// The unit ray, map frame.
    pub ray: [f32; 3],
    /// Distance along it, metres; [`FAR`] for the sky.
    pub range_m: f32,
    /// Number of the face, [`GROUND`] or [`SKY`].
    pub face: f32,
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
        let land = Land { course, plan };
        let town = Town::new(world.seed, &land);
        let mut cells: BTreeMap<[i32; 2], Vec<u32>> = BTreeMap::new();
        for (index, thing) in town.things.iter().enumerate() {
            let here = cells.entry(cell(thing.pose.at())).or_default();
            here.push(index as u32);
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

    /// What is seen from a pose, among these cars.
    pub fn look<'a>(&self, lens: &'a Lens, map_from_vehicle: &Pose, cars: &[Thing]) -> Sight<'a> {
        let eye = Eye::new(lens, map_from_vehicle);
        let mut stage = Stage::new(eye.at);
        let still = stage.with(self.near(eye.at));
        let moving = stage.with(cars.iter());
        let mut hits = [Hits::new(lens), Hits::new(lens)];
        let up = eye.at[2] as f32;
        cast(
            lens,
            &eye,
            [&still, &moving],
            |scratch| meet_ground(up, scratch),
            |tile, layer, scratch| hits[layer].put(lens, tile, scratch),
        );
        let [bare, hits] = hits;
        Sight {
            lens,
            eye,
            hits,
            bare,
            surfaces: stage.surfaces,
        }
    }

    /// The classes of all pixels, row by row, where a panorama's rays meet this.
    pub fn classes(&self, sight: &Sight<'_>, hits: &Hits) -> Vec<Class> {
        let class = |pixel: usize| {
            let hit = sight.hit(hits, pixel);
            match sight.surface(hit.face) {
                Some(surface) => surface.finish.class(),
                None if hit.face == GROUND => {
                    let [x, y, _] = sight.point(&hit);
                    self.land.at([x, y]).class
                }
                None => self.sky(hit.ray),
            }
        };
        (0..sight.lens.pixels()).map(class).collect()
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

impl Hits {
    fn new(lens: &Lens) -> Self {
        Self {
            range_m: vec![0.0; lens.pixels()],
            face: vec![0.0; lens.pixels()],
        }
    }

    /// A range image as stereo makes it, millimetres along the ray; 0 where nothing is measured.
    /// `noise` are standard normal numbers.
    pub fn depth(&self, mut noise: impl FnMut() -> f32) -> Vec<u16> {
        let measured = |range: &f32| {
            let step = 0.5 * noise();
            if *range >= DEPTH_REACH_M {
                return 0;
            }
            let inverse = (1.0 / (range * DEPTH_STEP) + step).round().max(1.0);
            let range_mm = 1000.0 / (inverse * DEPTH_STEP);
            range_mm.round().clamp(0.0, 65_535.0) as u16
        };
        self.range_m.iter().map(measured).collect()
    }

    fn put(&mut self, lens: &Lens, tile: usize, scratch: &Scratch) {
        lens.put(tile, &scratch.t, &mut self.range_m);
        lens.put(tile, &scratch.face, &mut self.face);
    }
}

impl Sight<'_> {
    /// What the ray of a pixel meets, of all that the rays meet.
    pub fn hit(&self, hits: &Hits, pixel: usize) -> Hit {
        Hit {
            ray: self.eye.turned(self.lens.ray(pixel)),
            range_m: hits.range_m[pixel],
            face: hits.face[pixel],
        }
    }

    /// Where a ray ends, metres.
    pub fn point(&self, hit: &Hit) -> [f64; 3] {
        let far = f64::from(hit.range_m);
        [0, 1, 2].map(|axis| self.eye.at[axis] + far * f64::from(hit.ray[axis]))
    }

    /// What a face is of; `None` for ground and sky.
    pub fn surface(&self, face: f32) -> Option<&Surface> {
        let index = (face >= 0.0).then(|| face as usize / FACES as usize);
        self.surfaces.get(index?)
    }
}

fn cell(at: [f64; 2]) -> [i32; 2] {
    at.map(|part| (part / CELL_M).floor() as i32)
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
