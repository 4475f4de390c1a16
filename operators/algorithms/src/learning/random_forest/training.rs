//! Trees learnt from samples, side by side, each from its own random numbers.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::split::{Histogram, Split};
use super::tree::{Node, Tree};
use crate::learning::samples::Samples;
use crate::solving::random::SplitMix64;

/// How a forest is learnt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ForestOptions {
    /// Number of trees.
    #[schemars(range(min = 1, max = 10_000))]
    pub trees: u32,
    /// Features tried at each node, chosen at random; 0: four times the square root of their number, as many say little.
    /// On CamVid with 482 features, 80 are 3 to 4 % better in an average class than 22, and 250 are no better than 80.
    pub tried_features: u32,
    /// Nodes this deep are leaves.
    pub max_depth: u32,
    /// The least samples at a leaf.
    pub min_leaf: u32,
    /// Samples of a class with n of all N samples weigh `(N / n)^balance`: 1 makes classes equal, 0 samples.
    #[schemars(range(min = 0.0, max = 2.0))]
    pub balance: f64,
    /// Where random numbers start.
    pub seed: u64,
}

impl Default for ForestOptions {
    fn default() -> Self {
        Self {
            trees: 48,
            tried_features: 0,
            max_depth: 30,
            min_leaf: 8,
            balance: 1.0,
            seed: 1,
        }
    }
}

/// The trees of a forest; the same for any number of threads. None from no samples, or where `values` and `labels` do
/// not fit each other; samples whose class is out of range are left out.
pub fn train(samples: &Samples<'_>, options: &ForestOptions) -> Vec<Tree> {
    let held_out = samples.held_out(options.trees);
    if held_out.is_empty() || !(1..=1 << 16).contains(&samples.dimensions) {
        return Vec::new();
    }
    let columns = columns(samples);
    held_out
        .into_par_iter()
        .enumerate()
        .map(|(tree, held_out)| {
            Growth::new(samples, &columns, options, held_out, tree as u32).grow()
        })
        .collect()
}

/// Samples feature by feature: a node reads one feature of many samples.
fn columns(samples: &Samples<'_>) -> Vec<u8> {
    let (count, dimensions) = (samples.labels.len(), samples.dimensions);
    let mut columns = vec![0; samples.values.len()];
    columns
        .par_chunks_mut(16 * count)
        .enumerate()
        .for_each(|(block, columns)| {
            let features = columns.len() / count;
            for (index, sample) in samples.values.chunks_exact(dimensions).enumerate() {
                let values = &sample[16 * block..16 * block + features];
                for (feature, value) in values.iter().enumerate() {
                    columns[feature * count + index] = *value;
                }
            }
        });
    columns
}

/// One tree while it grows.
struct Growth<'a> {
    samples: &'a Samples<'a>,
    columns: &'a [u8],
    options: &'a ForestOptions,
    held_out: Option<u32>,
    random: SplitMix64,
    /// How often each sample was drawn.
    drawn: Vec<u16>,
    /// Samples that were drawn, those of one node together.
    indices: Vec<u32>,
    /// Class and count of each sample of the node that is being split.
    members: Vec<(u8, u16)>,
    weights: Vec<f64>,
    /// All features; the first ones are those tried last.
    features: Vec<u16>,
    histogram: Histogram,
}

/// A node whose samples are `indices[from..to]`.
struct Pending {
    node: usize,
    from: usize,
    to: usize,
    depth: u32,
}

impl<'a> Growth<'a> {
    fn new(
        samples: &'a Samples<'a>,
        columns: &'a [u8],
        options: &'a ForestOptions,
        held_out: Option<u32>,
        tree: u32,
    ) -> Self {
        let mut random =
            SplitMix64(options.seed ^ (u64::from(tree) + 1).wrapping_mul(0xd134_2543_de82_ef95));
        let open: Vec<u32> = (0..samples.labels.len() as u32)
            .filter(|&index| {
                let block = samples.blocks.get(index as usize).copied();
                usize::from(samples.labels[index as usize]) < samples.classes
                    && (held_out.is_none() || block != held_out)
            })
            .collect();
        let mut drawn = vec![0_u16; samples.labels.len()];
        for _ in 0..open.len() {
            let sample = &mut drawn[open[random.below(open.len())] as usize];
            *sample = sample.saturating_add(1);
        }
        let indices: Vec<u32> = open
            .into_iter()
            .filter(|&index| drawn[index as usize] > 0)
            .collect();
        Self {
            samples,
            columns,
            options,
            held_out,
            random,
            weights: weights(samples, &indices, &drawn, options.balance),
            drawn,
            indices,
            members: Vec::new(),
            features: (0..samples.dimensions)
                .map(|feature| feature as u16)
                .collect(),
            histogram: Histogram::new(samples.classes),
        }
    }

    /// Breadth first, so that the nodes that every sample passes lie together.
    fn grow(mut self) -> Tree {
        let mut tree = Tree {
            nodes: vec![Node::default()],
            distributions: Vec::new(),
            held_out: self.held_out,
        };
        let mut pending = std::collections::VecDeque::from([Pending {
            node: 0,
            from: 0,
            to: self.indices.len(),
            depth: 0,
        }]);
        while let Some(at) = pending.pop_front() {
            let totals = self.totals(&at);
            let Some(split) = self.split(&at, &totals) else {
                tree.nodes[at.node].leaf = (tree.distributions.len() / self.samples.classes) as u32;
                tree.distributions.extend(self.distribution(&totals));
                continue;
            };
            let middle = self.partition(&at, &split);
            let left = tree.nodes.len();
            tree.nodes[at.node] = Node {
                feature: split.feature,
                threshold: split.threshold,
                left: left as u32,
                leaf: 0,
            };
            for (node, from, to) in [(left, at.from, middle), (left + 1, middle, at.to)] {
                tree.nodes.push(Node::default());
                let depth = at.depth + 1;
                pending.push_back(Pending {
                    node,
                    from,
                    to,
                    depth,
                });
            }
        }
        tree
    }

    fn totals(&self, at: &Pending) -> Vec<u32> {
        let mut totals = vec![0; self.samples.classes];
        for &index in &self.indices[at.from..at.to] {
            let index = index as usize;
            totals[usize::from(self.samples.labels[index])] += u32::from(self.drawn[index]);
        }
        totals
    }

    fn distribution(&self, totals: &[u32]) -> Vec<f32> {
        let weighted = totals
            .iter()
            .zip(&self.weights)
            .map(|(n, weight)| f64::from(*n) * weight);
        let sum: f64 = weighted.clone().sum();
        let share = 1.0 / totals.len() as f64;
        weighted
            .map(|n| if sum > 0.0 { n / sum } else { share } as f32)
            .collect()
    }

    /// The purest split of those tried, unless the node had better be a leaf.
    fn split(&mut self, at: &Pending, totals: &[u32]) -> Option<Split> {
        let least = u64::from(self.options.min_leaf.max(1));
        let all: u64 = totals.iter().map(|n| u64::from(*n)).sum();
        let pure = totals.iter().filter(|n| **n > 0).count() < 2;
        if pure || at.depth >= self.options.max_depth || all < 2 * least {
            return None;
        }
        self.gather(at);
        let dimensions = self.features.len();
        let tried = match self.options.tried_features as usize {
            0 => ((4.0 * (dimensions as f64).sqrt()).ceil() as usize).min(dimensions),
            tried => tried.min(dimensions),
        };
        let mut best: Option<Split> = None;
        for next in 0..dimensions {
            // Features that are constant here do not count as tried, unless nothing else is left.
            if next >= tried && best.is_some() {
                break;
            }
            let other = next + self.random.below(dimensions - next);
            self.features.swap(next, other);
            let feature = self.features[next];
            self.fill(at, feature);
            if let Some((threshold, purity)) =
                self.histogram.take_best(totals, &self.weights, least)
                && best.is_none_or(|best| purity > best.purity)
            {
                best = Some(Split {
                    feature,
                    threshold,
                    purity,
                });
            }
        }
        best
    }

    fn column(&self, feature: u16) -> &'a [u8] {
        let count = self.samples.labels.len();
        &self.columns[usize::from(feature) * count..][..count]
    }

    fn fill(&mut self, at: &Pending, feature: u16) {
        let column = self.column(feature);
        let drawn = &self.indices[at.from..at.to];
        for (index, (class, count)) in drawn.iter().zip(&self.members) {
            self.histogram
                .add(column[*index as usize], *class, (*count).into());
        }
    }

    /// Class and count of each sample of a node: read once instead of once per feature.
    fn gather(&mut self, at: &Pending) {
        self.members.clear();
        let own = self.indices[at.from..at.to].iter().map(|&index| {
            let index = index as usize;
            (self.samples.labels[index], self.drawn[index])
        });
        self.members.extend(own);
    }

    /// Puts those that go left first, in order; where the others begin.
    fn partition(&mut self, at: &Pending, split: &Split) -> usize {
        let column = self.column(split.feature);
        let own = &mut self.indices[at.from..at.to];
        let mut right = Vec::new();
        let mut middle = 0;
        for i in 0..own.len() {
            let index = own[i];
            if column[index as usize] <= split.threshold {
                own[middle] = index;
                middle += 1;
            } else {
                right.push(index);
            }
        }
        own[middle..].copy_from_slice(&right);
        at.from + middle
    }
}

/// Weight of each class among what was drawn.
fn weights(samples: &Samples<'_>, indices: &[u32], drawn: &[u16], balance: f64) -> Vec<f64> {
    let mut counts = vec![0_u64; samples.classes];
    for &index in indices {
        let index = index as usize;
        counts[usize::from(samples.labels[index])] += u64::from(drawn[index]);
    }
    let all: u64 = counts.iter().sum();
    let weight = |n: &u64| match *n {
        0 => 0.0,
        n => (all as f64 / n as f64).powf(balance),
    };
    counts.iter().map(weight).collect()
}
