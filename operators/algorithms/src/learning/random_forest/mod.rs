//! Random forests over bytes (Breiman 2001): trees of axis-aligned splits whose leaves' distributions are averaged.
//!
//! Features are bytes, so a split is found by a histogram of 256 bins and a node takes 8 bytes. A tree can hold out one
//! block of the samples (say, one stretch of a drive), which gives honest scores of training samples: see
//! [`Samples::blocks`](crate::learning::samples::Samples::blocks).

mod prediction;
mod split;
mod training;
mod tree;

#[cfg(test)]
mod tests;

pub use prediction::Forest;
pub use training::{ForestOptions, train};
pub use tree::{Node, Tree, TreeError};

/// Class probabilities as they would be if the classes' frequencies were `frequencies` to the power `power` instead of
/// all equal: `p_c ∝ p_c f_c^power`, normalised. With no class left, `p` stays as it is.
///
/// Forests that weigh samples by inverse class frequency find rare classes at the cost of frequent ones; `power` is what
/// trades one for the other: 0 leaves classes equal, 1 restores their frequencies.
pub fn with_priors(p: &mut [f32], factors: &[f32]) {
    let sum: f32 = p.iter().zip(factors).map(|(p, factor)| p * factor).sum();
    if sum > 0.0 && sum.is_finite() {
        for (p, factor) in p.iter_mut().zip(factors) {
            *p *= factor / sum;
        }
    }
}

/// The factors of [`with_priors`]: `f_c^power`, and 1 for all classes where the power is 0.
pub fn prior_factors(frequencies: &[f32], power: f64) -> Vec<f32> {
    let factor = |f: &f32| match *f > 0.0 {
        true => f64::from(*f).powf(power) as f32,
        false => 0.0,
    };
    frequencies.iter().map(factor).collect()
}
