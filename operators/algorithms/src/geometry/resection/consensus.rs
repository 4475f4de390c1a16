//! The pose that most correspondences agree with: PROSAC's order of samples, MSAC's score, local optimisation.

use super::ResectionOptions;
use super::minimal;
use super::refinement::adjust;
use super::sight::{RigidMatrix, Sight};
use crate::geometry::pose::Pose;
use crate::solving::random::SplitMix64;

/// A pose with its score.
pub(super) struct Consensus {
    pub(super) world_from_vehicle: Pose,
    /// Sum of squared misses, each cut off at the gate; lower is better.
    pub(super) cost: f64,
}

/// Draws three sights at a time, first from the best by quality and then from ever more (Chum, Matas: PROSAC, 2005),
/// keeps the pose of the least cost (Torr, Zisserman: MLESAC, 2000) and improves each new best by an adjustment of its
/// inliers (Chum, Matas, Kittler: Locally Optimized RANSAC, 2003). It ends when a pose with more inliers than the best, or
/// with as many as are asked for, would have been drawn. `sights` are sorted by quality, the best first.
pub(super) fn search(sights: &[Sight], options: &ResectionOptions) -> Option<Consensus> {
    if sights.len() < 3 {
        return None;
    }
    let mut best: Option<Consensus> = None;
    // A pose of fewer inliers is none, so that longer need not be sought.
    let mut needed = iterations(options.min_inliers, sights.len(), options);
    let mut sampler = Sampler::new(sights.len(), needed, options.seed);
    let mut iteration = 0;
    while iteration < needed {
        iteration += 1;
        let rays = sampler.next().map(|i| sights[i].ray);
        minimal::solve(&rays, |pose| {
            let limit = best.as_ref().map_or(f64::INFINITY, |best| best.cost);
            let Some(found) = cost(sights, &pose, options.gate, limit) else {
                return;
            };
            let found = optimised(sights, pose, found, options.gate);
            let inliers = inliers(sights, &found.0, options.gate).len();
            needed = needed.min(iterations(inliers, sights.len(), options));
            best = Some(Consensus {
                world_from_vehicle: found.0,
                cost: found.1,
            });
        });
    }
    best
}

/// None as soon as it is not below the limit.
fn cost(sights: &[Sight], pose: &Pose, gate: f64, limit: f64) -> Option<f64> {
    let frame = RigidMatrix::from(&pose.inverse());
    let mut sum = 0.0;
    for sight in sights {
        sum += sight.miss(&frame, gate).map_or(gate, |miss| miss.squared());
        if sum >= limit {
            return None;
        }
    }
    Some(sum)
}

/// Those that the pose explains.
pub(super) fn inliers<'a>(sights: &'a [Sight], pose: &Pose, gate: f64) -> Vec<&'a Sight> {
    let frame = RigidMatrix::from(&pose.inverse());
    let agrees = |sight: &&Sight| sight.miss(&frame, gate).is_some();
    sights.iter().filter(agrees).collect()
}

/// Adjusted to its inliers, as often as that lowers the cost.
fn optimised(sights: &[Sight], mut pose: Pose, mut least: f64, gate: f64) -> (Pose, f64) {
    for _ in 0..3 {
        let agreed = inliers(sights, &pose, gate);
        if agreed.len() < 4 {
            break;
        }
        let Some(adjusted) = adjust(&agreed, &pose, gate) else {
            break;
        };
        let Some(lower) = cost(sights, &adjusted.world_from_vehicle, gate, least) else {
            break;
        };
        (pose, least) = (adjusted.world_from_vehicle, lower);
    }
    (pose, least)
}

/// Samples after which one without outliers was drawn with the confidence asked for.
fn iterations(inliers: usize, all: usize, options: &ResectionOptions) -> usize {
    let clean = (0..3).map(|drawn| inliers.saturating_sub(drawn) as f64 / (all - drawn) as f64);
    let clean: f64 = clean.product();
    let needed = (1.0 - options.confidence).ln() / (-clean).ln_1p();
    if needed.is_finite() {
        (needed.ceil() as usize).clamp(1, options.max_iterations)
    } else if clean >= 1.0 {
        1
    } else {
        options.max_iterations
    }
}

/// PROSAC's growing pool: after as many samples as uniform sampling would have drawn from the first n alone, the pool
/// grows by one, and each sample holds the newest of the pool.
struct Sampler {
    all: usize,
    pool: usize,
    /// T'_n and T_n of the paper.
    until: f64,
    average: f64,
    drawn: f64,
    random: SplitMix64,
}

impl Sampler {
    /// Of so many sights, for so many samples.
    fn new(all: usize, samples: usize, seed: u64) -> Self {
        let share = (0..3).map(|i| (3 - i) as f64 / (all - i) as f64);
        Self {
            all,
            pool: 3,
            until: 1.0,
            average: samples as f64 * share.product::<f64>(),
            drawn: 0.0,
            random: SplitMix64(seed),
        }
    }

    fn next(&mut self) -> [usize; 3] {
        self.drawn += 1.0;
        while self.drawn > self.until && self.pool < self.all {
            let n = self.pool as f64;
            let next = self.average * (n + 1.0) / (n - 2.0);
            self.until += (next - self.average).ceil();
            self.average = next;
            self.pool += 1;
        }
        let newest = (self.drawn <= self.until).then(|| self.pool - 1);
        let third = newest.unwrap_or_else(|| self.random.below(self.all));
        let pool = if newest.is_some() {
            self.pool - 1
        } else {
            self.all
        };
        let first = self.other(pool, [third; 2]);
        let second = self.other(pool, [third, first]);
        [first, second, third]
    }

    fn other(&mut self, pool: usize, taken: [usize; 2]) -> usize {
        loop {
            let drawn = self.random.below(pool);
            if !taken.contains(&drawn) {
                return drawn;
            }
        }
    }
}
