//! Scores of many samples at once, laid out for the cache: a block of samples that stays in it, tree by tree, several
//! samples side by side.

use super::tree::{Node, Tree, TreeError};
use crate::learning::samples::voters;
use crate::processor::vectorised;

/// A node in one number: from the lowest bit on its threshold, its feature and its left child. A leaf is its own left
/// child and lets everything go left.
trait Packed: Copy + TryFrom<u64> + Into<u64> {
    /// Bits of the feature.
    const FEATURE_BITS: u32;
}

impl Packed for u32 {
    const FEATURE_BITS: u32 = 9;
}

impl Packed for u64 {
    const FEATURE_BITS: u32 = 16;
}

/// Bits of a threshold.
const THRESHOLD_BITS: u32 = 8;

/// The nodes of a tree in as few bytes as they fit in: they come from memory again for each block of samples.
#[derive(Debug, Clone)]
enum Nodes {
    Narrow(Vec<u32>),
    Wide(Vec<u64>),
}

/// Samples that walk down a tree side by side, so that one's wait for memory is the others' work.
const LANES: usize = 16;

/// Steps of all lanes from one look at who has come to a leaf to the next.
const STEPS: usize = 3;

/// Bytes of the samples that all trees see before the next ones come: half of a small second-level cache, of which a
/// tree takes the rest.
const BLOCK_BYTES: usize = 128 << 10;

#[derive(Debug, Clone)]
struct PackedTree {
    nodes: Nodes,
    /// Distribution of each node that is a leaf.
    leaves: Vec<u32>,
    distributions: Vec<f32>,
    held_out: Option<u32>,
}

/// A forest that predicts.
#[derive(Debug, Clone)]
pub struct Forest {
    classes: usize,
    dimensions: usize,
    trees: Vec<PackedTree>,
}

impl Forest {
    /// From trees over so many features and classes.
    ///
    /// # Errors
    /// [`TreeError`] for trees that do not fit; there must be at least one.
    pub fn new(trees: &[Tree], dimensions: usize, classes: usize) -> Result<Self, TreeError> {
        if trees.is_empty() {
            return Err(TreeError::Empty);
        }
        let packed = trees.iter().map(|tree| {
            tree.check(dimensions, classes)?;
            Ok(PackedTree::new(tree))
        });
        Ok(Self {
            classes,
            dimensions,
            trees: packed.collect::<Result<_, _>>()?,
        })
    }

    /// Number of classes.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// Number of features of a sample.
    pub fn dimensions(&self) -> usize {
        self.dimensions
    }

    /// Probabilities of the classes for each sample: the mean over all trees, or, of a block that some trees have held
    /// out, over those. `values` has the features of one sample after the other, `scores` room for as many
    /// distributions; samples beyond either are left out.
    pub fn predict(&self, values: &[u8], block: Option<u32>, scores: &mut [f32]) {
        scores.fill(0.0);
        let voters = voters(&self.trees, block, |tree| tree.held_out);
        let block = (BLOCK_BYTES / self.dimensions).max(LANES);
        let blocks = values.chunks(block * self.dimensions);
        let mut ends = Vec::new();
        for (values, scores) in blocks.zip(scores.chunks_mut(block * self.classes)) {
            let samples = (values.len() / self.dimensions).min(scores.len() / self.classes);
            ends.resize(samples + 1, 0);
            for tree in &voters {
                vectorised(
                    #[inline(always)]
                    || tree.add(values, self.dimensions, &mut ends, scores, self.classes),
                );
            }
        }
        let share = (voters.len() as f32).recip();
        scores.iter_mut().for_each(|score| *score *= share);
    }
}

impl Nodes {
    fn new(nodes: &[Node]) -> Self {
        match packed(nodes) {
            Some(narrow) => Self::Narrow(narrow),
            None => Self::Wide(packed(nodes).unwrap_or_default()),
        }
    }
}

/// Nodes as numbers; nothing where one does not fit.
fn packed<P: Packed>(nodes: &[Node]) -> Option<Vec<P>> {
    let pack = |(index, node): (usize, &Node)| {
        let (threshold, feature, left) = match node.left {
            0 => (u8::MAX, 0, index as u64),
            left => (node.threshold, u64::from(node.feature), u64::from(left)),
        };
        let link = left << (THRESHOLD_BITS + P::FEATURE_BITS);
        let number = P::try_from(u64::from(threshold) | (feature << THRESHOLD_BITS) | link).ok();
        number.filter(|_| feature >> P::FEATURE_BITS == 0)
    };
    nodes.iter().enumerate().map(pack).collect()
}

impl PackedTree {
    fn new(tree: &Tree) -> Self {
        Self {
            nodes: Nodes::new(&tree.nodes),
            leaves: tree.nodes.iter().map(|node| node.leaf).collect(),
            distributions: tree.distributions.clone(),
            held_out: tree.held_out,
        }
    }

    /// Adds the distributions of the samples' leaves. `ends` has room for a leaf of each, and one more.
    #[inline(always)]
    fn add(
        &self,
        values: &[u8],
        dimensions: usize,
        ends: &mut [u32],
        scores: &mut [f32],
        classes: usize,
    ) {
        match &self.nodes {
            Nodes::Narrow(nodes) => walk(nodes, values, dimensions, ends),
            Nodes::Wide(nodes) => walk(nodes, values, dimensions, ends),
        }
        for (scores, end) in scores.chunks_exact_mut(classes).zip(&*ends) {
            let leaf = self.leaves[*end as usize] as usize;
            let distribution = &self.distributions[leaf * classes..(leaf + 1) * classes];
            for (score, p) in scores.iter_mut().zip(distribution) {
                *score += p;
            }
        }
    }
}

/// A sample on its way down a tree.
#[derive(Debug, Clone, Copy)]
struct Lane {
    node: u32,
    sample: usize,
    /// Where its features begin.
    first: usize,
}

/// Finds the leaf of each sample. When one has come to its leaf, the next one starts in its lane; nothing is decided by a
/// jump, which the processor would guess wrongly once for every sample. When no more are left, the first one walks again,
/// for the last place of `ends`.
#[inline(always)]
fn walk<P: Packed>(nodes: &[P], values: &[u8], dimensions: usize, ends: &mut [u32]) {
    let samples = ends.len() - 1;
    let start = |sample: usize| Lane {
        node: 0,
        sample: sample.min(samples),
        first: if sample < samples {
            sample * dimensions
        } else {
            0
        },
    };
    let mut lanes: [Lane; LANES] = std::array::from_fn(start);
    let mut next = LANES;
    let mut walking = samples;
    while walking > 0 {
        for _ in 1..STEPS {
            for lane in &mut lanes {
                lane.node = child(nodes, lane, values);
            }
        }
        for lane in &mut lanes {
            let node = child(nodes, lane, values);
            ends[lane.sample] = node;
            let there = node == lane.node;
            walking -= usize::from(there && lane.sample < samples);
            let other = start(next);
            *lane = Lane {
                node: if there { other.node } else { node },
                sample: if there { other.sample } else { lane.sample },
                first: if there { other.first } else { lane.first },
            };
            next += usize::from(there);
        }
    }
}

/// The node that follows; a leaf itself.
#[inline(always)]
fn child<P: Packed>(nodes: &[P], lane: &Lane, values: &[u8]) -> u32 {
    let node: u64 = nodes[lane.node as usize].into();
    let feature = (node >> THRESHOLD_BITS) & ((1 << P::FEATURE_BITS) - 1);
    let right = values[lane.first + feature as usize] > node as u8;
    (node >> (THRESHOLD_BITS + P::FEATURE_BITS)) as u32 + u32::from(right)
}
