//! An underground car park: a hall with bays, pillars and lamps, driven through with four fisheyes.
//!
//! ```text
//! layout ── route ── drive ─┬─ walkers ─┐
//!    ├─ floor, walls, cars ─┴─ scene ───┴─ image
//!    └─ truth
//! ```

mod canvas;
mod cars;
mod exposure;
mod floor;
mod glyphs;
mod image;
mod layout;
mod lighting;
mod params;
mod rig;
mod route;
mod scene;
#[cfg(test)]
pub(crate) mod tests;
mod texture;
mod truth;
mod visit;
mod walkers;
mod walls;

pub(crate) use layout::Layout;
pub use params::CarPark;
pub(crate) use route::Route;
pub(crate) use visit::Visit;

use crate::WorldError;
use crate::random::{normal, scramble};
use crate::record::{
    CameraTopics, Progress, Sensors, SessionSummary, Summary, World, jpeg, simulate,
};
use crate::render::{Lens, Scratch};
use canvas::Canvas;
use exposure::Exposure;
use floor::paint_floor;
use image::render;
use jpeg_encoder::ColorType;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rig::{RigCamera, rig};
use scene::Scene;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Simulates a car park and writes into `out`: `initial.mcap`, `revisit_1.mcap`, … and the folder
/// `truth`. Each file appears under its name only when it is complete.
///
/// # Errors
/// [`WorldError::Parameters`] before anything is written; otherwise when a file cannot be.
pub fn car_park(
    world: &CarPark,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, WorldError> {
    world.check()?;
    simulate(&Hall::new(world), out, progress)
}

/// The car park as built.
struct Hall<'a> {
    params: &'a CarPark,
    layout: Layout,
    rig: Vec<RigCamera>,
    lenses: Vec<Lens>,
    /// The empty floor under even light.
    floor: Canvas,
    /// All visits, those too that are not written.
    visits: Vec<Visit>,
}

impl<'a> Hall<'a> {
    fn new(params: &'a CarPark) -> Self {
        let layout = Layout::new(params);
        let rig = rig(params);
        let names = params.session_names();
        let visits = names.iter().enumerate();
        // Tyres have left their marks on the whole round trip, however little of it is driven today.
        let worn = Route::of_session(params, 0).path(&layout, 2.0);
        Self {
            visits: visits
                .map(|(index, name)| Visit::new(params, &layout, index, name))
                .collect(),
            floor: paint_floor(params, &layout, &[&worn]),
            lenses: rig.par_iter().map(RigCamera::lens).collect(),
            params,
            layout,
            rig,
        }
    }
}

impl World for Hall<'_> {
    type Visit = Visit;

    fn visits(&self) -> &[Visit] {
        self.visits.get(self.params.skip..).unwrap_or_default()
    }

    fn sensors(&self) -> Sensors<'_> {
        let cameras = self.rig.iter().map(|camera| CameraTopics {
            namespace: format!("/camera/{}", camera.name),
            frame_id: &camera.frame_id,
            vehicle_from_camera: &camera.vehicle_from_camera,
            calibration: camera.published(),
        });
        Sensors {
            cameras: cameras.collect(),
            // The format of a grey JPEG, as some drivers write it.
            images: &[("image/compressed", "mono8; jpeg compressed ")],
            delay_ns: 4_000_000..9_000_000,
            spread_ns: 0..0,
            label_classes: BTreeMap::new(),
        }
    }

    fn write_truth(&self, out: &Path) -> Result<PathBuf, WorldError> {
        truth::write(self, out)
    }

    fn record(
        &self,
        visit: &Visit,
        out: &Path,
        tell: &mut dyn FnMut(usize),
    ) -> Result<SessionSummary, WorldError> {
        let (params, index) = (self.params, visit.session.index);
        let studio = Studio {
            params,
            lenses: &self.lenses,
            visit,
            scene: Scene::build(
                params,
                &self.layout,
                index,
                &self.floor,
                &visit.parked,
                &visit.walkers,
            ),
            exposure: Exposure::of_session(params, index),
        };
        let take = |shot: usize, camera: usize, scratch: &mut Scratch| {
            let dark = params.dark_camera.as_deref() == Some(self.rig[camera].name);
            let grey = if dark {
                studio.darkness(shot, camera)
            } else {
                studio.image(shot, camera, scratch)
            };
            let size = [params.width_px, params.height_px];
            Ok(vec![jpeg(
                size,
                ColorType::Luma,
                params.jpeg_quality,
                &grey,
            )?])
        };
        visit.session.record(out, &self.sensors(), &take, tell)
    }
}

/// All that is needed to render one session.
struct Studio<'a> {
    params: &'a CarPark,
    lenses: &'a [Lens],
    visit: &'a Visit,
    scene: Scene,
    exposure: Exposure,
}

impl Studio<'_> {
    /// The grey image of one camera at one shot, row by row.
    fn image(&self, shot: usize, camera: usize, scratch: &mut Scratch) -> Vec<u8> {
        let session = &self.visit.session;
        let stamp = session.stamps[shot];
        let moving = self
            .scene
            .walkers_at(&self.visit.walkers, session.seconds(stamp));
        render(
            &self.scene,
            &moving,
            &self.lenses[camera],
            &session.map_from_vehicle(stamp),
            &self.exposure,
            self.noise_seed(shot, camera),
            scratch,
        )
    }

    /// What a camera without light sees: the noise of its sensor.
    fn darkness(&self, shot: usize, camera: usize) -> Vec<u8> {
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
        scramble(scramble(self.params.seed) ^ place)
    }
}
