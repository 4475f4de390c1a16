#![doc = include_str!("class_scores.md")]

use evermap_algorithms::learning::pixel_classifier::{PixelClassifier, quantised};
use evermap_algorithms::learning::pixel_features::FeatureDescription;
use evermap_algorithms::learning::random_forest::{Node, Tree, prior_factors, with_priors};
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::layers::{ClassScores, DecisionTree, Source, TreeNode};
use evermap_schemas::roles::Frame;
use evermap_schemas::{Bytes, Stamp};
use evermap_vision::Rgb;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::colours;

/// See the module's page.
pub struct ClassScoring;

/// How images are scored.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ClassScoringParams {
    /// Side of a cell (px).
    #[schemars(range(min = 1, max = 256))]
    pub stride_px: u32,
    /// Classes count by their frequency to this power. On CamVid, -0.2 is best for the sum of pixels right and class
    /// average, for contiguous folds as for interleaved ones; 0.2 gives the most pixels, -0.4 the best class average.
    #[schemars(range(min = -2.0, max = 2.0))]
    pub prior_power: f64,
}

impl Default for ClassScoringParams {
    fn default() -> Self {
        Self {
            stride_px: 2,
            prior_power: -0.2,
        }
    }
}

impl Operator for ClassScoring {
    const NAME: &'static str = "class_scores";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("class_scores.md");
    type Params = ClassScoringParams;
    type Output = ClassScores;

    fn work() -> Work<Self::Params> {
        let frames = Port::session::<Frame>("frames").pixels("image");
        let forest = Port::site::<DecisionTree>("forest");
        Work::each_image(frames, vec![forest], Scorer::new, Scorer::scores)
    }
}

struct Scorer {
    stride_px: u32,
    /// None where the site has no forest.
    model: Option<Model>,
}

impl Scorer {
    fn new(params: &ClassScoringParams, sides: &Sides) -> Result<Self, Fault> {
        let trees = sides.rows::<DecisionTree>("forest")?;
        Ok(Self {
            stride_px: params.stride_px,
            model: Model::new(trees, params.prior_power)?,
        })
    }

    fn scores(
        &self,
        frame: Frame,
        bytes: &[u8],
        rgb: &mut Rgb,
    ) -> Result<Option<ClassScores>, Reason> {
        let model = self.model.as_ref().ok_or("site has no forest")?;
        let image = colours(bytes, rgb)?;
        let block = model.block(&frame.session, frame.stamp);
        let mut scores = model
            .classifier
            .scores(&image, block, self.stride_px)
            .map_err(|_| "features cannot be computed")?;
        for cell in scores.chunks_exact_mut(model.classes.len()) {
            with_priors(cell, &model.factors);
        }
        Ok(Some(ClassScores {
            site: frame.site,
            session: frame.session,
            stamp: frame.stamp,
            camera: frame.camera,
            width: rgb.width,
            height: rgb.height,
            stride_px: self.stride_px,
            classes: model.classes.clone(),
            probabilities: Bytes(scores.into_iter().map(quantised).collect()),
        }))
    }
}

/// A site's forest, ready to predict.
struct Model {
    classifier: PixelClassifier,
    classes: Vec<String>,
    /// What counts for each class by its frequency.
    factors: Vec<f32>,
    /// The parts of sessions that some trees have held out, by the number of the block.
    held_out: Vec<Vec<Source>>,
}

impl Model {
    fn new(rows: Vec<DecisionTree>, prior_power: f64) -> Result<Option<Self>, Fault> {
        let wrong = |text: String| Fault::data(format!("port forest: {text}"));
        let Some(first) = rows.first() else {
            return Ok(None);
        };
        let (classes, features, priors) = (
            first.classes.clone(),
            first.features.clone(),
            first.priors.clone(),
        );
        let what: FeatureDescription = serde_json::from_str(&features)
            .map_err(|error| wrong(format!("column features: {error}")))?;
        let mut held_out = Vec::new();
        let mut trees = Vec::with_capacity(rows.len());
        for row in rows {
            if row.classes != classes || row.features != features || row.priors != priors {
                return Err(wrong(format!(
                    "expected all trees of a site to have the same classes, features and priors; tree {} has others",
                    row.tree
                )));
            }
            trees.push(tree(row, &mut held_out));
        }
        if priors.len() != classes.len() {
            return Err(wrong("expected a prior for each class".to_owned()));
        }
        let classifier = PixelClassifier::new(what, &trees, classes.len())
            .map_err(|error| wrong(error.to_string()))?;
        Ok(Some(Self {
            factors: prior_factors(&priors, prior_power),
            classifier,
            classes,
            held_out,
        }))
    }

    /// The block that an image belongs to, if it was learnt from.
    fn block(&self, session: &str, stamp: Stamp) -> Option<u32> {
        let within = |part: &Source| {
            part.session == session && (part.first_stamp..=part.last_stamp).contains(&stamp)
        };
        let block = self
            .held_out
            .iter()
            .position(|parts| parts.iter().any(within));
        block.map(|block| block as u32)
    }
}

fn tree(row: DecisionTree, held_out: &mut Vec<Vec<Source>>) -> Tree {
    let block = (!row.held_out.is_empty()).then(|| {
        let known = held_out.iter().position(|parts| *parts == row.held_out);
        known.unwrap_or_else(|| {
            held_out.push(row.held_out.clone());
            held_out.len() - 1
        })
    });
    let node = |node: &TreeNode| Node {
        feature: node.feature,
        threshold: node.threshold,
        left: node.left,
        leaf: node.leaf,
    };
    Tree {
        nodes: row.nodes.iter().map(node).collect(),
        distributions: row.distributions,
        held_out: block.map(|block| block as u32),
    }
}
