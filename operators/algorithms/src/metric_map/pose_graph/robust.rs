//! False loops, by graduated non-convexity.
//!
//! Odometry is believed, loops are doubted: each doubted edge gets a weight in [0, 1] next to its
//! information, and an outlier may cost no more than `cutoff`. That problem has many local minima;
//! it is approached from a convex one, in which every loop pulls a little, in steps of `μ`. It begins
//! at the poses given, which odometry made. A loop that stays beyond the cutoff while the others pull the graph straight ends with weight 0.
//!
//! Unlike a robust loss alone, this does not need a first guess in which true loops already fit:
//! after a long drive, odometry has drifted by many standard deviations of a loop.
//!
//! Source: Yang, Antonante, Tzoumas, Carlone, *Graduated non-convexity for robust spatial
//! perception* (RA-L 2020), truncated least squares, equations 12 to 14.

use super::relaxation::Relaxation;
use super::{Graph, Motion};
use crate::solving::least_squares::{Options, SystemError, minimise};

/// How far `μ` goes at each step, as in the paper.
const GROWTH: f64 = 1.4;

/// `rᵀ Ω r` that a true measurement of six degrees of freedom exceeds once in a thousand: the
/// quantile of χ² with 6 degrees of freedom.
pub const CUTOFF_SPATIAL: f64 = 22.46;

/// Most values of `μ`.
const MAX_STEPS: usize = 100;

/// Relaxes a graph in which the edges that `doubted` names (by edge) may be false. Returns a weight
/// by edge: 1 for an edge that was believed, 0 for one that was found to be false, rarely between.
/// `cutoff` is in units of `rᵀ Ω r`.
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn relax_robustly<M: Motion<D>, const D: usize>(
    graph: &mut Graph<M, D>,
    doubted: &[bool],
    cutoff: f64,
    options: &Options,
) -> Result<Vec<f64>, SystemError> {
    let mut relaxation = Relaxation::new(graph)?;
    let is_doubted = |edge: usize| doubted.get(edge).copied().unwrap_or(false);
    let mut weights = vec![1.0; graph.edges.len()];
    let rough = Options {
        cost_tolerance: 1e-3,
        max_iterations: 3,
        ..*options
    };
    let residuals = relaxation.squared_residuals();
    let worst = residuals.iter().enumerate();
    let worst = worst.filter(|(edge, _)| is_doubted(*edge));
    let worst = worst.fold(0.0, |max: f64, (_, s)| max.max(*s));
    // Equation 13: no loop is out of reach yet, and the worst pulls least.
    let mut mu = if worst > 0.5 * cutoff {
        (cutoff / (2.0 * worst - cutoff)).max(1e-9)
    } else {
        f64::INFINITY
    };
    for _ in 0..MAX_STEPS {
        if !mu.is_finite() {
            break;
        }
        let residuals = relaxation.squared_residuals();
        let mut undecided = 0;
        for (edge, weight) in weights
            .iter_mut()
            .enumerate()
            .filter(|(e, _)| is_doubted(*e))
        {
            *weight = truncated(residuals[edge], cutoff, mu);
            undecided += usize::from(*weight > 0.0 && *weight < 1.0);
        }
        relaxation.set_weights(&weights);
        minimise(&mut relaxation, &rough);
        if undecided == 0 {
            break;
        }
        mu *= GROWTH;
    }
    settle(&mut relaxation, &mut weights, &is_doubted, cutoff, options);
    let poses = relaxation.into_poses();
    graph.poses = poses;
    Ok(weights)
}

/// Weight of a residual at `μ`: equation 14.
fn truncated(s: f64, cutoff: f64, mu: f64) -> f64 {
    if s >= (mu + 1.0) / mu * cutoff || s.is_nan() {
        0.0
    } else if s <= mu / (mu + 1.0) * cutoff {
        1.0
    } else {
        ((cutoff * mu * (mu + 1.0) / s).sqrt() - mu).clamp(0.0, 1.0)
    }
}

/// Ends with weights of 0 and 1 that agree with the residuals they lead to.
fn settle<M: Motion<D>, const D: usize>(
    relaxation: &mut Relaxation<'_, M, D>,
    weights: &mut [f64],
    is_doubted: &dyn Fn(usize) -> bool,
    cutoff: f64,
    options: &Options,
) {
    for _ in 0..5 {
        let residuals = relaxation.squared_residuals();
        let mut changed = false;
        for (edge, weight) in weights
            .iter_mut()
            .enumerate()
            .filter(|(e, _)| is_doubted(*e))
        {
            let decided = if residuals[edge] <= cutoff { 1.0 } else { 0.0 };
            changed |= decided != *weight;
            *weight = decided;
        }
        relaxation.set_weights(weights);
        minimise(relaxation, options);
        if !changed {
            break;
        }
    }
}
