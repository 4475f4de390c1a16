#![doc = include_str!("class_scores.md")]

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_algorithms::learning::dense_crf::ColourView;
use evermap_algorithms::learning::pixel_classifier::{PixelClassifier, quantised};
use evermap_algorithms::learning::pixel_features::FeatureDescription;
use evermap_algorithms::learning::random_forest::{Node, Tree, prior_factors, with_priors};
use evermap_contract::{Emit, Fault, Grain, Kernel, MapKernel, Mapper, Operator, Port, Sides};
use evermap_schemas::layers::{ClassScores, DecisionTree, Source};
use evermap_schemas::roles::Frame;
use evermap_schemas::{Bytes, Stamp, record};
use evermap_vision::{Decoder, Rgb};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::images::each_image;
use crate::inputs::rig::Reason;

/// See the module's page.
pub struct ClassScoring;

/// How images are scored.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ClassScoringParams {
    /// Side of a cell.
    pub stride_px: u32,
    /// Classes count by their frequency to this power.
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

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<Frame>("frames", Grain::Row).with_pixels("image"),
            Port::of::<DecisionTree>("forest", Grain::Whole),
        ]
    }

    fn kernel(params: ClassScoringParams) -> Result<Kernel, Fault> {
        if !(1..=256).contains(&params.stride_px) {
            return Err(Fault::user(format!(
                "expected stride_px from 1 to 256, found {}",
                params.stride_px
            )));
        }
        if !(-2.0..=2.0).contains(&params.prior_power) {
            return Err(Fault::user(format!(
                "expected prior_power from -2 to 2, found {}",
                params.prior_power
            )));
        }
        Ok(Kernel::Map(Box::new(Opener { params })))
    }
}

struct Opener {
    params: ClassScoringParams,
}

impl MapKernel for Opener {
    fn open(&self, sides: &Sides) -> Result<Box<dyn Mapper>, Fault> {
        let mut trees: BTreeMap<String, Vec<DecisionTree>> = BTreeMap::new();
        for tree in sides.rows::<DecisionTree>("forest")? {
            trees.entry(tree.site.clone()).or_default().push(tree);
        }
        let model = |(site, trees): (String, Vec<DecisionTree>)| {
            Ok((site, Model::new(trees, self.params.prior_power)?))
        };
        let models = trees.into_iter().map(model);
        Ok(Box::new(Scorer {
            stride_px: self.params.stride_px,
            models: models.collect::<Result<_, Fault>>()?,
        }))
    }
}

/// One site's forest, ready to predict.
struct Model {
    classifier: PixelClassifier,
    classes: Vec<String>,
    /// What counts for each class by its frequency.
    factors: Vec<f32>,
    /// The parts of sessions that some trees have held out, by the number of the block.
    held_out: Vec<Vec<Source>>,
}

impl Model {
    fn new(rows: Vec<DecisionTree>, prior_power: f64) -> Result<Self, Fault> {
        let wrong = |text: String| Fault::data(format!("port forest: {text}"));
        let Some(first) = rows.first() else {
            return Err(wrong("expected at least one tree".to_owned()));
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
        Ok(Self {
            factors: prior_factors(&priors, prior_power),
            classifier,
            classes,
            held_out,
        })
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
    let node = |node: &evermap_schemas::layers::TreeNode| Node {
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

struct Scorer {
    stride_px: u32,
    /// By site.
    models: BTreeMap<String, Model>,
}

record! {
    /// The columns of a frame beside its pixels.
    pub struct Look {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Exposure.
        stamp: Stamp,
        /// Camera.
        camera: String,
    }
}

impl Mapper for Scorer {
    fn map(&self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        each_image(batch, "frames", emit, |look, bytes, rgb| {
            self.row(look, bytes, rgb)
        })
    }
}

impl Scorer {
    fn row(&self, look: Look, bytes: &[u8], rgb: &mut Rgb) -> Result<ClassScores, Reason> {
        let model = self.models.get(&look.site).ok_or("site has no forest")?;
        Decoder::new()
            .decode_colour_into(bytes, rgb)
            .map_err(|_| "image does not decode")?;
        let image =
            ColourView::new(rgb.width, rgb.height, &rgb.data).ok_or("image does not decode")?;
        let block = model.block(&look.session, look.stamp);
        let mut scores = model
            .classifier
            .scores(&image, block, self.stride_px)
            .map_err(|_| "features cannot be computed")?;
        for cell in scores.chunks_exact_mut(model.classes.len()) {
            with_priors(cell, &model.factors);
        }
        Ok(ClassScores {
            site: look.site,
            session: look.session,
            stamp: look.stamp,
            camera: look.camera,
            width: rgb.width,
            height: rgb.height,
            stride_px: self.stride_px,
            classes: model.classes.clone(),
            probabilities: Bytes(scores.into_iter().map(quantised).collect()),
        })
    }
}
