//! Perceptrons of one hidden layer over bytes, several of which vote (Rumelhart, Hinton, Williams 1986; Breiman's bagging,
//! 1996): smooth functions of many features that each say little, as what a network sees of an image.
//!
//! Each member can hold out one block of the samples, as trees of a forest do: see
//! [`Samples::blocks`](crate::learning::samples::Samples::blocks).

mod prediction;
mod training;

#[cfg(test)]
mod tests;

pub use prediction::{Network, Voters};
pub use training::{NetworkOptions, train};

/// One member: `softmax(output · max(0, hidden · x + hidden_biases) + output_biases)` of bytes `x`.
#[derive(Debug, Clone, PartialEq)]
pub struct Perceptron {
    /// Weights of the first hidden unit, one a feature, then of the next.
    pub hidden: Vec<f32>,
    /// One a hidden unit.
    pub hidden_biases: Vec<f32>,
    /// Weights of the first class, one a hidden unit, then of the next.
    pub output: Vec<f32>,
    /// One a class. Classes count as if all were equally frequent.
    pub output_biases: Vec<f32>,
    /// The block that it has not seen.
    pub held_out: Option<u32>,
}

/// Why perceptrons cannot predict.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NetworkError {
    /// There is none.
    #[error("expected at least one {0}, found none")]
    Empty(&'static str),
    /// Weights of another number than layers have.
    #[error("expected {expected} {what}, found {found}")]
    Count {
        /// Which weights.
        what: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// A weight is no finite number.
    #[error("expected finite weights, found one that is not")]
    NotFinite,
}

impl Perceptron {
    /// Whether it fits so many features and classes.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn check(&self, dimensions: usize, classes: usize) -> Result<(), NetworkError> {
        let units = self.hidden_biases.len();
        for (what, count) in [("class", classes), ("hidden unit", units)] {
            if count == 0 {
                return Err(NetworkError::Empty(what));
            }
        }
        let counts = [
            ("weights of hidden units", units * dimensions, &self.hidden),
            ("weights of classes", classes * units, &self.output),
            ("biases of classes", classes, &self.output_biases),
        ];
        for (what, expected, values) in counts {
            if values.len() != expected {
                let found = values.len();
                return Err(NetworkError::Count {
                    what,
                    expected,
                    found,
                });
            }
        }
        let all = [
            &self.hidden,
            &self.hidden_biases,
            &self.output,
            &self.output_biases,
        ];
        let finite = all.into_iter().flatten().all(|value| value.is_finite());
        finite.then_some(()).ok_or(NetworkError::NotFinite)
    }
}

/// Scores of classes to probabilities, in place; what they were before the softmax.
fn softmax(scores: &mut [f32]) {
    let most = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut sum = 0.0;
    for score in scores.iter_mut() {
        *score = (*score - most).exp();
        sum += *score;
    }
    scores.iter_mut().for_each(|score| *score /= sum);
}
