//! Descriptors to descriptors: all against all, or near a place of the image.
//!
//! Both ask the same of a match: its distance is small, and clearly smaller than the runner-up's
//! (the ratio test of Lowe, *Distinctive image features from scale-invariant keypoints*, 2004,
//! section 7.1). Between two sets of features, [`Descriptors::mutual`] also wants the match to be the best
//! one seen from either side. Where geometry says in which part of an image to look, ask an
//! [`ImageIndex`].

mod brute_force;
mod grid;
mod index;
#[cfg(test)]
mod tests;

pub use brute_force::{Descriptors, Match};
pub use grid::FeatureGrid;
pub use index::{ImageIndex, Nearest};

/// When the nearest descriptor counts as a match.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchLimits {
    /// More differing bits than this, of 512, are never a match.
    pub max_distance: u32,
    /// The distance must be below this share of the runner-up's; 1 and more switch the test off.
    pub max_ratio: f64,
}

impl Default for MatchLimits {
    /// Measured on neighbouring keyframes of fisheye cameras: true pairs differ in 40 to 100 bits,
    /// the nearest of some hundred unrelated descriptors in 110 and more. The ratio is near Lowe's.
    fn default() -> Self {
        Self {
            max_distance: 100,
            max_ratio: 0.85,
        }
    }
}

impl MatchLimits {
    /// Whether a best distance, with this runner-up, is a match. Without a runner-up only the
    /// distance counts.
    pub fn accept(&self, distance: u32, runner_up: Option<u32>) -> bool {
        let clear = |second: u32| {
            self.max_ratio >= 1.0 || f64::from(distance) < self.max_ratio * f64::from(second)
        };
        distance <= self.max_distance && runner_up.is_none_or(clear)
    }
}
