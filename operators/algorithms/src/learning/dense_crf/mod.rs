//! Labels that follow an image's edges: the fully connected random field.
//!
//! Philipp Krähenbühl, Vladlen Koltun: *Efficient Inference in Fully Connected CRFs with Gaussian Edge Potentials*,
//! NIPS 2011. Every pixel is joined to every other one, the more strongly the nearer they are and the more alike their
//! colours ([`Kernels`]). The Gibbs energy of a labelling x is
//!
//! ```text
//! E(x) = Σ_i u_i(x_i) + ½ Σ_i Σ_j [x_i ≠ x_j] Σ_m w_m k_m(i, j)
//! k_m(i, j) = n_i n_j exp(-|f_i - f_j|² / 2)          n such that k_m is normalised symmetrically
//! ```
//! written, as the reference implementation has it, without the part that is equal for all labellings. Mean field finds
//! a distribution Q that factorises over the pixels and is close to the Gibbs distribution:
//!
//! ```text
//! Q_i(l) ∝ exp(-u_i(l) + Σ_m w_m Σ_j k_m(i, j) Q_j(l))
//! ```
//! in rounds, all pixels at once. The sums over all pixels are Gaussian filters ([`crate::learning::permutohedral`]).
//!
//! In a full panorama the last column is next to the first one: [`RandomField::new`] can wrap the columns around. The
//! deviation along x is then rounded, so that the panorama is a whole number of lattice cells wide; no dimension is added.

mod confusion;
mod example;
mod image;
mod mean_field;
mod search;
mod softmax;
#[cfg(test)]
mod tests;
mod tiles;
mod unary;
mod upsample;

pub use confusion::Confusion;
pub use example::Example;
pub use image::ColourView;
pub use mean_field::RandomField;
pub use search::{SearchOptions, Trial, search};
pub use unary::Unary;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::learning::permutohedral::LatticeError;
use crate::semantic_map::semantic_graph::MOST_CLASSES;

/// How pixels are joined. The default is what the reference implementation's example has.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Kernels {
    /// Standard deviation of the appearance kernel in the image (px).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub appearance_px: f64,
    /// Standard deviation of the appearance kernel in each colour channel (8-bit values).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub appearance_colour: f64,
    /// Weight of the appearance kernel; 0 leaves it out.
    #[schemars(range(min = 0.0))]
    pub appearance_weight: f64,
    /// Standard deviation of the smoothness kernel in the image (px).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub smoothness_px: f64,
    /// Weight of the smoothness kernel; 0 leaves it out.
    #[schemars(range(min = 0.0))]
    pub smoothness_weight: f64,
}

impl Default for Kernels {
    fn default() -> Self {
        Self {
            appearance_px: 80.0,
            appearance_colour: 13.0,
            appearance_weight: 10.0,
            smoothness_px: 3.0,
            smoothness_weight: 3.0,
        }
    }
}

/// How labels are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct MeanField {
    /// Rounds of mean field. Paper, figure 3: the divergence hardly falls after ten.
    #[schemars(range(max = 1000))]
    pub iterations: u32,
}

impl Default for MeanField {
    fn default() -> Self {
        Self { iterations: 10 }
    }
}

/// Why there is no random field, or no labelling by it.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CrfError {
    /// Kernels that cannot be worked with.
    #[error("expected deviations above 0 and weights of 0 or above, found {0:?}")]
    Kernels(Kernels),
    /// A number that cannot be worked with.
    #[error("{what}: expected {expected}, found {found}")]
    Number {
        /// What the number is.
        what: &'static str,
        /// What it should be.
        expected: &'static str,
        /// What it is.
        found: f64,
    },
    /// Too few or too many classes.
    #[error("expected 1 to {MOST_CLASSES} classes, found {found}")]
    Classes {
        /// Number given.
        found: usize,
    },
    /// Values of another image.
    #[error("expected {expected} values, found {found}")]
    Size {
        /// What the image and the number of classes ask for.
        expected: usize,
        /// What was given.
        found: usize,
    },
    /// Pixels cannot be placed on the lattice.
    #[error(transparent)]
    Lattice(#[from] LatticeError),
}

impl Kernels {
    /// The same for an image whose pixels are cells of so many pixels a side. Weights stay, as what a kernel sums is
    /// normalised by what it makes of ones.
    fn in_cells(self, cell_px: usize) -> Self {
        Self {
            appearance_px: self.appearance_px / cell_px as f64,
            smoothness_px: self.smoothness_px / cell_px as f64,
            ..self
        }
    }

    /// Kernels may be data: learnt ones come from a table.
    fn check(&self) -> Result<(), CrfError> {
        let deviations = [
            self.appearance_px,
            self.appearance_colour,
            self.smoothness_px,
        ];
        let weights = [self.appearance_weight, self.smoothness_weight];
        let sound = deviations.iter().all(|px| *px > 0.0 && px.is_finite())
            && weights
                .iter()
                .all(|weight| *weight >= 0.0 && weight.is_finite());
        sound.then_some(()).ok_or(CrfError::Kernels(*self))
    }
}

fn fits(expected: usize, found: usize) -> Result<(), CrfError> {
    match expected == found {
        true => Ok(()),
        false => Err(CrfError::Size { expected, found }),
    }
}

/// A distribution over the classes for every pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Marginals {
    /// Number of classes.
    pub classes: usize,
    /// Probabilities, pixel after pixel, row by row, classes innermost; each pixel's sum to one.
    pub probabilities: Vec<f32>,
}

impl Marginals {
    /// Of each pixel: its most probable class; of several, the first.
    pub fn labels(&self) -> Vec<u8> {
        let most_probable = |of_pixel: &[f32]| {
            let mut best = 0;
            for (class, probability) in of_pixel.iter().enumerate() {
                if *probability > of_pixel[best] {
                    best = class;
                }
            }
            best as u8
        };
        let pixels = self.probabilities.chunks_exact(self.classes.max(1));
        pixels.map(most_probable).collect()
    }
}
