//! How panoramas are registered, and when that failed.

use nalgebra::Matrix6;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::State;
use super::alignment::Fit;

/// How panoramas are registered, and when that failed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Options {
    /// How far from each other two panoramas may have been taken (m).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub reach_m: f64,
    /// Surfaces are no nearer than this (m): what changes faster from pixel to pixel is the edge of something.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub nearest_m: f64,
    /// Points that are compared at each size, at most: by default one of 17 pixels at 1024 × 333, more do not help.
    #[schemars(range(min = 100))]
    pub points: u32,
    /// A registration failed where the other sees less than this share of the points.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_overlap: f64,
    /// It failed where less than this share of what they tell of the place is as it should be: things that moved and are not
    /// labelled so have a say in it.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_inliers: f64,
    /// It failed where brightness, within tiles of the image, correlates less than this: 0.55 to 0.9 in views of one place
    /// three years apart, mostly below 0.35 in views of two.
    #[schemars(range(min = -1.0, max = 1.0))]
    pub min_correlation: f64,
    /// It is ambiguous where another place fits more than this share as well as the best one.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_runner_up: f64,
    /// It failed where its position has a larger standard deviation than this (m), along the axis that is known least.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_deviation_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            reach_m: 5.0,
            nearest_m: 1.0,
            points: 20_000,
            min_overlap: 0.5,
            min_inliers: 0.5,
            min_correlation: 0.5,
            max_runner_up: 0.93,
            max_deviation_m: 0.2,
        }
    }
}

impl Options {
    pub(super) fn state(
        &self,
        fit: &Fit,
        runner_up: f64,
        covariance: &Matrix6<f64>,
        rests: bool,
    ) -> State {
        let position = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let worst = position.symmetric_eigenvalues().max();
        if fit.overlap < self.min_overlap {
            State::FewSeen
        } else if fit.inliers < self.min_inliers {
            State::FewInliers
        } else if fit
            .correlation
            .is_some_and(|alike| alike < self.min_correlation)
        {
            State::Unlike
        } else if runner_up > self.max_runner_up {
            State::Ambiguous
        } else if !(worst.is_finite() && worst.sqrt() <= self.max_deviation_m) {
            State::Uncertain
        } else if !rests {
            State::Restless
        } else {
            State::Converged
        }
    }
}
