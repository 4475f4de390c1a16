//! Scores of many samples at once, laid out for the cache: tree by tree, samples side by side.

use super::tree::{Tree, TreeError};

/// Eight bytes; a leaf is its own left child and lets everything go left.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
struct Packed {
    left: u32,
    feature: u16,
    threshold: u8,
}

/// Samples that walk down a tree side by side, so that one's wait for memory is the others' work.
const LANES: usize = 16;

#[derive(Debug, Clone)]
struct PackedTree {
    nodes: Vec<Packed>,
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
        let held_out = |tree: &&PackedTree| block.is_some() && tree.held_out == block;
        let any = self.trees.iter().any(|tree| held_out(&tree));
        let chosen = || self.trees.iter().filter(|tree| !any || held_out(tree));
        for tree in chosen() {
            let groups = values.chunks(LANES * self.dimensions);
            for (values, scores) in groups.zip(scores.chunks_mut(LANES * self.classes)) {
                tree.add(values, self.dimensions, scores, self.classes);
            }
        }
        let share = (chosen().count() as f32).recip();
        scores.iter_mut().for_each(|score| *score *= share);
    }
}

impl PackedTree {
    fn new(tree: &Tree) -> Self {
        let pack = |(index, node): (usize, &super::Node)| match node.left {
            0 => Packed {
                left: index as u32,
                feature: 0,
                threshold: u8::MAX,
            },
            left => Packed {
                left,
                feature: node.feature,
                threshold: node.threshold,
            },
        };
        Self {
            nodes: tree.nodes.iter().enumerate().map(pack).collect(),
            leaves: tree.nodes.iter().map(|node| node.leaf).collect(),
            distributions: tree.distributions.clone(),
            held_out: tree.held_out,
        }
    }

    /// Adds the distributions of up to [`LANES`] samples.
    fn add(&self, values: &[u8], dimensions: usize, scores: &mut [f32], classes: usize) {
        let mut at = [0_u32; LANES];
        let samples = (values.len() / dimensions).min(scores.len() / classes);
        if samples == LANES {
            self.walk(&mut at, values, dimensions);
        } else {
            for (at, sample) in at.iter_mut().zip(values.chunks_exact(dimensions)) {
                self.walk(std::array::from_mut(at), sample, dimensions);
            }
        }
        for (at, scores) in at
            .iter()
            .zip(scores.chunks_exact_mut(classes))
            .take(samples)
        {
            let leaf = self.leaves[*at as usize] as usize;
            let distribution = &self.distributions[leaf * classes..(leaf + 1) * classes];
            for (score, p) in scores.iter_mut().zip(distribution) {
                *score += p;
            }
        }
    }

    /// Takes each sample from the root to its leaf, all of them one level at a time.
    fn walk<const N: usize>(&self, at: &mut [u32; N], values: &[u8], dimensions: usize) {
        loop {
            let mut moved = 0;
            for (lane, at) in at.iter_mut().enumerate() {
                let node = self.nodes[*at as usize];
                let value = values[lane * dimensions + usize::from(node.feature)];
                let next = node.left + u32::from(value > node.threshold);
                moved |= next ^ *at;
                *at = next;
            }
            if moved == 0 {
                return;
            }
        }
    }
}
