//! Panoramas with range and labels between rows and algorithms.

use std::collections::BTreeMap;

use evermap_algorithms::semantic_map::stable::classes::Kinds;
use evermap_algorithms::semantic_map::stable::registration::{Options, Pyramid, Registration};
use evermap_algorithms::semantic_map::stable::sphere::{Lens, Sphere};
use evermap_contract::{Fault, Reason, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{LabelImage, SphereView};
use evermap_vision::{Grey, decode_depth, decode_grey};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::{labels, left_out, too_many_classes};

/// What classes are like: a parameter of all that tell what moves from what stays.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct MovingClasses {
    /// Classes whose things may be elsewhere the next time, by name. Names that no label has are of no consequence.
    pub dynamic: Vec<String>,
    /// Classes that are too far away to have a range, by name.
    pub far: Vec<String>,
}

impl Default for MovingClasses {
    fn default() -> Self {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        Self {
            dynamic: owned(&[
                "car",
                "truck",
                "bus",
                "van",
                "trailer",
                "motorcycle",
                "bicycle",
                "bicyclist",
                "pedestrian",
                "person",
            ]),
            far: owned(&["sky"]),
        }
    }
}

impl MovingClasses {
    /// Of a list of classes.
    pub(crate) fn kinds(&self, classes: &[String]) -> Result<Kinds, Reason> {
        let kinds = Kinds::new(classes, &self.dynamic, &self.far);
        kinds.map_err(|_| too_many_classes())
    }
}

/// What a forest reads that tells what is behind moving things, as JSON: classes are numbers there.
pub(crate) fn surroundings(classes: &[String]) -> String {
    serde_json::json!({ "surroundings": classes }).to_string()
}

/// Why a view is left out whose pixels have labels of other places: those of an image of another size.
const LABELS_OF_ANOTHER_SIZE: &str = "label image has another size than its panorama";

/// A view's name in a table: session, camera, instant.
pub(crate) type ViewKey = (String, String, Stamp);

/// Panoramas with range of a site, as they are in the table.
pub(crate) struct Spheres {
    rows: BTreeMap<ViewKey, SphereView>,
    labels: BTreeMap<ViewKey, LabelImage>,
}

/// A panorama that was opened: brightness is empty where it was not asked for.
pub(crate) struct OpenSphere {
    pub lens: Lens,
    pub grey: Vec<u8>,
    pub range: Vec<u16>,
    pub unit_m: f64,
}

impl Spheres {
    /// From the ports `spheres` and `label_images`.
    pub(crate) fn new(sides: &Sides) -> Result<Self, Fault> {
        Self::of(sides.rows("spheres")?, sides)
    }

    /// Of these panoramas, with labels from the port `label_images`.
    pub(crate) fn of(rows: Vec<SphereView>, sides: &Sides) -> Result<Self, Fault> {
        let labels = sides.rows::<LabelImage>("label_images")?.into_iter();
        let rows = rows.into_iter();
        Ok(Self {
            rows: rows
                .map(|row| ((row.session.clone(), row.camera.clone(), row.stamp), row))
                .collect(),
            labels: labels
                .map(|row| ((row.session.clone(), row.camera.clone(), row.stamp), row))
                .collect(),
        })
    }

    /// Whether a view has a panorama.
    pub(crate) fn has(&self, view: &ViewKey) -> bool {
        self.rows.contains_key(view)
    }

    /// That a view's label image has the size of its panorama, where it has one.
    ///
    /// # Errors
    /// That it has another one.
    pub(crate) fn fits(&self, view: &ViewKey, labels: &LabelImage) -> Result<(), Reason> {
        let sphere = self.rows.get(view);
        let size = sphere.map(|row| [row.width, row.height]);
        match size.is_none_or(|size| size == [labels.width, labels.height]) {
            true => Ok(()),
            false => Err(LABELS_OF_ANOTHER_SIZE.into()),
        }
    }

    /// A view's panorama at all sizes, to be registered; what moves, where there are labels, has no range in it.
    pub(crate) fn pyramid(
        &self,
        view: &ViewKey,
        classes: &MovingClasses,
        options: &Options,
    ) -> Result<Pyramid, Reason> {
        let mut sphere = self.open(view, true)?;
        if let Some(row) = self.labels(view) {
            self.fits(view, row)?;
            let kinds = classes.kinds(&row.classes)?;
            for (range, label) in sphere.range.iter_mut().zip(labels(row)?) {
                if kinds.is_dynamic(label) {
                    *range = 0;
                }
            }
        }
        let sphere = Sphere {
            lens: &sphere.lens,
            grey: &sphere.grey,
            range: &sphere.range,
            unit_m: sphere.unit_m,
        };
        Pyramid::new(&sphere, options).ok_or("panorama has no range".into())
    }

    /// A view's panorama, with its brightness if that is asked for.
    pub(crate) fn open(&self, view: &ViewKey, with_grey: bool) -> Result<OpenSphere, Reason> {
        let row = self
            .rows
            .get(view)
            .ok_or("view has no panorama with range")?;
        let range = decode_depth(&row.range.0).map_err(|_| "range image does not decode")?;
        let mut grey = Grey::default();
        if with_grey {
            decode_grey(&row.image.0, &mut grey)
                .map_err(|error| left_out(&error, "image does not decode".into()))?;
        }
        let size = [row.width, row.height];
        let sized = |width, height| [width, height] == size;
        if !sized(range.width, range.height) || with_grey && !sized(grey.width, grey.height) {
            return Err("image has another size than its row says".into());
        }
        let (&[fx, fy], &[cx, cy]) = (row.focal.as_slice(), row.centre.as_slice()) else {
            return Err("panorama has no lens".into());
        };
        let lens = Lens::new(size.map(|side| side as usize), [fx, fy], [cx, cy]);
        Ok(OpenSphere {
            lens: lens.ok_or("panorama has no lens")?,
            grey: grey.data,
            // Beyond range there is no point to register or to move, and so nothing was measured.
            range: measured(range.data),
            unit_m: row.unit_m,
        })
    }

    /// A view's label image; `None` where there is none.
    pub(crate) fn labels(&self, view: &ViewKey) -> Option<&LabelImage> {
        self.labels.get(view)
    }
}

/// Range with 0 for what is beyond it.
fn measured(mut range: Vec<u16>) -> Vec<u16> {
    for value in &mut range {
        *value = if *value == u16::MAX { 0 } else { *value };
    }
    range
}

/// The covariance of a registration as tables have it: 6×6, row by row.
pub(crate) fn covariance(found: &Registration) -> Vec<f64> {
    found.covariance.transpose().iter().copied().collect()
}

/// The standard deviation of its position along the axis that is known least (m).
pub(crate) fn sigma_m(found: &Registration) -> f64 {
    let position = found.covariance.fixed_view::<3, 3>(0, 0).into_owned();
    position.symmetric_eigenvalues().max().max(0.0).sqrt()
}
