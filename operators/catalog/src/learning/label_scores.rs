#![doc = include_str!("label_scores.md")]

use arrow::array::RecordBatch;
use evermap_contract::{Emit, Fault, Grain, Kernel, MapKernel, Mapper, Operator, Port, Sides};
use evermap_schemas::layers::{ClassScores, LabelImage};
use evermap_schemas::{Bytes, rows};
use evermap_vision::decode_labels;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::rig::Reason;

/// See the module's page.
pub struct LabelScores;

/// How far labels are trusted.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LabelScoresParams {
    /// The share of labels that are right.
    pub confidence: f64,
}

impl Default for LabelScoresParams {
    fn default() -> Self {
        Self { confidence: 0.8 }
    }
}

impl Operator for LabelScores {
    const NAME: &'static str = "label_scores";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("label_scores.md");
    type Params = LabelScoresParams;
    type Output = ClassScores;

    fn ports() -> Vec<Port> {
        vec![Port::of::<LabelImage>("labels", Grain::Row)]
    }

    fn kernel(LabelScoresParams { confidence }: LabelScoresParams) -> Result<Kernel, Fault> {
        if !(0.0..=1.0).contains(&confidence) {
            return Err(Fault::user(format!(
                "expected confidence from 0 to 1, found {confidence}"
            )));
        }
        Ok(Kernel::Map(Box::new(Truster { confidence })))
    }
}

#[derive(Clone, Copy)]
struct Truster {
    confidence: f64,
}

impl MapKernel for Truster {
    fn open(&self, _: &Sides) -> Result<Box<dyn Mapper>, Fault> {
        Ok(Box::new(*self))
    }
}

impl Mapper for Truster {
    fn map(&self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        for row in rows::<LabelImage>(batch)? {
            match self.scores(row) {
                Ok(row) => emit.rows(vec![row])?,
                Err(reason) => emit.skip(reason, 1),
            }
        }
        Ok(())
    }
}

impl Truster {
    fn scores(&self, row: LabelImage) -> Result<ClassScores, Reason> {
        let labels = decode_labels(&row.png.0).map_err(|_| "labels do not decode")?;
        if [labels.width, labels.height] != [row.width, row.height] {
            return Err("labels have another size than their row says");
        }
        let classes = row.classes.len();
        if classes == 0 {
            return Err("there are no classes");
        }
        let unit = |probability: f64| (255.0 * probability).round() as u8;
        let right = unit(self.confidence);
        let wrong = unit((1.0 - self.confidence) / (classes.max(2) - 1) as f64);
        let unknown = unit(1.0 / classes as f64);
        let mut probabilities = Vec::with_capacity(classes * labels.data.len());
        for label in &labels.data {
            let label = usize::from(*label);
            let others = if label < classes { wrong } else { unknown };
            probabilities.resize(probabilities.len() + classes, others);
            if label < classes {
                let at = probabilities.len() - classes + label;
                probabilities[at] = right;
            }
        }
        Ok(ClassScores {
            site: row.site,
            session: row.session,
            stamp: row.stamp,
            camera: row.camera,
            width: row.width,
            height: row.height,
            stride_px: 1,
            classes: row.classes,
            probabilities: Bytes(probabilities),
        })
    }
}
