//! What each pixel is by itself.

use super::CrfError;
use crate::semantic_map::semantic_graph::MOST_CLASSES;

/// Probabilities below this are taken for it, so that a classifier that is sure can still be overruled: the reference
/// implementation's choice.
const LEAST_PROBABILITY: f32 = 1e-5;

/// The cost of each class at each pixel: the negative logarithm of its probability.
#[derive(Debug, Clone, PartialEq)]
pub struct Unary {
    pub(super) classes: usize,
    /// Pixel after pixel, row by row, classes innermost.
    pub(super) costs: Vec<f32>,
}

impl Unary {
    /// From costs, pixel after pixel, row by row, classes innermost.
    ///
    /// # Errors
    /// [`CrfError`] for no or too many classes, a number of costs that these do not divide, or one that is not finite.
    pub fn new(classes: usize, costs: Vec<f32>) -> Result<Self, CrfError> {
        if classes == 0 || classes > MOST_CLASSES {
            return Err(CrfError::Classes { found: classes });
        }
        let pixels = costs.len() / classes;
        if pixels * classes != costs.len() {
            return Err(CrfError::Size {
                expected: pixels * classes,
                found: costs.len(),
            });
        }
        match costs.iter().find(|cost| !cost.is_finite()) {
            Some(&found) => Err(CrfError::Number {
                what: "unary",
                expected: "finite costs",
                found: f64::from(found),
            }),
            None => Ok(Self { classes, costs }),
        }
    }

    /// From probabilities, pixel after pixel, row by row, classes innermost; such below 1e-5 or NaN count as 1e-5.
    ///
    /// # Errors
    /// As [`Unary::new`].
    pub fn from_probabilities(classes: usize, probabilities: &[f32]) -> Result<Self, CrfError> {
        // Not clamp, which would pass NaN on.
        #[allow(clippy::manual_clamp)]
        let cost = |probability: &f32| -probability.max(LEAST_PROBABILITY).min(1.0).ln();
        Self::new(classes, probabilities.iter().map(cost).collect())
    }

    /// Number of classes.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.costs.len() / self.classes
    }
}
