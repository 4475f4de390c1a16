#![doc = include_str!("pixel_forest.md")]

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::learning::random_forest::{ForestOptions, Samples, Tree, train};
use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, group_whole};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{DecisionTree, PixelSamples, Sources, TreeNode};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// See the module's page.
pub struct PixelForest;

/// How the forest is learnt.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PixelForestParams {
    /// Number of trees.
    pub trees: u32,
    /// Features tried at each node; 0: four times the square root of their number.
    pub tried_features: u32,
    /// Nodes this deep are leaves.
    pub max_depth: u32,
    /// The least samples at a leaf.
    pub min_leaf: u32,
    /// Samples weigh by their class's inverse frequency to this power.
    pub balance: f64,
    /// Parts of each session, of which every tree holds one out; 1: none.
    pub blocks: u32,
    /// Where random numbers start.
    pub seed: u64,
}

impl Default for PixelForestParams {
    fn default() -> Self {
        let ForestOptions {
            trees,
            tried_features,
            max_depth,
            min_leaf,
            balance,
            seed,
        } = ForestOptions::default();
        Self {
            trees,
            tried_features,
            max_depth,
            min_leaf,
            balance,
            blocks: 5,
            seed,
        }
    }
}

impl Operator for PixelForest {
    const NAME: &'static str = "pixel_forest";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("pixel_forest.md");
    type Params = PixelForestParams;
    type Output = DecisionTree;

    fn ports() -> Vec<Port> {
        vec![Port::of::<PixelSamples>("samples", Grain::Whole)]
    }

    fn kernel(params: PixelForestParams) -> Result<Kernel, Fault> {
        for (name, found) in [("trees", params.trees), ("blocks", params.blocks)] {
            if !(1..=10_000).contains(&found) {
                let expected = format!("expected {name} from 1 to 10000, found {found}");
                return Err(Fault::user(expected));
            }
        }
        if !(0.0..=2.0).contains(&params.balance) {
            return Err(Fault::user(format!(
                "expected balance from 0 (samples weigh the same) to 2, found {}",
                params.balance
            )));
        }
        Ok(group_whole(move |samples: Vec<PixelSamples>, _, emit| {
            let Some(first) = samples.first() else {
                return Ok(());
            };
            let (site, features) = (first.site.clone(), first.features.clone());
            let learnt = Gathered::of(samples, params.blocks, emit);
            emit.rows(learnt.forest(&params, &site, &features))
        }))
    }
}

/// All samples, side by side.
#[derive(Default)]
struct Gathered {
    dimensions: usize,
    classes: Vec<String>,
    class_pixels: Vec<u64>,
    labels: Vec<u8>,
    values: Vec<u8>,
    blocks: Vec<u32>,
    /// What each block is of.
    parts: BTreeMap<u32, Sources>,
}

impl Gathered {
    fn of(samples: Vec<PixelSamples>, blocks: u32, emit: &mut Emit<'_>) -> Self {
        let block = blocks_of(&samples, blocks);
        let Some(first) = samples.first() else {
            return Self::default();
        };
        let features = first.features.clone();
        let mut all = Self {
            dimensions: first.dimensions as usize,
            ..Self::default()
        };
        for row in samples {
            let fits = row.values.0.len() == row.labels.len() * all.dimensions;
            if row.features != features || row.dimensions as usize != all.dimensions {
                emit.skip("features are others than those of the first image", 1);
            } else if !fits || row.class_pixels.len() > row.classes.len() {
                emit.skip("samples, labels and classes do not fit each other", 1);
            } else {
                let name = (row.session.clone(), row.stamp);
                let block = block.get(&name).copied().unwrap_or(0);
                all.add(row, block, emit);
            }
        }
        all
    }

    fn add(&mut self, row: PixelSamples, block: u32, emit: &mut Emit<'_>) {
        let own: Vec<usize> = row.classes.iter().map(|name| self.class(name)).collect();
        for (class, pixels) in own.iter().zip(&row.class_pixels) {
            if let Some(sum) = self.class_pixels.get_mut(*class) {
                *sum = sum.saturating_add(*pixels);
            }
        }
        let samples = row.values.0.chunks_exact(self.dimensions.max(1));
        for (label, sample) in row.labels.iter().zip(samples) {
            let class = own.get(usize::from(*label)).copied();
            match class.and_then(|class| u8::try_from(class).ok()) {
                Some(class) => {
                    self.labels.push(class);
                    self.values.extend_from_slice(sample);
                    self.blocks.push(block);
                }
                None => emit.skip("sample has no class", 1),
            }
        }
        let parts = self.parts.entry(block).or_default();
        parts.add(&row.session, row.stamp, row.stamp);
    }

    /// Index of a class, which is new the first time.
    fn class(&mut self, name: &str) -> usize {
        let known = self.classes.iter().position(|class| class == name);
        known.unwrap_or_else(|| {
            self.classes.push(name.to_owned());
            self.class_pixels.push(0);
            self.classes.len() - 1
        })
    }

    fn forest(&self, params: &PixelForestParams, site: &str, features: &str) -> Vec<DecisionTree> {
        let samples = Samples {
            dimensions: self.dimensions,
            classes: self.classes.len(),
            labels: &self.labels,
            values: &self.values,
            blocks: &self.blocks,
        };
        let options = ForestOptions {
            trees: params.trees,
            tried_features: params.tried_features,
            max_depth: params.max_depth,
            min_leaf: params.min_leaf,
            balance: params.balance,
            seed: params.seed,
        };
        let pixels = self.class_pixels.iter().sum::<u64>().max(1) as f64;
        let share = |count: &u64| (*count as f64 / pixels) as f32;
        let priors: Vec<f32> = self.class_pixels.iter().map(share).collect();
        let row = |(tree, learnt): (usize, Tree)| DecisionTree {
            site: site.to_owned(),
            tree: tree as u32,
            classes: self.classes.clone(),
            features: features.to_owned(),
            nodes: learnt.nodes.iter().map(node).collect(),
            distributions: learnt.distributions,
            priors: priors.clone(),
            held_out: learnt
                .held_out
                .and_then(|block| self.parts.get(&block).cloned())
                .unwrap_or_default()
                .into_rows(),
        };
        let trees = train(&samples, &options);
        trees.into_iter().enumerate().map(row).collect()
    }
}

fn node(node: &evermap_algorithms::learning::random_forest::Node) -> TreeNode {
    TreeNode {
        feature: node.feature,
        threshold: node.threshold,
        left: node.left,
        leaf: node.leaf,
    }
}

/// Block of each image: each session is cut into equal stretches of images. Where sessions are shorter than there are
/// blocks, each begins with another one.
fn blocks_of(samples: &[PixelSamples], blocks: u32) -> BTreeMap<(String, Stamp), u32> {
    let mut sessions: BTreeMap<&str, BTreeSet<Stamp>> = BTreeMap::new();
    for row in samples {
        sessions.entry(&row.session).or_default().insert(row.stamp);
    }
    let mut of = BTreeMap::new();
    for (first, (session, stamps)) in sessions.iter().enumerate() {
        for (index, stamp) in stamps.iter().enumerate() {
            let part = index * blocks as usize / stamps.len();
            let block = (first + part) % blocks as usize;
            of.insert(((*session).to_owned(), *stamp), block as u32);
        }
    }
    of
}
