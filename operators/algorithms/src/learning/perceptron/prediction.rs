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

    /// Those of the members that are asked of a block that some have held out, or of none.
    pub fn voters(&self, block: Option<u32>) -> Voters<'_> {
        let members = voters(&self.members, block, |member| member.held_out);
        let all = members.iter().flat_map(|member| &member.hidden).copied();
        let all: Vec<f32> = all.collect();
        let units = all.len() / self.dimensions;
        Voters {
            hidden: DMatrixView::from_slice(&all, self.dimensions, units).transpose(),
            biases: members
                .iter()
                .flat_map(|member| member.hidden_biases.iter().copied())
                .collect(),
            members,
            classes: self.classes,
        }
    }
}

/// Members that are asked together, their hidden units as one layer.
#[derive(Debug, Clone)]
pub struct Voters<'a> {
    members: Vec<&'a Perceptron>,
    /// A row of weights a hidden unit.
    hidden: DMatrix<f32>,
    biases: Vec<f32>,
    classes: usize,
}

impl Voters<'_> {
    /// Weights of all hidden units, a row each.
    pub fn hidden(&self) -> &DMatrix<f32> {
        &self.hidden
    }

    /// What hidden units have before any feature is weighed, for so many samples, a column each.
    pub fn biases(&self, samples: usize) -> DMatrix<f32> {
        DMatrix::from_fn(self.biases.len(), samples, |unit, _| self.biases[unit])
    }

    /// Probabilities of the classes for each sample, all classes taken for equally frequent: the mean over the members. `inner` has
    /// what hidden units have before anything is cut off, a column a sample, `scores` room for as many distributions.
    pub fn scores(&self, mut inner: DMatrix<f32>, scores: &mut [f32]) {
        scores.fill(0.0);
        inner.iter_mut().for_each(|value| *value = value.max(0.0));
        let share = (self.members.len() as f32).recip();
        let mut first = 0;
        for member in &self.members {
            let units = member.hidden_biases.len();
            let output = DMatrixView::from_slice(&member.output, units, self.classes);
            let inner = inner.rows(first, units).into_owned();
            let mut found = forward(&output, &member.output_biases, &inner.as_view());
            let found = found.as_mut_slice();
            found.chunks_exact_mut(self.classes).for_each(softmax);
            scores
                .iter_mut()
                .zip(found)
                .for_each(|(sum, score)| *sum += share * *score);
            first += units;
        }
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
