//! A street with houses, trees, signs and cars, seen in panoramas.
//!
//! ```text
//! course ── stretch ── ground ─┐
//!                └──── town ───┴─ sight ─┬─ views ── labeller
//! visit ─── traffic ─────────────────────┘     └──── paint
//!      └─── truth
//! ```

mod classes;
mod course;
mod ground;
mod labeller;
mod paint;
mod params;
mod sight;
mod stretch;
#[cfg(test)]
mod tests;
mod things;
mod town;
mod traffic;
mod truth;
mod views;
mod visit;

pub use classes::STREET_CLASSES;
pub use params::Street;
pub use views::{LabelKind, LabelView, StreetLabels, street_labels};

use crate::WorldError;
use crate::random::{normal, stream};
use crate::record::{
    Folder, Progress, Recorded, Sensors, SessionSummary, Stopped, Summary, Waits, World, deep_png,
    grey_png, jpeg, simulate,
};
use classes::Class;
use jpeg_encoder::ColorType;
use paint::Light;
use std::path::{Path, PathBuf};
use views::values;
use visit::Visit;

/// Simulates a street and writes into `out`: for each visit a folder with its session
/// (`visit_a/visit_a.mcap`) and the truth about it, and the folder `truth` with what is true of
/// all. Each folder appears under its name only when it is complete.
///
/// # Errors
/// [`WorldError::Parameters`] before anything is written, [`WorldError::Stopped`] once `is_stopped` says that nobody wants
/// it any more; otherwise when a file cannot be written.
pub fn street(
    world: &Street,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
    is_stopped: &Stopped<'_>,
) -> Result<Summary, WorldError> {
    simulate(&street_labels(world)?, out, progress, is_stopped)
}

/// The images of a shot; colour and depth only if they are wanted.
static IMAGES: [(&str, &str); 4] = [
    ("labels", "png"),
    ("labels_noisy", "png"),
    ("image/compressed", "jpeg"),
    ("depth", "png"),
];

impl World for StreetLabels {
    type Visit = Visit;

    fn visits(&self) -> &[Visit] {
        &self.visits
    }

    fn sensors(&self) -> Sensors {
        let names = STREET_CLASSES.iter().enumerate();
        let images = if self.params.colour { 4 } else { 2 };
        Sensors {
            cameras: vec![self.camera.clone()],
            images: &IMAGES[..images],
            delay_ns: 8_000_000..12_000_000,
            spread_ns: 0..6_000_000,
            label_classes: names
                .map(|(value, name)| (value.to_string(), (*name).to_owned()))
                .collect(),
        }
    }

    fn write_truth(&self, out: &Path) -> Result<PathBuf, WorldError> {
        truth::write_world(self, out)
    }

    fn record(&self, visit: &Visit, out: &Path, waits: &mut Waits<'_>) -> Recorded {
        let session = &visit.session;
        let folder = Folder::create(out, &session.name)?;
        truth::write_visit(self, visit, &folder)?;
        let light = Light::new(&self.params, session.index);
        let take = |shot: usize, _| self.take(session.index, &light, shot, &folder);
        let summary = session.record(folder.path(), &self.sensors(), &take, waits)?;
        let path = folder.finish()?.join(format!("{}.mcap", session.name));
        Ok(SessionSummary { path, ..summary })
    }
}

impl StreetLabels {
    /// The images of a shot. What labels would be without cars is written into the folder.
    fn take(
        &self,
        visit: usize,
        light: &Light,
        shot: usize,
        folder: &Folder,
    ) -> Result<Vec<Vec<u8>>, WorldError> {
        let size = self.camera.size;
        let png = |classes: &[Class]| grey_png(size, &values(classes));
        let sight = self.sight(visit, shot);
        let exact = self.scenery.classes(&sight, &sight.hits);
        let bare = self.scenery.classes(&sight, &sight.bare);
        let noisy = self.labeller.noisy(&sight, &exact, [visit, shot]);
        folder.save(&format!("static_labels/{shot:06}.png"), &png(&bare)?)?;
        let mut images = vec![png(&exact)?, png(&noisy)?];
        if self.params.colour {
            let chance = |purpose| stream(self.params.seed ^ visit as u64, purpose, shot as u64);
            let mut rgb = light.panorama(&self.scenery, &sight, &exact);
            let mut rng = chance("sensor");
            for value in &mut rgb {
                let noise = f64::from(light.noise) * normal(&mut rng);
                *value = (f64::from(*value) + noise).clamp(0.0, 255.0) as u8;
            }
            let quality = self.params.jpeg_quality;
            images.push(jpeg(size, ColorType::Rgb, quality, &rgb)?);
            let mut rng = chance("depth");
            let depth = sight.hits.depth(|| normal(&mut rng) as f32);
            images.push(deep_png(size, &depth)?);
        }
        Ok(images)
    }
}
