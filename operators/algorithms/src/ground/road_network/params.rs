//! How passes become lanes, and what is refused.
//!
//! *Defaults.* `connect_m` = 2 m is the width of a car with its mirrors. Two paths that go the same way nearer to each
//! other than that cannot be lanes side by side, for the cars in them would touch; repeated passes of one lane scatter by
//! ±0.5 m (paper 1, our car park) and pose errors, which is half of it. With positions alone the same 2 m are half of the
//! narrowest pair of opposite lanes (2 × 2.5 m apart in car parks, more on roads).
//!
//! `same_line_m` = 0.3 `connect_m` = 0.6 m: who keeps to a line strays from it by a standard deviation of 0.2 m at walking
//! and driving pace in lanes; two passes of one line differ by 0.2 m × √2 = 0.28 m, and by 0.6 m once in thirty. Two
//! vehicles 0.6 m apart overlap by two thirds of their width, so that towards each other one has to give way. Passes that
//! fit into it are within 0.3 m of their middle.
//!
//! `spacing_m` = `connect_m` / 4 follows a bend of 4 m radius within 1 cm. `min_loop_m` = 6 `connect_m` = 12 m is half of
//! the tightest circle of a car.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How passes become lanes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct RoadNetworkParams {
    /// d: passes nearer than this that go the same way are the same lane (m). The width of a car, for lanes side by side
    /// are farther apart; more than the scatter of repeated passes.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub connect_m: f64,
    /// P: rounds of pruning; null goes on until nothing is left to prune, which takes a few. Only with
    /// positions alone.
    pub prune_loops: Option<u32>,
    /// Distance between representative poses, at most `connect_m` (m); null is `connect_m` / 4, which follows any bend
    /// that a vehicle can drive. 0 takes every pose, as the paper does, for positions alone; that is exponential in the
    /// number of passes.
    #[schemars(range(min = 0.0))]
    pub spacing_m: Option<f64>,
    /// Loops shorter than this around are artefacts (m); null is 6 `connect_m`, half of the tightest circle of a car.
    /// With headings: a drive does not meet itself within this path.
    #[schemars(range(min = 0.0))]
    pub min_loop_m: Option<f64>,
    /// Whether passes of one lane must go the same way as well as be near each other. Without, positions alone decide, as
    /// in the paper: lanes side by side become one.
    pub headings: bool,
    /// Drives towards each other that are nearer than this are on the same line (m); null is 0.3 `connect_m`, the scatter
    /// of a person who keeps to a line. Only with headings.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub same_line_m: Option<f64>,
    /// Width of the vehicle with its mirrors (m); a lane is as wide, and the scatter of its passes more.
    #[schemars(range(min = 0.0))]
    pub vehicle_width_m: f64,
    /// Shorter lanes between two intersections, or between one and a dead end, are part of the intersection (m); null is
    /// 2 `connect_m`. Only with positions alone.
    #[schemars(range(min = 0.0))]
    pub min_link_m: Option<f64>,
}

impl Default for RoadNetworkParams {
    fn default() -> Self {
        Self {
            connect_m: 2.0,
            prune_loops: None,
            spacing_m: None,
            min_loop_m: None,
            min_link_m: None,
            headings: true,
            same_line_m: None,
            vehicle_width_m: 2.0,
        }
    }
}

impl RoadNetworkParams {
    /// Whether the lengths make sense together.
    ///
    /// # Errors
    /// [`RoadNetworkError::Lengths`].
    pub fn check(&self) -> Result<(), RoadNetworkError> {
        let connect_m = self.connect_m;
        let sound = connect_m > 0.0 && connect_m.is_finite();
        if self.headings && self.spacing_m() == 0.0 {
            return Err(RoadNetworkError::EveryPose);
        }
        if sound && (0.0..=connect_m).contains(&self.spacing_m()) {
            return Ok(());
        }
        Err(RoadNetworkError::Lengths {
            connect_m,
            spacing_m: self.spacing_m(),
        })
    }

    pub(super) fn spacing_m(&self) -> f64 {
        self.spacing_m.unwrap_or(0.25 * self.connect_m)
    }

    pub(super) fn min_loop_m(&self) -> f64 {
        self.min_loop_m.unwrap_or(6.0 * self.connect_m)
    }

    pub(super) fn same_line_m(&self) -> f64 {
        self.same_line_m.unwrap_or(0.3 * self.connect_m)
    }

    pub(super) fn min_link_m(&self) -> f64 {
        self.min_link_m.unwrap_or(2.0 * self.connect_m)
    }
}

/// Input that gives no road network.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RoadNetworkError {
    /// Lengths that make no sense together.
    #[error("expected `spacing_m` from 0 to `connect_m`, found {spacing_m} m and {connect_m} m")]
    Lengths {
        /// The connecting distance given, metres.
        connect_m: f64,
        /// The spacing given or derived, metres.
        spacing_m: f64,
    },
    /// Every pose a node, with headings.
    #[error(
        "expected `headings: false` with `spacing_m: 0`, which follows the paper, found `headings: true`"
    )]
    EveryPose,
    /// More poses than node numbers.
    #[error("expected at most {} poses in one site, found {found}", u32::MAX)]
    TooMany {
        /// Number of poses.
        found: usize,
    },
}
