//! How far odometry is believed: one belief for all that weigh it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is believed of a session's odometry as a whole. Its error is systematic (a wheel of the wrong size), so it grows
/// with the path; each algorithm makes of it what it needs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct OdometryScale {
    /// Standard deviation of a session's odometry scale about 1. Calibrated wheels are right to about a hundredth.
    /// Several cameras outvote it by far; with one camera it is all that sets the map's scale.
    #[serde(rename = "odometry_scale_sigma")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub sigma: f64,
}

impl Default for OdometryScale {
    fn default() -> Self {
        Self { sigma: 0.01 }
    }
}

/// A chain of independent steps is made as uncertain as a wrong scale after this path (m).
const WALK_PATH_M: f64 = 100.0;

/// A guess must hold for sessions whose scale is this many standard deviations off.
const GUESS_SIGMAS: f64 = 5.0;

impl OdometryScale {
    /// Standard deviation of the position after one metre (m), if it grows with the root of the path: the walk that is
    /// off by as much after 100 m as the scale is. Were each step believed to its own one per cent, a hundred metres
    /// would be believed to one millimetre per metre, and true loops would look false.
    pub fn walk_m(&self) -> f64 {
        self.sigma * WALK_PATH_M.sqrt()
    }

    /// How far off a step may be, as a share of it, for a guess that the truth must not lie outside of: a session whose
    /// wheels nobody calibrated is to be found, too.
    pub fn share_of_guess(&self) -> f64 {
        self.sigma * GUESS_SIGMAS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hundred_metres_walked_are_as_uncertain_as_a_scale() {
        let scale = OdometryScale { sigma: 0.02 };
        let after_m = |path_m: f64| scale.walk_m() * path_m.sqrt();
        assert!((after_m(100.0) - 0.02 * 100.0).abs() < 1e-12);
        assert!(after_m(1.0) > 0.02 && after_m(400.0) < 0.02 * 400.0);
    }
}
