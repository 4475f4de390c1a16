#![doc = include_str!("pixel_forest.md")]

use evermap_algorithms::learning::random_forest::{ForestOptions, Node, Tree, train};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{DecisionTree, PixelSamples, TreeNode};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::samples::SiteSamples;

/// See the module's page.
pub struct PixelForest;

/// How the forest is learnt.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PixelForestParams {
    /// How each tree is learnt.
    #[serde(flatten)]
    pub forest: ForestOptions,
    /// Stretches of each session, of which each tree holds one out; 1: none is held out.
    #[schemars(range(min = 1, max = 10_000))]
    pub blocks: u32,
}

impl Default for PixelForestParams {
    fn default() -> Self {
        Self {
            forest: ForestOptions::default(),
            blocks: 5,
        }
    }
}

impl Operator for PixelForest {
    const NAME: &'static str = "pixel_forest";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("pixel_forest.md");
    type Params = PixelForestParams;
    type Output = DecisionTree;

    fn work() -> Work<Self::Params> {
        let samples = Port::site::<PixelSamples>("samples");
        Work::group(samples, Key::SITE, vec![], forest)
    }
}

fn forest(
    params: &PixelForestParams,
    samples: Vec<PixelSamples>,
    _: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = samples[0].site.clone();
    let all = SiteSamples::of(samples, params.blocks, emit);
    let priors = all.priors();
    let row = |(tree, learnt): (usize, Tree)| DecisionTree {
        site: site.clone(),
        tree: tree as u32,
        classes: all.classes.clone(),
        features: all.features.clone(),
        nodes: learnt.nodes.iter().map(node).collect(),
        distributions: learnt.distributions,
        priors: priors.clone(),
        held_out: all.parts(learnt.held_out),
    };
    let trees = train(&all.samples(), &params.forest);
    let rows: Vec<DecisionTree> = trees.into_iter().enumerate().map(row).collect();
    emit.rows(rows)
}

fn node(node: &Node) -> TreeNode {
    TreeNode {
        feature: node.feature,
        threshold: node.threshold,
        left: node.left,
        leaf: node.leaf,
    }
}
