#![doc = include_str!("occlusion_samples.md")]

use std::collections::BTreeMap;

use evermap_algorithms::semantic_map::semantic_graph::Labels;
use evermap_algorithms::semantic_map::stable::surroundings::{DIMENSIONS, examples};
use evermap_contract::{Fault, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{LabelImage, PixelSamples, WarpedLabels};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::lenses::{self, Lenses};
use crate::inputs::pixels::{labels, values};
use crate::inputs::spheres::{MovingClasses, ViewKey, surroundings};

/// See the module's page.
pub struct OcclusionSamples;

/// Which pixels are taken.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct OcclusionSamplesParams {
    /// Pixels of each view, at most: at equal steps of those that qualify, for each way that holes are
    /// moved.
    #[schemars(range(min = 1))]
    pub samples: u32,
    /// What moves.
    #[serde(flatten)]
    pub classes: MovingClasses,
}

impl Default for OcclusionSamplesParams {
    fn default() -> Self {
        Self {
            samples: 1000,
            classes: MovingClasses::default(),
        }
    }
}

impl Operator for OcclusionSamples {
    const NAME: &'static str = "occlusion_samples";
    const VERSION: u32 = 4;
    const PAGE: &'static str = include_str!("occlusion_samples.md");
    type Params = OcclusionSamplesParams;
    type Output = PixelSamples;

    fn work() -> Work<Self::Params> {
        let warped = Port::session::<WarpedLabels>("warped_labels");
        let before = Port::site::<LabelImage>("label_images");
        Work::each_row(
            warped,
            vec![before, lenses::port(Reach::Session)],
            Site::new,
            Site::samples,
        )
    }
}

struct Site {
    params: OcclusionSamplesParams,
    before: BTreeMap<ViewKey, LabelImage>,
    lenses: Lenses,
}

impl Site {
    fn new(params: &OcclusionSamplesParams, sides: &Sides) -> Result<Self, Fault> {
        let before = sides.rows::<LabelImage>("label_images")?.into_iter();
        let before = before.map(|row| ((row.session.clone(), row.camera.clone(), row.stamp), row));
        Ok(Self {
            params: params.clone(),
            before: before.collect(),
            lenses: Lenses::new(sides)?,
        })
    }

    fn samples(&self, row: WarpedLabels) -> Result<Option<PixelSamples>, Reason> {
        let size = [row.width, row.height];
        let after = values(&row.png.0, size)?;
        let key = (row.session, row.camera, row.stamp);
        let before = self.before.get(&key).ok_or("view has no label image")?;
        if before.classes != row.classes || [before.width, before.height] != size {
            return Err("label image is another one than was warped".into());
        }
        let before = labels(before)?;
        let kinds = self.params.classes.kinds(&row.classes)?;
        let seen = before.iter().zip(&after);
        let seen =
            seen.filter(|(before, after)| kinds.is_dynamic(**before) && kinds.is_static(**after));
        let mut class_pixels = vec![0; row.classes.len()];
        for (_, after) in seen {
            class_pixels[usize::from(*after)] += 1;
        }
        let image = Labels {
            width: row.width,
            height: row.height,
            values: &after,
        };
        let most = self.params.samples as usize;
        let wraps = self.lenses.wraps((&key.0, &key.1, key.2), size);
        let found = examples(&before, &image, wraps, &kinds, most);
        if found.classes.is_empty() {
            return Ok(None);
        }
        let (session, camera, stamp) = key;
        Ok(Some(PixelSamples {
            site: row.site,
            session,
            stamp,
            camera,
            features: surroundings(&row.classes),
            classes: row.classes,
            class_pixels,
            dimensions: DIMENSIONS as u32,
            labels: found.classes,
            values: Bytes(found.values),
        }))
    }
}
