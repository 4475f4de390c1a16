//! The pose that explains the matches, by robust least squares.

use super::motion::{Guess, difference, moved};
use super::view::{direction, eyes};
use super::{LandmarkMap, LocalisationParams};
use crate::geometry::pose::Pose;
use crate::geometry::rig::Rig;
use nalgebra::{Matrix2x6, Matrix6, Vector2, Vector6};
use std::collections::BTreeMap;

/// Standard deviations at which a residual's weight has fallen to a half (Cauchy).
const CAUCHY: f64 = 2.0;
/// Squared residual, in units of its variance, that 99 % of true matches stay below.
pub(super) const INLIER: f64 = 9.21;
/// Most steps of one solution; from a guess by odometry it takes four or five.
const MOST_STEPS: usize = 15;
/// A step shorter than this (m, rad) ends the iteration: far below any noise.
const SMALL: f64 = 1e-5;

/// A landmark and the feature that is taken for it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub(super) landmark: usize,
    pub(super) camera: usize,
    pub(super) pixel: Vector2<f64>,
    /// How inexactly the feature is placed.
    pub(super) blur: f64,
}

/// How well a pair fits a pose.
#[derive(Debug, Clone, Copy)]
struct Residual {
    /// Feature minus projection, pixels.
    offset: Vector2<f64>,
    by_pose: Matrix2x6<f64>,
    variance: f64,
}

impl Residual {
    fn units(&self) -> f64 {
        self.offset.norm_squared() / self.variance
    }

    fn weight(&self) -> f64 {
        1.0 / (1.0 + self.units() / (CAUCHY * CAUCHY))
    }
}

/// A problem: pairs, and odometry's opinion.
pub(super) struct Refinement<'a> {
    pub(super) rig: &'a Rig,
    pub(super) map: &'a LandmarkMap,
    pub(super) pairs: &'a [Pair],
    pub(super) prior: &'a Guess,
    pub(super) params: &'a LocalisationParams,
}

/// What came out.
#[derive(Debug, Clone)]
pub(super) struct Refined {
    /// The pose and its covariance.
    pub(super) guess: Guess,
    /// Per pair: its distance in the image and its weight; `None` for outliers.
    pub(super) inliers: Vec<Option<(f64, f64)>>,
}

impl Refinement<'_> {
    /// Solves from a start. `None` when the numbers break down.
    pub(super) fn solve(&self, start: &Pose) -> Option<Refined> {
        let prior = self.prior.covariance.cholesky()?.inverse();
        let variances = self.variances(start);
        let mut pose = *start;
        let mut cost = self.cost(&pose, &prior, &variances);
        for _ in 0..MOST_STEPS {
            let (information, gradient) = self.normal(&pose, &prior, &variances);
            let step = information.cholesky()?.solve(&gradient);
            let lower = |next: &Pose| {
                let next_cost = self.cost(next, &prior, &variances);
                (next_cost <= cost).then_some(next_cost)
            };
            let Some((taken, next_cost)) = descend(&pose, step, lower) else {
                break;
            };
            pose = moved(&pose, &taken);
            cost = next_cost;
            if taken.norm() < SMALL {
                break;
            }
        }
        self.finish(pose, &prior, &variances)
    }

    /// Variances of the pairs' residuals, px²; infinite for a landmark that the lens does not see. They stay the same
    /// during one solution: it moves by little, and costs are comparable only so.
    fn variances(&self, pose: &Pose) -> Vec<f64> {
        let eyes = eyes(self.rig, pose);
        let variance = |pair: &Pair| {
            let landmark = self.map.landmarks().get(pair.landmark)?;
            let eye = eyes.get(pair.camera)?;
            let px_per_m = eye.projection(&landmark.position)?.px_per_m;
            let feature_px = self.params.features.sigma_px * pair.blur;
            Some(eye.noise_px2(landmark, px_per_m, feature_px))
        };
        self.pairs
            .iter()
            .map(|pair| variance(pair).unwrap_or(f64::INFINITY))
            .collect()
    }

    fn residuals(&self, pose: &Pose, variances: &[f64]) -> Vec<Option<Residual>> {
        let eyes = eyes(self.rig, pose);
        let pairs = self.pairs.iter().zip(variances);
        let residual = |(pair, variance): (&Pair, &f64)| {
            if !variance.is_finite() {
                return None;
            }
            let position = &self.map.landmarks()[pair.landmark].position;
            let projection = eyes[pair.camera].projection(position)?;
            Some(Residual {
                offset: pair.pixel - projection.pixel,
                by_pose: projection.by_pose,
                variance: *variance,
            })
        };
        pairs.map(residual).collect()
    }

    /// A pair whose landmark leaves the lens costs as much as one at the edge of the search.
    fn cost(&self, pose: &Pose, prior: &Matrix6<f64>, variances: &[f64]) -> f64 {
        let c2 = CAUCHY * CAUCHY;
        let unseen = (self.params.search_px / self.params.features.sigma_px).powi(2);
        let eyes = eyes(self.rig, pose);
        let pairs = self
            .pairs
            .iter()
            .zip(variances)
            .filter(|(_, variance)| variance.is_finite());
        let matched: f64 = pairs
            .map(|(pair, variance)| {
                let position = &self.map.landmarks()[pair.landmark].position;
                let seen = eyes[pair.camera].project(position);
                let units = seen.map_or(unseen, |pixel| {
                    (pair.pixel - pixel).norm_squared() / variance
                });
                c2 * (units / c2).ln_1p()
            })
            .sum();
        let from_prior = difference(&self.prior.pose, pose);
        matched + from_prior.dot(&(prior * from_prior))
    }

    /// Information and gradient at a pose, weighed robustly.
    fn normal(
        &self,
        pose: &Pose,
        prior: &Matrix6<f64>,
        variances: &[f64],
    ) -> (Matrix6<f64>, Vector6<f64>) {
        let mut information = *prior;
        let mut gradient = -(prior * difference(&self.prior.pose, pose));
        for residual in self.residuals(pose, variances).into_iter().flatten() {
            let weight = residual.weight() / residual.variance;
            information += residual.by_pose.transpose() * residual.by_pose * weight;
            gradient += residual.by_pose.transpose() * residual.offset * weight;
        }
        (information, gradient)
    }

    fn finish(&self, pose: Pose, prior: &Matrix6<f64>, variances: &[f64]) -> Option<Refined> {
        let residuals = self.residuals(&pose, variances);
        let is_inlier = |residual: &Residual| residual.units() <= INLIER;
        let mut information = Matrix6::zeros();
        for residual in residuals.iter().flatten().filter(|found| is_inlier(found)) {
            // The loss's own curvature, in the mean of directions: w + w' r² = w².
            let curvature = residual.weight().powi(2) / residual.variance;
            information += residual.by_pose.transpose() * residual.by_pose * curvature;
        }
        let scale = self.spread(&pose, &residuals, &information, prior);
        let covariance = (information / scale + prior).cholesky()?.inverse();
        let inliers = residuals.iter().map(|residual| {
            let found = (*residual)?;
            is_inlier(&found).then(|| (found.offset.norm(), found.weight()))
        });
        Some(Refined {
            guess: Guess { pose, covariance },
            inliers: inliers.collect(),
        })
    }

    /// How much larger the covariance is than the inverse information: with H the information, and gᵢ the gradient
    /// of all residuals that share one cell of an image, trace(H⁻¹ Σ gᵢ gᵢᵀ) / 6, the mean of the cluster-robust
    /// ("sandwich") covariance over the plain one. It is the mean squared residual where errors are independent,
    /// and more where neighbours err together.
    fn spread(
        &self,
        pose: &Pose,
        residuals: &[Option<Residual>],
        information: &Matrix6<f64>,
        prior: &Matrix6<f64>,
    ) -> f64 {
        let mut cells: BTreeMap<[i64; 2], Vector6<f64>> = BTreeMap::new();
        for (pair, residual) in self.pairs.iter().zip(residuals) {
            if let Some(found) = residual.as_ref().filter(|found| found.units() <= INLIER) {
                let ray = pose.rotation.inverse()
                    * (self.map.landmarks()[pair.landmark].position - pose.translation);
                let cell = direction(&ray);
                let gradient =
                    found.by_pose.transpose() * found.offset * (found.weight() / found.variance);
                *cells.entry(cell).or_insert_with(Vector6::zeros) += gradient;
            }
        }
        let count = cells.len() as f64;
        let Some(factor) = (information + prior).cholesky() else {
            return 1.0;
        };
        let total: f64 = cells
            .values()
            .map(|gradient| gradient.dot(&factor.solve(gradient)))
            .sum();
        // Six unknowns were fitted to 2 × count numbers. Few cells say little about the spread: the assumed noise
        // counts as six more.
        let fitted = 2.0 * count / (2.0 * count - 6.0).max(1.0);
        let found = fitted * total / 6.0;
        ((found * count + 6.0) / (count + 6.0)).max(0.1)
    }
}

/// The longest of step, half a step, … that lowers the cost, with that cost; `None` where none of ten does, as with
/// numbers that broke down.
#[allow(
    clippy::option_option,
    reason = "no step is a result, a broken one is none"
)]
fn descend(
    pose: &Pose,
    mut step: Vector6<f64>,
    lower: impl Fn(&Pose) -> Option<f64>,
) -> Option<(Vector6<f64>, f64)> {
    for _ in 0..10 {
        if let Some(cost) = lower(&moved(pose, &step)) {
            return Some((step, cost));
        }
        step *= 0.5;
    }
    None
}
