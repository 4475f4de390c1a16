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

mod image;
mod mean_field;
mod search;
mod softmax;
#[cfg(test)]
mod tests;
mod unary;
mod upsample;

pub use image::ColourView;
pub use mean_field::RandomField;
pub use search::{Confusion, Example, SearchOptions, Trial, search};
pub use unary::Unary;

use crate::learning::permutohedral::LatticeError;

/// Rounds after which mean field has settled (paper, figure 3: the divergence hardly falls after ten).
pub const ITERATIONS: u32 = 10;

/// The most classes: labels are bytes, and 255 is no label.
pub const MOST_CLASSES: usize = 255;

/// How pixels are joined. The default is what the reference implementation's example has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kernels {
    /// Standard deviation of the appearance kernel in the image (px).
    pub appearance_px: f64,
    /// Standard deviation of the appearance kernel in each colour channel (8-bit values).
    pub appearance_colour: f64,
    /// Weight of the appearance kernel; 0 leaves it out.
    pub appearance_weight: f64,
    /// Standard deviation of the smoothness kernel in the image (px).
    pub smoothness_px: f64,
    /// Weight of the smoothness kernel; 0 leaves it out.
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

/// Why there is no random field, or no labelling by it.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CrfError {
    /// A kernel's parameter is not a number that can be worked with.
    #[error("{parameter}: expected {expected}, found {found}")]
    Kernel {
        /// Name of the parameter.
        parameter: &'static str,
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
    /// Checks all parameters.
    ///
    /// # Errors
    /// [`CrfError::Kernel`] for the first that cannot be used.
    pub fn check(&self) -> Result<(), CrfError> {
        let deviations = [
            ("appearance_px", self.appearance_px),
            ("appearance_colour", self.appearance_colour),
            ("smoothness_px", self.smoothness_px),
        ];
        for (parameter, found) in deviations {
            if !(found > 0.0 && found.is_finite()) {
                let expected = "a standard deviation above 0";
                return Err(CrfError::Kernel {
                    parameter,
                    expected,
                    found,
                });
            }
        }
        let weights = [
            ("appearance_weight", self.appearance_weight),
            ("smoothness_weight", self.smoothness_weight),
        ];
        for (parameter, found) in weights {
            if !(found >= 0.0 && found.is_finite()) {
                let expected = "a weight of 0 or above";
                return Err(CrfError::Kernel {
                    parameter,
                    expected,
                    found,
                });
            }
        }
        Ok(())
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
