//! Scores of many samples at once, laid out for the cache: a block of samples that stays in it, tree by tree, several
//! samples side by side.

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

/// Bytes of the samples that all trees see before the next ones come: half of a small second-level cache, of which a
/// tree takes the rest.
const BLOCK_BYTES: usize = 128 << 10;

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
        let block = (BLOCK_BYTES / self.dimensions).max(LANES);
        let blocks = values.chunks(block * self.dimensions);
        for (values, scores) in blocks.zip(scores.chunks_mut(block * self.classes)) {
            for tree in chosen() {
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

    /// Adds the distributions of the samples' leaves. As soon as a sample has come to its leaf, the next one starts.
    fn add(&self, values: &[u8], dimensions: usize, scores: &mut [f32], classes: usize) {
        let count = (values.len() / dimensions).min(scores.len() / classes);
        let mut lanes: [Lane; LANES] = std::array::from_fn(|sample| Lane { node: 0, sample });
        let mut started = LANES;
        let mut walking = count.min(LANES);
        while walking > 0 {
            let mut lane = 0;
            while lane < walking {
                let Lane { node: at, sample } = lanes[lane];
                let node = self.nodes[at as usize];
                if node.left != at {
                    let value = values[sample * dimensions + usize::from(node.feature)];
                    lanes[lane].node = node.left + u32::from(value > node.threshold);
                    lane += 1;
                    continue;
                }
                self.add_leaf(at, &mut scores[sample * classes..(sample + 1) * classes]);
                if started < count {
                    lanes[lane] = Lane {
                        node: 0,
                        sample: started,
                    };
                    started += 1;
                } else {
                    walking -= 1;
                    lanes[lane] = lanes[walking];
                }
            }
        }
    }

    fn add_leaf(&self, node: u32, scores: &mut [f32]) {
        let leaf = self.leaves[node as usize] as usize;
        let classes = scores.len();
        let distribution = &self.distributions[leaf * classes..(leaf + 1) * classes];
        for (score, p) in scores.iter_mut().zip(distribution) {
            *score += p;
        }
    }
}

/// A sample on its way down a tree.
#[derive(Debug, Clone, Copy)]
struct Lane {
    node: u32,
    sample: usize,
}
