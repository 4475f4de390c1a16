//! An underground car park: a hall with bays, pillars and lamps, driven through with four fisheyes.
//!
//! ```text
//! layout ── route ── drive ─┬─ walkers ─┐
//!    ├─ floor, walls, cars ─┴─ scene ───┴─ image
//!    ├─ truth
//!    └─ annotator
//! ```

mod annotator;
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
use crate::record::{Progress, Recorded, Sensors, Stopped, Summary, Waits, World, jpeg, simulate};
use crate::render::Lens;
use canvas::Canvas;
use exposure::Exposure;
use floor::paint_floor;
use image::Studio;
use jpeg_encoder::ColorType;
use rayon::prelude::*;
use rig::{RigCamera, rig};
use scene::Scene;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Simulates a car park and writes into `out`: `initial.mcap`, `revisit_1.mcap`, … and the folder
/// `truth`, and `annotations.mcap` where it is asked for. Each file appears under its name only when it is complete.
///
/// # Errors
/// [`WorldError::Parameters`] before anything is written, [`WorldError::Stopped`] once `is_stopped` says that nobody wants
/// it any more; otherwise when a file cannot be written.
pub fn car_park(
    world: &CarPark,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
    is_stopped: &Stopped<'_>,
) -> Result<Summary, WorldError> {
    world.check()?;
    let hall = Hall::new(world);
    let mut summary = simulate(&hall, out, progress, is_stopped)?;
    if world.annotations {
        summary.annotations = Some(annotator::write(&hall, out)?);
    }
    Ok(summary)
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
        // Tyres have left their marks on the whole round trip, however little of it is driven today.
        let worn = Route::of_session(params, 0).path(&layout, 0.0, 2.0);
        Self {
            visits: (0..=params.revisits)
                .map(|index| Visit::new(params, &layout, index))
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

    fn sensors(&self) -> Sensors {
        Sensors {
            cameras: self
                .rig
                .iter()
                .map(|camera| camera.topics.clone())
                .collect(),
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

    fn record(&self, visit: &Visit, out: &Path, waits: &mut Waits<'_>) -> Recorded {
        let params = self.params;
        let studio = Studio {
            seed: params.seed,
            lenses: &self.lenses,
            visit,
            scene: Scene::build(params, &self.layout, &self.floor, visit),
            exposure: Exposure::of_session(params, visit.session.index),
        };
        let take = |shot: usize, camera: usize| {
            let dark = params.dark_camera.as_deref() == Some(self.rig[camera].name);
            let grey = if dark {
                studio.darkness(shot, camera)
            } else {
                studio.image(shot, camera)
            };
            let size = [params.width_px, params.height_px];
            let image = jpeg(size, ColorType::Luma, params.jpeg_quality, &grey)?;
            Ok(vec![image])
        };
        visit.session.record(out, &self.sensors(), &take, waits)
    }
}
