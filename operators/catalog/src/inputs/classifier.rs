//! Classifiers of pixels between rows and algorithms: forests, and networks.

use evermap_algorithms::learning::perceptron::Perceptron;
use evermap_algorithms::learning::random_forest::{Node, Tree};
use evermap_contract::{Fault, Sides};
use evermap_schemas::layers::{DecisionTree, PixelPerceptron, Source, TreeNode};
use evermap_schemas::{Record, Stamp};

/// One of several models that vote, as a row.
pub(crate) trait ModelRow: Record {
    /// The port that has them.
    const PORT: &'static str;
    type Model;

    /// Classes, features and priors, which all rows of a site share.
    fn shared(&self) -> (&[String], &str, &[f32]);
    /// The parts of sessions that it has held out.
    fn held_out(&self) -> &[Source];
    /// The model, which has held out this block.
    fn model(self, held_out: Option<u32>) -> Self::Model;
}

/// A site's models, as a port has them.
pub(crate) struct LearntModels<R: ModelRow> {
    pub models: Vec<R::Model>,
    pub classes: Vec<String>,
    /// What they read, as JSON.
    pub features: String,
    /// Share of each class among what they have learnt from.
    pub priors: Vec<f32>,
    pub held_out: HeldOut,
}

/// The parts of sessions that some models have held out, by the number of the block.
#[derive(Default)]
pub(crate) struct HeldOut(Vec<Vec<Source>>);

impl HeldOut {
    /// The number of a block; none for no parts.
    fn number(&mut self, parts: &[Source]) -> Option<u32> {
        if parts.is_empty() {
            return None;
        }
        let known = self.0.iter().position(|known| known == parts);
        let number = known.unwrap_or_else(|| {
            self.0.push(parts.to_vec());
            self.0.len() - 1
        });
        Some(number as u32)
    }

    /// The block that an image belongs to, if it was learnt from.
    pub(crate) fn block(&self, session: &str, stamp: Stamp) -> Option<u32> {
        let within = |part: &Source| {
            part.session == session && (part.first_stamp..=part.last_stamp).contains(&stamp)
        };
        let block = self.0.iter().position(|parts| parts.iter().any(within));
        block.map(|block| block as u32)
    }
}

impl<R: ModelRow> LearntModels<R> {
    /// `None` where the site has none. A data fault for models that do not belong together.
    pub(crate) fn new(sides: &Sides) -> Result<Option<Self>, Fault> {
        let rows = sides.rows::<R>(R::PORT)?;
        let Some(first) = rows.first() else {
            return Ok(None);
        };
        let (classes, features, priors) = first.shared();
        let mut learnt = Self {
            models: Vec::with_capacity(rows.len()),
            classes: classes.to_vec(),
            features: features.to_owned(),
            priors: priors.to_vec(),
            held_out: HeldOut::default(),
        };
        if learnt.priors.len() != learnt.classes.len() {
            return Err(Self::wrong("expected a prior for each class"));
        }
        for (index, row) in rows.into_iter().enumerate() {
            if row.shared()
                != (
                    &learnt.classes[..],
                    &learnt.features[..],
                    &learnt.priors[..],
                )
            {
                return Err(Self::wrong(format!(
                    "expected all rows of a site to have the same classes, features and priors; row {index} has others"
                )));
            }
            let held_out = learnt.held_out.number(row.held_out());
            learnt.models.push(row.model(held_out));
        }
        Ok(Some(learnt))
    }

    /// A fault in what the port has.
    pub(crate) fn wrong(text: impl std::fmt::Display) -> Fault {
        Fault::data(format!("port {}: {text}", R::PORT))
    }
}

impl ModelRow for DecisionTree {
    const PORT: &'static str = "forest";
    type Model = Tree;

    fn shared(&self) -> (&[String], &str, &[f32]) {
        (&self.classes, &self.features, &self.priors)
    }

    fn held_out(&self) -> &[Source] {
        &self.held_out
    }

    fn model(self, held_out: Option<u32>) -> Tree {
        let node = |node: &TreeNode| Node {
            feature: node.feature,
            threshold: node.threshold,
            left: node.left,
            leaf: node.leaf,
        };
        Tree {
            nodes: self.nodes.iter().map(node).collect(),
            distributions: self.distributions,
            held_out,
        }
    }
}

impl ModelRow for PixelPerceptron {
    const PORT: &'static str = "network";
    type Model = Perceptron;

    fn shared(&self) -> (&[String], &str, &[f32]) {
        (&self.classes, &self.features, &self.priors)
    }

    fn held_out(&self) -> &[Source] {
        &self.held_out
    }

    fn model(self, held_out: Option<u32>) -> Perceptron {
        Perceptron {
            hidden: self.hidden_weights,
            hidden_biases: self.hidden_biases,
            output: self.output_weights,
            output_biases: self.output_biases,
            held_out,
        }
    }
}
