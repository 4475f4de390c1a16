//! A pose graph as a least-squares problem.

use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

use super::{Edge, Graph, Motion};
use crate::solving::least_squares::{
    BlockSystem, Linearisation, Options, Problem, Slot, Structure, Summary, SystemError, TrialStep,
    minimise,
};

/// Trust a first guess: Gauss–Newton steps, unless they fail. Odometry and loops leave a graph
/// that bends softly, and damping by curvature forbids just those motions.
pub fn options() -> Options {
    Options {
        initial_damping: 1e-8,
        ..Options::default()
    }
}

/// Edges that one task linearises at least: some tenths of a millisecond, more than waking a thread costs.
const CHUNK: usize = 512;

/// Relaxes a graph from its poses to a local minimum.
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn relax<M: Motion<D>, const D: usize>(
    graph: &mut Graph<M, D>,
    options: &Options,
) -> Result<Summary, SystemError> {
    let mut relaxation = Relaxation::new(graph)?;
    let summary = minimise(&mut relaxation, options);
    graph.poses = relaxation.into_poses();
    Ok(summary)
}

/// What an edge adds to the normal equations.
struct Terms<const D: usize> {
    cost: f64,
    from_from: SMatrix<f64, D, D>,
    from_to: SMatrix<f64, D, D>,
    to_to: SMatrix<f64, D, D>,
    from_gradient: SVector<f64, D>,
    to_gradient: SVector<f64, D>,
}

/// The unknowns of an edge: `None` where a pose is fixed.
#[derive(Clone, Copy)]
struct Unknowns {
    from: Option<usize>,
    to: Option<usize>,
    slot: Option<Slot>,
}

/// A graph with its normal equations; their structure is analysed once.
pub struct Relaxation<'g, M, const D: usize> {
    edges: Vec<&'g Edge<M, D>>,
    /// By edge: its index in the graph.
    numbers: Vec<usize>,
    graph_edges: usize,
    places: Vec<Unknowns>,
    /// By edge: multiplies the information, 1 unless set.
    weights: Vec<f64>,
    /// By pose: its unknown.
    unknown: Vec<Option<usize>>,
    poses: Vec<M>,
    trial: Vec<M>,
    system: BlockSystem<D>,
    terms: Vec<Terms<D>>,
}

impl<'g, M: Motion<D>, const D: usize> Relaxation<'g, M, D> {
    /// Begins at the graph's poses.
    ///
    /// # Errors
    /// [`SystemError`] when the graph is too large for memory.
    pub fn new(graph: &'g Graph<M, D>) -> Result<Self, SystemError> {
        let n = graph.poses.len();
        let mut unknowns = 0;
        let unknown: Vec<_> = (0..n)
            .map(|pose| {
                let free = !graph.fixed.get(pose).copied().unwrap_or(false);
                free.then(|| {
                    unknowns += 1;
                    unknowns - 1
                })
            })
            .collect();
        let numbered = graph.edges.iter().enumerate();
        let (numbers, edges): (Vec<usize>, Vec<&Edge<M, D>>) =
            numbered.filter(|(_, edge)| graph.joins(edge)).unzip();
        let pairs = edges
            .iter()
            .filter_map(|edge| Some((unknown[edge.from]?, unknown[edge.to]?)));
        let structure = Structure::new(unknowns, pairs)?;
        let places = edges.iter().map(|edge| {
            let (from, to) = (unknown[edge.from], unknown[edge.to]);
            let slot = from.zip(to).and_then(|(from, to)| structure.slot(from, to));
            Unknowns { from, to, slot }
        });
        Ok(Self {
            places: places.collect(),
            weights: vec![1.0; edges.len()],
            edges,
            numbers,
            graph_edges: graph.edges.len(),
            unknown,
            poses: graph.poses.clone(),
            trial: graph.poses.clone(),
            system: BlockSystem::new(structure)?,
            terms: Vec::new(),
        })
    }

    /// The estimate, and the end of the relaxation.
    pub fn into_poses(self) -> Vec<M> {
        self.poses
    }

    /// Squared weighted residuals `rᵀ Ω r` at the estimate, by edge of the graph and without
    /// [`Relaxation::set_weights`]; 0 for edges that do not connect two poses.
    pub fn squared_residuals(&self) -> Vec<f64> {
        let mut all = vec![0.0; self.graph_edges];
        for (number, edge) in self.numbers.iter().zip(&self.edges) {
            all[*number] = squared_residual(edge, &self.poses);
        }
        all
    }

    /// Multiplies the information of each edge of the graph from now on.
    pub fn set_weights(&mut self, weights: &[f64]) {
        for (number, of_edge) in self.numbers.iter().zip(&mut self.weights) {
            *of_edge = weights.get(*number).copied().unwrap_or(1.0);
        }
    }

    fn cost_at(&self, poses: &[M]) -> f64 {
        let costs: Vec<f64> = self
            .edges
            .par_iter()
            .with_min_len(CHUNK)
            .zip(&self.weights)
            .map(|(edge, weight)| weight * edge.loss.cost(squared_residual(edge, poses)))
            .collect();
        0.5 * costs.iter().sum::<f64>()
    }
}

fn squared_residual<M: Motion<D>, const D: usize>(edge: &Edge<M, D>, poses: &[M]) -> f64 {
    let r = M::residual(&edge.measured, &poses[edge.from], &poses[edge.to]);
    r.dot(&(edge.information * r))
}

fn terms<M: Motion<D>, const D: usize>(edge: &Edge<M, D>, weight: f64, poses: &[M]) -> Terms<D> {
    let (r, by_from, by_to) = M::linearise(&edge.measured, &poses[edge.from], &poses[edge.to]);
    let weighted = edge.information * r;
    let s = r.dot(&weighted);
    let scale = weight * edge.loss.weight(s);
    let information = edge.information * scale;
    let (of_from, of_to) = (information * by_from, information * by_to);
    Terms {
        cost: weight * edge.loss.cost(s),
        from_from: by_from.tr_mul(&of_from),
        from_to: by_from.tr_mul(&of_to),
        to_to: by_to.tr_mul(&of_to),
        from_gradient: of_from.tr_mul(&r),
        to_gradient: of_to.tr_mul(&r),
    }
}

impl<M: Motion<D>, const D: usize> Problem for Relaxation<'_, M, D> {
    fn linearise(&mut self) -> Linearisation {
        let (edges, poses) = (&self.edges, &self.poses);
        edges
            .par_iter()
            .with_min_len(CHUNK)
            .zip(&self.weights)
            .map(|(edge, weight)| terms(edge, *weight, poses))
            .collect_into_vec(&mut self.terms);
        self.system.clear();
        let mut cost = 0.0;
        for (terms, place) in self.terms.iter().zip(&self.places) {
            cost += terms.cost;
            if let Some(from) = place.from {
                self.system.add_diagonal(from, &terms.from_from);
                self.system.add_gradient(from, &terms.from_gradient);
            }
            if let Some(to) = place.to {
                self.system.add_diagonal(to, &terms.to_to);
                self.system.add_gradient(to, &terms.to_gradient);
            }
            if let Some(slot) = place.slot {
                self.system.add(slot, &terms.from_to);
            }
        }
        Linearisation {
            cost: 0.5 * cost,
            gradient_max: self.system.gradient_max(),
        }
    }

    fn solve(&mut self, damping: f64) -> Option<TrialStep> {
        self.system.solve(damping)
    }

    fn trial_cost(&mut self) -> f64 {
        let moved = self.poses.iter().zip(&self.unknown);
        for (trial, (pose, unknown)) in self.trial.iter_mut().zip(moved) {
            if let Some(unknown) = unknown {
                *trial = pose.moved(&self.system.step(*unknown));
            }
        }
        self.cost_at(&self.trial)
    }

    fn accept(&mut self) {
        self.poses.copy_from_slice(&self.trial);
    }
}
