//! Scores of classes over an image, by a forest or a network on the features of its pixels.

use rayon::prelude::*;

use crate::learning::dense_crf::ColourView;
use crate::learning::perceptron::{Network, NetworkError, Perceptron};
use crate::learning::pixel_features::{
    Backbone, FeatureDescription, FeatureError, LinearFeatures, PixelFeatures,
};
use crate::learning::random_forest::{Forest, Tree, TreeError};

/// A forest or a network, and the features that it reads.
#[derive(Debug, Clone)]
pub struct PixelClassifier {
    description: FeatureDescription,
    model: Model,
}

#[derive(Debug, Clone)]
enum Model {
    Forest(Forest),
    Network(Network),
}

/// Why there is no classifier.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ClassifierError {
    /// The features are senseless.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// A tree is senseless.
    #[error(transparent)]
    Tree(#[from] TreeError),
    /// A network is senseless.
    #[error(transparent)]
    Network(#[from] NetworkError),
}

impl PixelClassifier {
    /// From trees over these features and so many classes.
    ///
    /// # Errors
    /// [`ClassifierError`] for features out of range or trees that do not fit them.
    pub fn of_trees(
        description: FeatureDescription,
        trees: &[Tree],
        classes: usize,
    ) -> Result<Self, ClassifierError> {
        description.check()?;
        let model = Model::Forest(Forest::new(trees, description.dimensions(), classes)?);
        Ok(Self { description, model })
    }

    /// From the members of a network over these features and so many classes.
    ///
    /// # Errors
    /// [`ClassifierError`] for features out of range or members that do not fit them.
    pub fn of_network(
        description: FeatureDescription,
        members: Vec<Perceptron>,
        classes: usize,
    ) -> Result<Self, ClassifierError> {
        description.check()?;
        let network = Network::new(members, description.dimensions(), classes)?;
        let model = Model::Network(network);
        Ok(Self { description, model })
    }

    /// Number of classes.
    pub fn classes(&self) -> usize {
        match &self.model {
            Model::Forest(forest) => forest.classes(),
            Model::Network(network) => network.classes(),
        }
    }

    /// Probabilities of the classes for each cell of `stride_px` (at least 1), as seen at its central pixel: cell after
    /// cell, row by row, classes innermost; the last cells of a row or column may reach beyond the image. Of an image of
    /// a block that some trees or members have held out, only those are asked. The same for any number of threads.
    ///
    /// # Errors
    /// [`FeatureError`] where the features cannot be computed.
    pub fn scores(
        &self,
        image: &ColourView<'_>,
        block: Option<u32>,
        stride_px: u32,
        backbone: Backbone,
    ) -> Result<Vec<f32>, FeatureError> {
        let features = PixelFeatures::new(&self.description, image, backbone)?;
        let centres = Centres::new(features.size(), stride_px);
        Ok(match &self.model {
            Model::Forest(forest) => by_forest(forest, block, &features, &centres),
            Model::Network(network) => by_network(network, block, features, &centres),
        })
    }
}

fn by_forest(
    forest: &Forest,
    block: Option<u32>,
    features: &PixelFeatures,
    centres: &Centres,
) -> Vec<f32> {
    let dimensions = features.dimensions();
    centres.each_row(forest.classes(), |us, v, scores| {
        let mut values = vec![0; us.len() * dimensions];
        for (u, out) in us.iter().zip(values.chunks_exact_mut(dimensions)) {
            features.write(*u, v, out);
        }
        forest.predict(&values, block, scores);
    })
}

fn by_network(
    network: &Network,
    block: Option<u32>,
    features: PixelFeatures,
    centres: &Centres,
) -> Vec<f32> {
    let voters = network.voters(block);
    let layer = LinearFeatures::new(features, voters.hidden(), centres.count());
    centres.each_row(network.classes(), |us, v, scores| {
        let mut inner = voters.biases(us.len());
        layer.add(us, v, &mut inner);
        voters.scores(inner, scores);
    })
}

/// The central pixels of an image's cells.
struct Centres {
    us: Vec<usize>,
    vs: Vec<usize>,
}

impl Centres {
    fn new(size: [usize; 2], stride_px: u32) -> Self {
        let stride = stride_px.max(1) as usize;
        let [us, vs] = size.map(|side| {
            let cells = 0..side.div_ceil(stride);
            cells.map(|cell| cell * stride + stride / 2).collect()
        });
        Self { us, vs }
    }

    fn count(&self) -> usize {
        self.us.len() * self.vs.len()
    }

    /// Scores of all cells, from a function that writes those of a row.
    fn each_row(
        &self,
        classes: usize,
        write: impl Fn(&[usize], usize, &mut [f32]) + Sync,
    ) -> Vec<f32> {
        let mut scores = vec![0.0; self.count() * classes];
        let rows = scores.par_chunks_exact_mut(self.us.len() * classes);
        let rows = rows.zip(&self.vs);
        rows.for_each(|(scores, v)| write(&self.us, *v, scores));
        scores
    }
}

/// A probability in units of 1/255.
pub fn quantised(probability: f32) -> u8 {
    // The conversion saturates, and takes NaN to 0.
    (255.0 * probability + 0.5) as u8
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::learning::pixel_features::NO_BACKBONE;
    use crate::learning::random_forest::Node;

    /// Splits at the row: the upper half is class 0, the lower one more likely class 1.
    fn halves(description: &FeatureDescription, held_out: Option<u32>) -> Tree {
        let row = description.dimensions() - 2;
        let root = Node {
            feature: row as u16,
            threshold: 127,
            left: 1,
            leaf: 0,
        };
        let lower = Node {
            leaf: 1,
            ..Node::default()
        };
        Tree {
            nodes: vec![root, Node::default(), lower],
            distributions: vec![1.0, 0.0, 0.25, 0.75],
            held_out,
        }
    }

    #[test]
    fn each_cell_is_scored_as_its_central_pixel() {
        let what = FeatureDescription::default();
        let mut other = halves(&what, Some(3));
        other.distributions = vec![0.0, 1.0, 0.0, 1.0];
        let trees = [halves(&what, None), other];
        let classifier = PixelClassifier::of_trees(what.clone(), &trees, 2).unwrap();
        let data = [90; 3 * 16 * 12];
        let image = ColourView::new(16, 12, &data).unwrap();
        let scores = classifier.scores(&image, None, 5, NO_BACKBONE).unwrap();
        assert_eq!(scores.len(), 4 * 3 * 2);
        assert_eq!((scores[0], scores[8], scores[16]), (0.5, 0.125, 0.125));
        let honest = classifier.scores(&image, Some(3), 5, NO_BACKBONE).unwrap();
        assert!(honest.chunks_exact(2).all(|cell| cell == [0.0, 1.0]));
        assert_eq!(
            classifier
                .scores(&image, None, 0, NO_BACKBONE)
                .unwrap()
                .len(),
            16 * 12 * 2
        );
        assert!(PixelClassifier::of_trees(what, &trees, 3).is_err());
    }

    #[test]
    fn probabilities_become_bytes() {
        let found = [0.0, 0.5, 1.0, 7.0, f32::NAN].map(quantised);
        assert_eq!(found, [0, 128, 255, 255, 0]);
    }
}
