//! One decision tree, as it is learnt, stored and checked.

/// One node of a tree.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Node {
    /// Feature that is compared.
    pub feature: u16,
    /// A sample goes left where its feature is at most this.
    pub threshold: u8,
    /// Index of the left child, greater than the node's own; the right one follows it. 0 for a leaf.
    pub left: u32,
    /// Index of a leaf's distribution; 0 for inner nodes.
    pub leaf: u32,
}

/// A tree: its nodes, the root first, and the distributions at its leaves.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tree {
    /// Breadth first: what is read most lies together.
    pub nodes: Vec<Node>,
    /// Probability of each class at each leaf, one leaf after the other.
    pub distributions: Vec<f32>,
    /// The block of samples that it has not seen, if any.
    pub held_out: Option<u32>,
}

/// What is wrong with a tree that came from elsewhere.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TreeError {
    /// There is nothing.
    #[error("expected trees with at least one node and at least one class")]
    Empty,
    /// A child's index is not behind its parent's or beyond the end.
    #[error("node {node}: expected children after it and among {nodes} nodes, found {left}")]
    Child {
        /// The node.
        node: usize,
        /// How many there are.
        nodes: usize,
        /// Index of its left child.
        left: u32,
    },
    /// A feature that samples do not have.
    #[error("node {node}: expected one of {dimensions} features, found {feature}")]
    Feature {
        /// The node.
        node: usize,
        /// Features of a sample.
        dimensions: usize,
        /// What it compares.
        feature: u16,
    },
    /// A leaf without a distribution, or one that is not finite.
    #[error("node {node}: expected one of {leaves} distributions of finite numbers, found {leaf}")]
    Leaf {
        /// The node.
        node: usize,
        /// Distributions there are.
        leaves: usize,
        /// Which one it names.
        leaf: u32,
    },
}

impl Tree {
    /// Whether every sample of so many features ends at a leaf with a distribution of so many classes.
    ///
    /// # Errors
    /// [`TreeError`] for the first node that is wrong.
    pub fn check(&self, dimensions: usize, classes: usize) -> Result<(), TreeError> {
        if self.nodes.is_empty() || classes == 0 || dimensions == 0 {
            return Err(TreeError::Empty);
        }
        let leaves = self.distributions.len() / classes;
        for (index, node) in self.nodes.iter().enumerate() {
            self.check_node(index, node, [dimensions, classes, leaves])?;
        }
        Ok(())
    }

    fn check_node(
        &self,
        index: usize,
        node: &Node,
        [dimensions, classes, leaves]: [usize; 3],
    ) -> Result<(), TreeError> {
        if node.left == 0 {
            let from = node.leaf as usize * classes;
            let distribution = self.distributions.get(from..from + classes);
            return match distribution.is_some_and(|p| p.iter().all(|p| p.is_finite())) {
                true => Ok(()),
                false => Err(TreeError::Leaf {
                    node: index,
                    leaves,
                    leaf: node.leaf,
                }),
            };
        }
        let left = node.left as usize;
        if left <= index || left + 1 >= self.nodes.len() {
            return Err(TreeError::Child {
                node: index,
                nodes: self.nodes.len(),
                left: node.left,
            });
        }
        if usize::from(node.feature) >= dimensions {
            return Err(TreeError::Feature {
                node: index,
                dimensions,
                feature: node.feature,
            });
        }
        Ok(())
    }
}
