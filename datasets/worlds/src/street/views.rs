//! Label panoramas without files.

use super::classes::Class;
use super::labeller::Labeller;
use super::params::Street;
use super::sight::{Scenery, Sight, panorama_camera};
use super::visit::Visit;
use crate::WorldError;
use crate::record::CameraTopics;
use crate::render::Lens;
use evermap_algorithms::geometry::pose::Pose;
use rayon::prelude::*;

/// Views made before any of them is handed out.
const BATCH: usize = 32;

/// A label panorama.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelView {
    /// Number of the view in its visit.
    pub index: usize,
    /// When it was taken, ns since the epoch.
    pub stamp_ns: u64,
    /// Where the robot was.
    pub map_from_vehicle: Pose,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Values of the classes, row by row: indices into [`crate::STREET_CLASSES`].
    pub labels: Vec<u8>,
}

/// Which labels are wanted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum LabelKind {
    /// Exact ones.
    #[default]
    Exact,
    /// Exact ones of the same view without any car.
    WithoutCars,
    /// As a labeller makes them who errs on `label_noise` of the pixels.
    Noisy,
}

/// A street as built: the label panoramas of its visits, to be asked in any order and on any thread.
pub struct StreetLabels {
    pub(super) params: Street,
    pub(super) scenery: Scenery,
    pub(super) lens: Lens,
    pub(super) camera: CameraTopics,
    pub(super) visits: Vec<Visit>,
    pub(super) labeller: Labeller,
}

/// The label panoramas of a street.
///
/// # Errors
/// [`WorldError::Parameters`] for values that make no world.
pub fn street_labels(world: &Street) -> Result<StreetLabels, WorldError> {
    world.check()?;
    let scenery = Scenery::new(world);
    let visits = (0..world.visits).map(|index| Visit::new(world, &scenery, index));
    let (lens, camera) = panorama_camera(world);
    Ok(StreetLabels {
        params: world.clone(),
        visits: visits.collect(),
        labeller: Labeller::new(world, &scenery),
        lens,
        camera,
        scenery,
    })
}

impl StreetLabels {
    /// Number of views of each visit.
    pub fn len(&self) -> usize {
        let first = self.visits.first();
        first.map_or(0, |visit| visit.session.stamps.len())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// When a view is taken (ns since the epoch) and where the robot is then (`map_from_vehicle`).
    /// `None` when there is no such visit or view.
    pub fn pose(&self, visit: usize, index: usize) -> Option<(u64, Pose)> {
        let session = &self.visits.get(visit)?.session;
        let stamp = *session.stamps.get(index)?;
        Some((stamp, session.map_from_vehicle(stamp)))
    }

    /// One view; `None` when there is no such visit or view.
    pub fn view(&self, visit: usize, index: usize, kind: LabelKind) -> Option<LabelView> {
        let (stamp_ns, map_from_vehicle) = self.pose(visit, index)?;
        let sight = self.sight(visit, index);
        let exact = || self.scenery.classes(&sight, &sight.hits);
        let labels = match kind {
            LabelKind::Exact => exact(),
            LabelKind::WithoutCars => self.scenery.classes(&sight, &sight.bare),
            LabelKind::Noisy => self.labeller.noisy(&sight, &exact(), [visit, index]),
        };
        Some(LabelView {
            index,
            stamp_ns,
            map_from_vehicle,
            width: self.params.width_px,
            height: self.params.height_px,
            labels: values(&labels),
        })
    }

    /// The views of a visit in order, made in batches on all cores.
    pub fn views(&self, visit: usize, kind: LabelKind) -> impl Iterator<Item = LabelView> + '_ {
        (0..self.len()).step_by(BATCH).flat_map(move |from| {
            let batch = (from..from + BATCH).into_par_iter();
            let views = batch.filter_map(|index| self.view(visit, index, kind));
            views.collect::<Vec<LabelView>>()
        })
    }

    /// What is seen in a view of a visit.
    pub(super) fn sight(&self, visit: usize, index: usize) -> Sight<'_> {
        let visit = &self.visits[visit];
        let stamp = visit.session.stamps[index];
        let pose = visit.session.map_from_vehicle(stamp);
        let cars = visit.cars(&self.scenery, stamp);
        self.scenery.look(&self.lens, &pose, &cars)
    }
}

/// The values of classes in label images.
pub(super) fn values(classes: &[Class]) -> Vec<u8> {
    classes.iter().map(|class| *class as u8).collect()
}
