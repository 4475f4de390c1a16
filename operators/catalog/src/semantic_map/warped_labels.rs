#![doc = include_str!("warped_labels.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::semantic_map::stable::occlusion;
use evermap_algorithms::semantic_map::stable::registration::State;
use evermap_algorithms::semantic_map::stable::warp::{LabelledView, replaced};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{LabelImage, Occluded, SphereView, ViewRegistration, WarpedLabels};
use evermap_vision::{Grey, encode_png};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::spheres::{MovingClasses, OpenSphere, Spheres, ViewKey, labels};

/// See the module's page.
pub struct WarpedLabelImages;

/// What is replaced, and by what.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct WarpedLabelsParams {
    /// Other views that are looked through for each view, at most: those that fit best.
    #[schemars(range(min = 1))]
    pub views: u32,
    /// Inverse ranges that differ by no more than this are of one surface (1/m), as votes of neighbouring views have it.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub same_per_m: f64,
    /// What moves.
    #[serde(flatten)]
    pub classes: MovingClasses,
}

impl Default for WarpedLabelsParams {
    fn default() -> Self {
        Self {
            views: 4,
            same_per_m: 0.005,
            classes: MovingClasses::default(),
        }
    }
}

impl Operator for WarpedLabelImages {
    const NAME: &'static str = "warped_labels";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("warped_labels.md");
    type Params = WarpedLabelsParams;
    type Output = WarpedLabels;

    fn work() -> Work<Self::Params> {
        let labels = Port::session::<LabelImage>("labels");
        let sides = vec![
            Port::site::<ViewRegistration>("registrations"),
            Port::site::<SphereView>("spheres"),
            Port::site::<LabelImage>("label_images"),
        ];
        Work::each_row(labels, sides, Site::new, Site::warped)
    }
}

/// Another view, as the view at hand sees it.
struct Link {
    other: ViewKey,
    this_from_other: Pose,
    /// Share of points that fit.
    fits: f64,
}

struct Site {
    params: WarpedLabelsParams,
    spheres: Spheres,
    /// The best first.
    links: BTreeMap<ViewKey, Vec<Link>>,
}

impl Site {
    /// Registrations go both ways; those that failed go neither.
    fn new(params: &WarpedLabelsParams, sides: &Sides) -> Result<Self, Fault> {
        let mut links: BTreeMap<ViewKey, Vec<Link>> = BTreeMap::new();
        for row in sides.rows::<ViewRegistration>("registrations")? {
            let pose = row.map_view_from_view.as_ref();
            let pose = pose.and_then(|pose| Pose::from_array(pose.to_array()).ok());
            let Some(pose) = pose.filter(|_| row.state == State::Converged.name()) else {
                continue;
            };
            let here = (row.map_session, row.map_camera, row.map_stamp);
            let there = (row.session, row.camera, row.stamp);
            let fits = row.overlap * row.inliers;
            let both = [
                (here.clone(), there.clone(), pose),
                (there, here, pose.inverse()),
            ];
            for (this, other, this_from_other) in both {
                links.entry(this).or_default().push(Link {
                    other,
                    this_from_other,
                    fits,
                });
            }
        }
        for of_view in links.values_mut() {
            of_view.sort_by(|a, b| b.fits.total_cmp(&a.fits).then(a.other.cmp(&b.other)));
            of_view.truncate(params.views as usize);
        }
        Ok(Self {
            params: params.clone(),
            spheres: Spheres::new(sides)?,
            links,
        })
    }

    fn warped(&self, row: LabelImage) -> Result<[WarpedLabels; 1], Reason> {
        let before = labels(&row)?;
        let kinds = self.params.classes.kinds(&row.classes)?;
        let key = (row.session.clone(), row.camera.clone(), row.stamp);
        let links = self.links.get(&key).map_or(&[][..], Vec::as_slice);
        let mut others = Vec::new();
        for link in links {
            if let Some((sphere, labels)) = self.seen(&link.other, &row.classes) {
                others.push((sphere, labels, link.this_from_other));
            }
        }
        let this = match others.is_empty() {
            true => None,
            false => Some(self.spheres.open(&key, false)?),
        };
        let after = match &this {
            Some(sphere) => {
                let this = view(sphere, &before);
                let sized = others.iter().filter_map(|(sphere, labels, pose)| {
                    let other = view(sphere, labels);
                    other.is_sound().then_some((other, *pose))
                });
                let others: Vec<(LabelledView<'_>, Pose)> = sized.collect();
                if !this.is_sound() {
                    return Err("label image has another size than its panorama");
                }
                replaced(&this, &others, &kinds, self.params.same_per_m)
            }
            None => before.clone(),
        };
        let (counts, unseen_px) = occlusion::count(&before, &after, &kinds);
        let name = |class: u8| row.classes[usize::from(class)].clone();
        let occlusions = counts.iter().map(|count| Occluded {
            dynamic: name(count.dynamic),
            class: name(count.class),
            pixels: count.pixels,
        });
        let image = Grey {
            width: row.width,
            height: row.height,
            data: after,
        };
        Ok([WarpedLabels {
            occlusions: occlusions.collect(),
            unseen_px,
            views: others.len() as u32,
            png: Bytes(encode_png(&image).map_err(|_| "label image does not encode")?),
            site: row.site,
            session: row.session,
            stamp: row.stamp,
            camera: row.camera,
            width: row.width,
            height: row.height,
            classes: row.classes,
        }])
    }

    /// Another view with labels of the same classes; `None` where something of it is missing.
    fn seen(&self, view: &ViewKey, classes: &[String]) -> Option<(OpenSphere, Vec<u8>)> {
        let row = self.spheres.labels(view)?;
        let alike = row.classes == classes;
        let labels = labels(row).ok().filter(|_| alike)?;
        Some((self.spheres.open(view, false).ok()?, labels))
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
