#![doc = include_str!("warped_labels.md")]

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::semantic_map::semantic_graph::VOID;
use evermap_algorithms::semantic_map::stable::links::Links;
use evermap_algorithms::semantic_map::stable::occlusion;
use evermap_algorithms::semantic_map::stable::warp::{LabelledView, Options, replaced};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::layers::{LabelImage, Occluded, SphereView, ViewLink, WarpedLabels};
use nalgebra::Matrix6;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::{label_image, labels};
use crate::inputs::spheres::{MovingClasses, OpenSphere, Spheres, ViewKey};

/// See the module's page.
pub struct WarpedLabelImages;

/// What is replaced, and by what.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct WarpedLabelsParams {
    /// Views are looked through that were taken no farther away than this (m).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub reach_m: f64,
    /// Of those, so many at most: at equal steps from the nearest to the farthest.
    #[schemars(range(min = 1))]
    pub views: u32,
    /// What is believed of what they saw.
    #[serde(flatten)]
    pub options: Options,
    /// What moves.
    #[serde(flatten)]
    pub classes: MovingClasses,
}

impl Default for WarpedLabelsParams {
    fn default() -> Self {
        Self {
            reach_m: 20.0,
            views: 64,
            options: Options::default(),
            classes: MovingClasses::default(),
        }
    }
}

impl Operator for WarpedLabelImages {
    const NAME: &'static str = "warped_labels";
    const VERSION: u32 = 5;
    const PAGE: &'static str = include_str!("warped_labels.md");
    type Params = WarpedLabelsParams;
    type Output = WarpedLabels;

    fn work() -> Work<Self::Params> {
        let labels = Port::session::<LabelImage>("labels");
        let sides = vec![
            Port::site::<ViewLink>("view_links"),
            Port::site::<SphereView>("spheres"),
            Port::site::<LabelImage>("label_images"),
        ];
        Work::each_row(labels, sides, Site::new, Site::warped)
    }
}

struct Site {
    params: WarpedLabelsParams,
    spheres: Spheres,
    links: Links<ViewKey>,
    /// Views that were opened: those of a street are around many others.
    opened: Mutex<BTreeMap<ViewKey, Arc<OpenedView>>>,
}

/// Views that are kept open at most: 1 MB each of 1024 × 333 px.
const MOST_OPEN: usize = 128;

/// Another view, opened.
struct OpenedView {
    sphere: OpenSphere,
    labels: Vec<u8>,
}

impl Site {
    fn new(params: &WarpedLabelsParams, sides: &Sides) -> Result<Self, Fault> {
        let mut links = Links::new(params.reach_m);
        for row in sides.rows::<ViewLink>("view_links")? {
            let pose = Pose::from_array(row.other_view_from_view.to_array());
            let (Ok(pose), 36) = (pose, row.covariance.len()) else {
                continue;
            };
            let covariance = Matrix6::from_row_slice(&row.covariance);
            let here = (row.other_session, row.other_camera, row.other_stamp);
            let there = (row.session, row.camera, row.stamp);
            links.add(here, there, pose, &covariance);
        }
        Ok(Self {
            params: params.clone(),
            spheres: Spheres::new(sides)?,
            links,
            opened: Mutex::default(),
        })
    }

    fn warped(&self, row: LabelImage) -> Result<[WarpedLabels; 1], Reason> {
        let before = labels(&row)?;
        let kinds = self.params.classes.kinds(&row.classes)?;
        let key = (row.session.clone(), row.camera.clone(), row.stamp);
        self.spheres.fits(&key, &row)?;
        let others = match before.iter().any(|label| kinds.is_dynamic(*label)) {
            true => self.around(&key, &row.classes),
            false => Vec::new(),
        };
        let this = match others.is_empty() {
            true => None,
            false => Some(self.spheres.open(&key, false)?),
        };
        let after = match &this {
            Some(sphere) => {
                let this = view(sphere, &before);
                if !this.is_sound() {
                    return Err("panorama has no unit of range".into());
                }
                let others = others.iter();
                let others = others.map(|(seen, pose)| (view(&seen.sphere, &seen.labels), *pose));
                let others: Vec<(LabelledView<'_>, Pose)> = others.collect();
                replaced(&this, &others, &kinds, &self.params.options)
            }
            None => before.clone(),
        };
        let (counts, unseen_px) = occlusion::count(&before, &after, &kinds);
        let pairs = before.iter().zip(&after);
        let unclear_px = pairs.filter(|(before, after)| **after == VOID && **before != VOID);
        let unclear_px = unclear_px.count() as u64;
        let name = |class: u8| row.classes[usize::from(class)].clone();
        let occlusions = counts.iter().map(|count| Occluded {
            dynamic: name(count.dynamic),
            class: name(count.class),
            pixels: count.pixels,
        });
        Ok([WarpedLabels {
            occlusions: occlusions.collect(),
            unclear_px,
            unseen_px,
            views: others.len() as u32,
            png: label_image([row.width, row.height], after)?,
            site: row.site,
            session: row.session,
            stamp: row.stamp,
            camera: row.camera,
            width: row.width,
            height: row.height,
            classes: row.classes,
        }])
    }

    /// The views to look through, with their poses in this one.
    fn around(&self, view: &ViewKey, classes: &[String]) -> Vec<(Arc<OpenedView>, Pose)> {
        let around = self.links.around(view);
        let step = around.len().div_ceil(self.params.views as usize).max(1);
        let taken = around.into_iter().step_by(step);
        taken
            .filter_map(|(other, this_from_other)| {
                Some((self.seen(other, classes)?, this_from_other))
            })
            .collect()
    }

    /// Another view with labels of the same classes; `None` where something of it is missing or of another size, which is
    /// counted where it is this view's turn.
    fn seen(&self, view: &ViewKey, classes: &[String]) -> Option<Arc<OpenedView>> {
        let row = self
            .spheres
            .labels(view)
            .filter(|row| row.classes == classes)?;
        if let Some(known) = self.opened().get(view) {
            return Some(known.clone());
        }
        let seen = Arc::new(OpenedView {
            labels: labels(row).ok()?,
            sphere: self.spheres.open(view, false).ok()?,
        });
        if !self::view(&seen.sphere, &seen.labels).is_sound() {
            return None;
        }
        let mut opened = self.opened();
        if opened.len() >= MOST_OPEN {
            opened.clear();
        }
        opened.insert(view.clone(), seen.clone());
        Some(seen)
    }

    fn opened(&self) -> MutexGuard<'_, BTreeMap<ViewKey, Arc<OpenedView>>> {
        self.opened.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn view<'a>(sphere: &'a OpenSphere, labels: &'a [u8]) -> LabelledView<'a> {
    LabelledView {
        lens: &sphere.lens,
        labels,
        range: &sphere.range,
        unit_m: sphere.unit_m,
    }
}
