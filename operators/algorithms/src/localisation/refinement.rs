//! The pose that explains the matches, by robust least squares.

use super::motion::{Guess, difference, moved};
use super::view::{Eye, eyes};
use super::{LandmarkMap, LocalisationParams};
use crate::pose::Pose;
use crate::rig::Rig;
use nalgebra::{Matrix2x6, Matrix6, Vector2, Vector6};
use std::collections::BTreeMap;

/// Standard deviations at which a residual's weight has fallen to a half (Cauchy).
const CAUCHY: f64 = 2.0;
/// Squared residual, in units of its variance, that 99 % of true matches stay below.
pub(super) const INLIER: f64 = 9.21;
/// Most steps of one solution; from a guess by odometry it takes four or five.
const MOST_STEPS: usize = 15;
/// A step shorter than this (m, rad) ends the iteration: far below any noise.
const SMALL: f64 = 1e-6;
/// Matches within a cell of this angle of one camera share their errors: a corner found at two scales, a landmark
/// triangulated twice, one leaf of a poster. Radians of the bearing; some 12 px of a 400 px fisheye.
const SHARED_CELL_PX: f64 = 12.0;

/// A landmark and the feature that is taken for it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub(super) landmark: usize,
    pub(super) camera: usize,
    pub(super) pixel: Vector2<f64>,
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
        let mut pose = *start;
        let mut cost = self.cost(&pose, &prior);
        for _ in 0..MOST_STEPS {
            let (information, gradient) = self.normal(&pose, &prior);
            let step = information.cholesky()?.solve(&gradient);
            let (next, next_cost, taken) = self.descend(&pose, &step, cost, &prior)?;
            pose = next;
            cost = next_cost;
            if taken.norm() < SMALL {
                break;
            }
        }
        self.finish(pose, &prior)
    }

    /// The longest of step, half a step, … that lowers the cost; no step when none of ten does.
    fn descend(
        &self,
        pose: &Pose,
        step: &Vector6<f64>,
        cost: f64,
        prior: &Matrix6<f64>,
    ) -> Option<(Pose, f64, Vector6<f64>)> {
        if step.iter().any(|x| !x.is_finite()) {
            return None;
        }
        let mut step = *step;
        for _ in 0..10 {
            let next = moved(pose, &step);
            let next_cost = self.cost(&next, prior);
            if next_cost <= cost {
                return Some((next, next_cost, step));
            }
            step *= 0.5;
        }
        Some((*pose, cost, Vector6::zeros()))
    }

    fn residual(&self, eyes: &[Eye<'_>], pair: &Pair) -> Option<Residual> {
        let landmark = self.map.landmarks().get(pair.landmark)?;
        let eye = eyes.get(pair.camera)?;
        let projection = eye.projection(&landmark.position)?;
        Some(Residual {
            offset: pair.pixel - projection.pixel,
            by_pose: projection.by_pose,
            variance: eye.noise_px2(landmark, projection.px_per_m, self.params.feature_px),
        })
    }

    fn residuals(&self, pose: &Pose) -> Vec<Option<Residual>> {
        let eyes = eyes(self.rig, pose);
        self.pairs
            .iter()
            .map(|pair| self.residual(&eyes, pair))
            .collect()
    }

    /// A pair whose landmark left the lens costs as much as one at the edge of the search.
    fn cost(&self, pose: &Pose, prior: &Matrix6<f64>) -> f64 {
        let c2 = CAUCHY * CAUCHY;
        let unseen = (self.params.search_px / self.params.feature_px).powi(2);
        let matched: f64 = self
            .residuals(pose)
            .iter()
            .map(|residual| c2 * (1.0 + residual.map_or(unseen, |known| known.units()) / c2).ln())
            .sum();
        let from_prior = difference(&self.prior.pose, pose);
        matched + from_prior.dot(&(prior * from_prior))
    }

    /// Information and gradient at a pose, weighed robustly.
    fn normal(&self, pose: &Pose, prior: &Matrix6<f64>) -> (Matrix6<f64>, Vector6<f64>) {
        let mut information = *prior;
        let mut gradient = -(prior * difference(&self.prior.pose, pose));
        for residual in self.residuals(pose).into_iter().flatten() {
            let weight = residual.weight() / residual.variance;
            information += residual.by_pose.transpose() * residual.by_pose * weight;
            gradient += residual.by_pose.transpose() * residual.offset * weight;
        }
        (information, gradient)
    }

    fn finish(&self, pose: Pose, prior: &Matrix6<f64>) -> Option<Refined> {
        let residuals = self.residuals(&pose);
        let is_inlier = |residual: &Residual| residual.units() <= INLIER;
        let mut information = Matrix6::zeros();
        for residual in residuals.iter().flatten().filter(|found| is_inlier(found)) {
            let weight = residual.weight() / residual.variance;
            information += residual.by_pose.transpose() * residual.by_pose * weight;
        }
        let scale = self.spread(&residuals, &information, prior);
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
        residuals: &[Option<Residual>],
        information: &Matrix6<f64>,
        prior: &Matrix6<f64>,
    ) -> f64 {
        let mut cells: BTreeMap<(usize, i64, i64), Vector6<f64>> = BTreeMap::new();
        for (pair, residual) in self.pairs.iter().zip(residuals) {
            if let Some(found) = residual.as_ref().filter(|found| found.units() <= INLIER) {
                let cell = pair.pixel.map(|x| (x / SHARED_CELL_PX).floor() as i64);
                let gradient =
                    found.by_pose.transpose() * found.offset * (found.weight() / found.variance);
                *cells
                    .entry((pair.camera, cell.x, cell.y))
                    .or_insert_with(Vector6::zeros) += gradient;
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
