//! Scores of many samples at once.

use nalgebra::{DMatrix, DMatrixView};

use super::{NetworkError, Perceptron, softmax};
use crate::learning::samples::voters;

/// Members that predict together.
#[derive(Debug, Clone)]
pub struct Network {
    dimensions: usize,
    classes: usize,
    members: Vec<Perceptron>,
}

impl Network {
    /// From members over so many features and classes.
    ///
    /// # Errors
    /// [`NetworkError`] for members that do not fit; there must be at least one.
    pub fn new(
        members: Vec<Perceptron>,
        dimensions: usize,
        classes: usize,
    ) -> Result<Self, NetworkError> {
        if members.is_empty() {
            return Err(NetworkError::Empty("member"));
        }
        for member in &members {
            member.check(dimensions, classes)?;
        }
        Ok(Self {
            dimensions,
            classes,
            members,
        })
    }

    /// Number of classes.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// Probabilities of the classes for each sample, all classes taken for equally frequent: the mean over all members, or,
    /// of a block that some members have held out, over those. `values` has the features of one sample after the other,
    /// `scores` room for as many distributions; samples beyond either are left out.
    pub fn predict(&self, values: &[u8], block: Option<u32>, scores: &mut [f32]) {
        scores.fill(0.0);
        let voters = voters(&self.members, block, |member| member.held_out);
        let samples = (values.len() / self.dimensions).min(scores.len() / self.classes);
        let values = values[..samples * self.dimensions].iter();
        let values: Vec<f32> = values.map(|value| f32::from(*value)).collect();
        let values = DMatrixView::from_slice(&values, self.dimensions, samples);
        let share = (voters.len() as f32).recip();
        for member in voters {
            let found = member.scores(&values, self.classes);
            let found = found.as_slice().iter();
            scores
                .iter_mut()
                .zip(found)
                .for_each(|(sum, score)| *sum += share * score);
        }
    }
}

impl Perceptron {
    /// A column of probabilities for each column of features.
    fn scores(&self, values: &DMatrixView<'_, f32>, classes: usize) -> DMatrix<f32> {
        let units = self.hidden_biases.len();
        let hidden = DMatrixView::from_slice(&self.hidden, values.nrows(), units);
        let mut inner = forward(&hidden, &self.hidden_biases, values);
        inner.iter_mut().for_each(|value| *value = value.max(0.0));
        let output = DMatrixView::from_slice(&self.output, units, classes);
        let mut scores = forward(&output, &self.output_biases, &inner.as_view());
        scores
            .as_mut_slice()
            .chunks_exact_mut(classes)
            .for_each(softmax);
        scores
    }
}

/// What a layer gives for each column of values, before anything is cut off: weights have a column a unit.
pub(super) fn forward(
    weights: &DMatrixView<'_, f32>,
    biases: &[f32],
    values: &DMatrixView<'_, f32>,
) -> DMatrix<f32> {
    let mut result = DMatrix::from_fn(biases.len(), values.ncols(), |unit, _| biases[unit]);
    // Products of transposed matrices are taken number by number; a copy of the weights costs less.
    result.gemm(1.0, &weights.transpose(), values, 1.0);
    result
}
