#![doc = include_str!("label_scores.md")]

use evermap_algorithms::semantic_map::class_scores::of_labels;
use evermap_contract::{Operator, Port, Reason, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{ClassScores, LabelImage};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::labels;

/// See the module's page.
pub struct LabelScores;

/// How far labels are trusted.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct LabelScoresParams {
    /// The share of labels that are right. Votes do not depend on it; in a random field it says how soon neighbours
    /// overrule a label.
    #[schemars(range(min = 0.0, max = 1.0))]
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

    fn work() -> Work<Self::Params> {
        let labels = Port::session::<LabelImage>("labels");
        Work::each_row(labels, vec![], |params, _| Ok(params.clone()), scores)
    }
}

fn scores(params: &LabelScoresParams, row: LabelImage) -> Result<Option<ClassScores>, Reason> {
    let labels = labels(&row)?;
    if row.classes.is_empty() {
        return Err("there are no classes".into());
    }
    let probabilities = of_labels(&labels, row.classes.len(), params.confidence);
    Ok(Some(ClassScores {
        site: row.site,
        session: row.session,
        stamp: row.stamp,
        camera: row.camera,
        width: row.width,
        height: row.height,
        stride_px: 1,
        classes: row.classes,
        probabilities: Bytes(probabilities),
    }))
}
