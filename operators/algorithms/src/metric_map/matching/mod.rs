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
pub(super) use grid::squared_distance;
pub use index::{ImageIndex, Nearest};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// When the nearest descriptor counts as a match: parameters of all that match descriptors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct MatchLimits {
    /// Descriptors that differ in more bits than this, of 512, never match. The same point in neighbouring keyframes
    /// differs in 40 to 100 bits, an unrelated one in about 200, the nearest of some hundred unrelated ones in more than
    /// 110.
    #[schemars(range(max = 512))]
    pub match_bits: u32,
    /// The best match's bits must be below this share of the next best one's; 1 and more: no such test.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub match_ratio: f64,
}

impl Default for MatchLimits {
    /// Measured on neighbouring keyframes of fisheye cameras. The ratio is near Lowe's.
    fn default() -> Self {
        Self {
            match_bits: 100,
            match_ratio: 0.85,
        }
    }
}

impl MatchLimits {
    /// Whether a best distance, with this runner-up, is a match. Without a runner-up only the
    /// distance counts.
    pub fn accept(&self, distance: u32, runner_up: Option<u32>) -> bool {
        let clear = |second: u32| {
            self.match_ratio >= 1.0 || f64::from(distance) < self.match_ratio * f64::from(second)
        };
        distance <= self.match_bits && runner_up.is_none_or(clear)
    }

    /// From this distance on descriptors neither match nor are a runner-up that makes a match unclear.
    fn unlike_bits(&self) -> u32 {
        let ratio = self.match_ratio.min(1.0);
        // A quotient that no distance reaches stays at the largest number.
        ((f64::from(self.match_bits) / ratio) as u32).saturating_add(1)
    }
}
