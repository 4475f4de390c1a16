#![doc = include_str!("pixel_forest.md")]

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::learning::random_forest::{ForestOptions, Node, Samples, Tree, train};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{DecisionTree, PixelSamples, Sources, TreeNode};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    let first = &samples[0];
    let (site, features) = (first.site.clone(), first.features.clone());
    let gathered = Gathered::of(samples, params.blocks, emit);
    emit.rows(gathered.forest(&params.forest, &site, &features))
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
        let first = &samples[0];
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

    fn forest(&self, options: &ForestOptions, site: &str, features: &str) -> Vec<DecisionTree> {
        let samples = Samples {
            dimensions: self.dimensions,
            classes: self.classes.len(),
            labels: &self.labels,
            values: &self.values,
            blocks: &self.blocks,
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
        let trees = train(&samples, options);
        trees.into_iter().enumerate().map(row).collect()
    }
}

fn node(node: &Node) -> TreeNode {
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
