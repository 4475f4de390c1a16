//! False loops, by graduated non-convexity.
//!
//! Odometry is believed, loops are doubted: each doubted edge gets a weight in [0, 1] next to its
//! information, and an outlier may cost no more than `cutoff`. That problem has many local minima;
//! it is approached from a convex one, in which every loop pulls a little, in steps of `μ`. A loop that stays beyond
//! the cutoff while the others pull the graph straight ends with weight 0.
//!
//! It begins at the poses given, which odometry made. Where that left out a loop, or is not certified to be the best,
//! odometry alone may have been too far off: it begins once more at the [`super::chordal`] start, and the end with the
//! lower cost is taken.
//!
//! Unlike a robust loss alone, this does not need a first guess in which true loops already fit:
//! after a long drive, odometry has drifted by many standard deviations of a loop.
//!
//! Source: Yang, Antonante, Tzoumas, Carlone, *Graduated non-convexity for robust spatial
//! perception* (RA-L 2020), truncated least squares, equations 12 to 14.

use super::certificate::{Optimality, certify};
use super::chordal::{Chordal, chordal};
use super::relaxation::Relaxation;
use super::{Edge, Graph, Motion};
use crate::solving::least_squares::{Options, SystemError, minimise};

/// How far `μ` goes at each step, as in the paper.
const GROWTH: f64 = 1.4;

/// `rᵀ Ω r` that a true measurement of six degrees of freedom exceeds once in a thousand: the
/// quantile of χ² with 6 degrees of freedom.
pub const CUTOFF_SPATIAL: f64 = 22.46;

/// Most values of `μ`.
const MAX_STEPS: usize = 100;

/// Costs that differ by less than this part are those of one minimum, approached from two sides.
const SAME: f64 = 1e-4;

/// How a graph was relaxed.
#[derive(Debug, Clone, PartialEq)]
pub struct Settled {
    /// By edge: 1 for one that was believed, 0 for one that was found to be false, rarely between.
    pub weights: Vec<f64>,
    /// Whether other poses of the graph with these weights could cost less. That other weights could is not known.
    pub optimality: Optimality,
}

/// Relaxes a graph in which the edges that `doubted` names (by edge) may be false. `cutoff` is in units of `rᵀ Ω r`.
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn relax_robustly<M, const D: usize, const R: usize, const H: usize>(
    graph: &mut Graph<M, D>,
    doubted: &[bool],
    cutoff: f64,
    options: &Options,
) -> Result<Settled, SystemError>
where
    M: Chordal<D, R, H>,
{
    let mut other = graph.clone();
    let weights = descend(graph, doubted, cutoff, options)?;
    let optimality = certify(&believed(graph, &weights))?;
    let settled = Settled {
        weights,
        optimality,
    };
    if optimality == Optimality::Optimal && settled.weights.iter().all(|weight| *weight == 1.0) {
        return Ok(settled);
    }
    other.poses = chordal(&other, doubted)?;
    let weights = descend(&mut other, doubted, cutoff, options)?;
    if truncated_cost(&other, doubted, cutoff)
        >= (1.0 - SAME) * truncated_cost(graph, doubted, cutoff)
    {
        return Ok(settled);
    }
    graph.poses = other.poses;
    let optimality = certify(&believed(graph, &weights))?;
    Ok(Settled {
        weights,
        optimality,
    })
}

/// `½ Σ rᵀ Ω r`, of which a doubted edge costs no more than `½ cutoff`.
fn truncated_cost<M: Motion<D>, const D: usize>(
    graph: &Graph<M, D>,
    doubted: &[bool],
    cutoff: f64,
) -> f64 {
    let costs = graph.edges.iter().enumerate().map(|(index, edge)| {
        let s = graph.squared_residual(edge);
        let is_doubted = doubted.get(index).copied().unwrap_or(false);
        if is_doubted { s.min(cutoff) } else { s }
    });
    0.5 * costs.sum::<f64>()
}

/// The graph that was relaxed in the end.
fn believed<M: Motion<D>, const D: usize>(graph: &Graph<M, D>, weights: &[f64]) -> Graph<M, D> {
    let weighted = |(edge, weight): (&Edge<M, D>, &f64)| Edge {
        information: edge.information * *weight,
        ..*edge
    };
    let edges = graph.edges.iter().zip(weights);
    let edges = edges.filter(|(_, weight)| **weight > 0.0).map(weighted);
    Graph {
        poses: graph.poses.clone(),
        fixed: graph.fixed.clone(),
        edges: edges.collect(),
    }
}

/// From the graph's poses to a local minimum, and the weights there.
fn descend<M: Motion<D>, const D: usize>(
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
