//! A rig's pose from points it sees: the points in a metric frame, the bearings in its cameras, and outliers among the
//! pairs.
//!
//! All of the rig's cameras count together and their rays need not meet, so that the points' metres are the pose's
//! metres, and lenses of 180 degrees and more are no special case: nothing here divides by a depth, errors are angles.
//! [`resect`] needs no guess; [`refine`] starts from one.

mod chance;
mod consensus;
mod minimal;
mod polynomial;
mod refinement;
mod sight;
#[cfg(test)]
mod tests;

pub use chance::inliers_beyond_chance;
pub(crate) use refinement::moved;
pub(crate) use sight::across;

use nalgebra::{Matrix3, Matrix6, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::geometry::pose::Pose;
use consensus::inliers;
use refinement::adjust;
use sight::Sight;

/// Rounds of adjustment and new choice of inliers; they settle after two or three.
const MAX_ROUNDS: usize = 10;

/// A point, and the bearing that is thought to see it.
#[derive(Debug, Clone, PartialEq)]
pub struct Correspondence {
    /// The camera's index in the rig.
    pub camera: usize,
    /// Towards the point; optical frame of the camera; of any length but zero.
    pub bearing: Vector3<f64>,
    /// Standard deviation of the bearing across itself, radians.
    pub sigma_rad: f64,
    /// The point, in the frame that the pose is asked for; metres.
    pub point: Vector3<f64>,
    /// Its covariance, m²; zero for a point known exactly.
    pub point_covariance: Matrix3<f64>,
    /// Which to try first: higher is better. Only its order matters.
    pub quality: f64,
}

/// How to search. How long is a parameter of those who search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ResectionOptions {
    /// Squared error in standard deviations up to which a correspondence is an inlier. Of two degrees of freedom: 9.21
    /// keeps 99 % of the true ones.
    #[serde(skip)]
    pub gate: f64,
    /// The search ends when a sample without outliers was drawn with this probability.
    #[serde(skip)]
    pub confidence: f64,
    /// Samples of the search for a pose, at most: 99 % for 13 % of inliers.
    pub max_iterations: usize,
    /// Fewer inliers are no pose. Never taken below four.
    #[serde(skip)]
    pub min_inliers: usize,
    /// Seed of the samples.
    #[serde(skip)]
    pub seed: u64,
}

impl Default for ResectionOptions {
    fn default() -> Self {
        Self {
            gate: 9.21,
            confidence: 0.99,
            max_iterations: 2000,
            min_inliers: 8,
            seed: 0,
        }
    }
}

/// A pose that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Resection {
    /// The vehicle in the frame of the points.
    pub world_from_vehicle: Pose,
    /// Covariance of the pose: translation along the world's axes (m²), then rotation about them (rad²). It counts the
    /// errors of all correspondences as independent, and is enlarged where they are larger than expected.
    pub covariance: Matrix6<f64>,
    /// The correspondences that agree, by their index in the list given, ascending.
    pub inliers: Vec<usize>,
    /// Mean squared error of the inliers, in units of their variances: about 1 where sigmas are honest.
    pub variance_factor: f64,
}

/// The pose of a rig with cameras mounted at `vehicle_from_camera`, without a guess; none where too few correspondences
/// agree on one. Correspondences with a camera that is not there, or with numbers that are none, are left out.
pub fn resect(
    vehicle_from_camera: &[Pose],
    correspondences: &[Correspondence],
    options: &ResectionOptions,
) -> Option<Resection> {
    let sights = sights(vehicle_from_camera, correspondences);
    if sights.len() < options.min_inliers.max(4) {
        return None;
    }
    let found = consensus::search(&sights, options)?;
    settled(&sights, found.world_from_vehicle, options, &[1.0])
}

/// As [`resect`], from a guess near enough that the true correspondences stand out within three times their gates.
pub fn refine(
    vehicle_from_camera: &[Pose],
    correspondences: &[Correspondence],
    guess: &Pose,
    options: &ResectionOptions,
) -> Option<Resection> {
    let sights = sights(vehicle_from_camera, correspondences);
    settled(&sights, *guess, options, &[9.0, 3.0, 1.0])
}

/// Best first; of equal ones the first given.
fn sights(vehicle_from_camera: &[Pose], correspondences: &[Correspondence]) -> Vec<Sight> {
    let indexed = correspondences.iter().enumerate();
    let usable = |(index, given)| Sight::new(vehicle_from_camera, index, given);
    let mut sights: Vec<_> = indexed.filter_map(usable).collect();
    sights.sort_by(|a, b| b.quality.total_cmp(&a.quality).then(a.index.cmp(&b.index)));
    sights
}

/// Adjusts and chooses inliers by turns until they stay the same, with gates that narrow.
fn settled(
    sights: &[Sight],
    start: Pose,
    options: &ResectionOptions,
    gates: &[f64],
) -> Option<Resection> {
    let mut pose = start;
    let mut last = None;
    for factor in gates {
        let gate = options.gate * factor;
        let mut chosen: Vec<usize> = Vec::new();
        for _ in 0..MAX_ROUNDS {
            let agreed = inliers(sights, &pose, gate);
            if agreed.len() < options.min_inliers.max(4) {
                return None;
            }
            let indices: Vec<_> = agreed.iter().map(|sight| sight.index).collect();
            if indices == chosen {
                break;
            }
            let adjusted = adjust(&agreed, &pose, gate)?;
            pose = adjusted.world_from_vehicle;
            chosen = indices;
            last = Some(adjusted);
        }
    }
    let adjusted = last?;
    let agreed = inliers(sights, &pose, options.gate);
    if agreed.len() < options.min_inliers.max(4) {
        return None;
    }
    let mut found: Vec<_> = agreed.iter().map(|sight| sight.index).collect();
    found.sort_unstable();
    let covariance = adjusted.information.cholesky()?.inverse() * adjusted.variance_factor.max(1.0);
    Some(Resection {
        world_from_vehicle: pose,
        covariance,
        inliers: found,
        variance_factor: adjusted.variance_factor,
    })
}
