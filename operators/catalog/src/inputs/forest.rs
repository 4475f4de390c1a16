//! Forests between rows and algorithms.

use evermap_algorithms::learning::random_forest::{Node, Tree};
use evermap_contract::{Fault, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{DecisionTree, Source, TreeNode};

/// A site's forest, as the port `forest` has it.
pub(crate) struct LearntForest {
    pub trees: Vec<Tree>,
    pub classes: Vec<String>,
    /// What it reads, as JSON.
    pub features: String,
    /// Share of each class among what it has learnt from.
    pub priors: Vec<f32>,
    /// The parts of sessions that some trees have held out, by the number of the block.
    held_out: Vec<Vec<Source>>,
}

impl LearntForest {
    /// `None` where the site has none. A data fault for trees that are not of one forest.
    pub(crate) fn new(sides: &Sides) -> Result<Option<Self>, Fault> {
        let rows = sides.rows::<DecisionTree>("forest")?;
        let Some(first) = rows.first() else {
            return Ok(None);
        };
        let mut forest = Self {
            trees: Vec::with_capacity(rows.len()),
            classes: first.classes.clone(),
            features: first.features.clone(),
            priors: first.priors.clone(),
            held_out: Vec::new(),
        };
        if forest.priors.len() != forest.classes.len() {
            return Err(wrong("expected a prior for each class"));
        }
        for row in rows {
            if row.classes != forest.classes
                || row.features != forest.features
                || row.priors != forest.priors
            {
                return Err(wrong(format!(
                    "expected all trees of a site to have the same classes, features and priors; tree {} has others",
                    row.tree
                )));
            }
            let tree = tree(row, &mut forest.held_out);
            forest.trees.push(tree);
        }
        Ok(Some(forest))
    }

    /// The block that an image belongs to, if it was learnt from.
    pub(crate) fn block(&self, session: &str, stamp: Stamp) -> Option<u32> {
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

/// A fault in what the port has.
pub(crate) fn wrong(text: impl std::fmt::Display) -> Fault {
    Fault::data(format!("port forest: {text}"))
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
