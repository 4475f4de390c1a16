//! A start from all edges at once.
//!
//! Odometry alone drifts: after a long drive the heading may be off by half a turn, and Gauss–Newton then winds the
//! graph up in the wrong valley. Here rotations are relaxed to arbitrary matrices: `R_to = R_from Z` is linear in them,
//! so that one sparse least-squares problem gives the matrices that fit all edges best, and the nearest rotations are
//! taken. With rotations known, positions are linear, too. No guess is needed, and the result is mostly close enough
//! for Gauss–Newton.
//!
//! Edges that are doubted count with Huber's loss in both problems, by iteratively reweighted least squares. Both
//! problems stay convex, so that false loops pull with a bounded force and there is no wrong valley yet.
//!
//! Source: Martinec & Pajdla, *Robust rotation and translation estimation in multiview reconstruction* (CVPR 2007);
//! Carlone et al., *Initialization techniques for 3D SLAM* (ICRA 2015), section III-B; least unsquared deviations of
//! relaxed rotations: Wang & Singer, *Exact and stable recovery of rotations for robust synchronization* (2013).

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::anchors::anchors;
use super::{Edge, Graph, Motion};
use crate::geometry::lie::so3;
use crate::geometry::pose::Pose;
use crate::solving::least_squares::{BlockSystem, Loss, Structure, SystemError};

/// Keeps the factorisation definite; far below any weight that matters.
const DAMPING: f64 = 1e-12;

/// Solutions with new weights for the edges that are doubted; the weights of a convex loss settle fast.
const ROUNDS: usize = 10;

/// A motion as an R × R rotation matrix and a translation. H = R + 1 is the size of its homogeneous matrix.
pub trait Chordal<const D: usize, const R: usize, const H: usize>: Motion<D> {
    /// Its rotation.
    fn rotation_matrix(&self) -> SMatrix<f64, R, R>;

    /// Its translation (m).
    fn position(&self) -> SVector<f64, R>;

    /// With the rotation that is nearest to a matrix; `None` when that has none.
    fn nearest(matrix: &SMatrix<f64, R, R>, position: &SVector<f64, R>) -> Option<Self>;

    /// The skew-symmetric matrix of the rotational part of a twist, which follows R numbers of translation.
    fn hat(twist: &SVector<f64, D>) -> SMatrix<f64, R, R>;
}

impl Chordal<6, 3, 4> for Pose {
    fn rotation_matrix(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    fn position(&self) -> Vector3<f64> {
        self.translation
    }

    fn nearest(matrix: &Matrix3<f64>, position: &Vector3<f64>) -> Option<Self> {
        if matrix.iter().any(|value| !value.is_finite()) || matrix.norm() < 1e-9 {
            return None;
        }
        let svd = matrix.try_svd(true, true, f64::EPSILON, 200)?;
        let (u, v_t) = (svd.u?, svd.v_t?);
        let mirror = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
        let rotation = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&mirror) * v_t);
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
        Some(Self::new(*position, rotation))
    }

    fn hat(twist: &SVector<f64, 6>) -> Matrix3<f64> {
        so3::hat(&twist.fixed_rows::<3>(3).into_owned())
    }
}

/// Moves the graph's poses to where all edges say, unless they cost less where they are. Did it?
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn start<M, const D: usize, const R: usize, const H: usize>(
    graph: &mut Graph<M, D>,
) -> Result<bool, SystemError>
where
    M: Chordal<D, R, H>,
{
    let given = graph.cost();
    let poses = chordal(graph, &[])?;
    let given_poses = std::mem::replace(&mut graph.poses, poses);
    // Not `>=`: NaN is worse, too.
    let better = graph.cost() < given || given.is_nan();
    if !better {
        graph.poses = given_poses;
    }
    Ok(better)
}

/// Poses that fit all edges best, rotations first. Fixed poses stay; a connected part without one hangs off its first
/// pose, which stays. Other poses of the graph are not used. `doubted` names, by edge, those that may be false.
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn chordal<M, const D: usize, const R: usize, const H: usize>(
    graph: &Graph<M, D>,
    doubted: &[bool],
) -> Result<Vec<M>, SystemError>
where
    M: Chordal<D, R, H>,
{
    let mut problem = Relaxed::new(graph, doubted)?;
    let rotations = problem.rotations();
    let turned = graph.poses.iter().zip(&rotations);
    let turned = turned.map(|(pose, r)| M::nearest(r, &pose.position()).unwrap_or(*pose));
    let mut poses: Vec<M> = turned.collect();
    let positions = problem.positions(&poses);
    for (pose, position) in positions.iter().enumerate() {
        poses[pose] = match problem.unknown[pose] {
            Some(_) => M::nearest(&poses[pose].rotation_matrix(), position).unwrap_or(poses[pose]),
            None => graph.poses[pose],
        };
    }
    Ok(poses)
}

/// A linear problem with a block of R unknowns per pose that is no anchor.
struct Relaxed<'g, M, const D: usize, const R: usize> {
    graph: &'g Graph<M, D>,
    edges: Vec<&'g Edge<M, D>>,
    /// By edge: may it be false?
    doubted: Vec<bool>,
    /// By edge: how much it counts.
    weights: Vec<f64>,
    unknown: Vec<Option<usize>>,
    system: BlockSystem<R>,
}

impl<'g, M, const D: usize, const R: usize> Relaxed<'g, M, D, R> {
    fn new(graph: &'g Graph<M, D>, doubted: &[bool]) -> Result<Self, SystemError> {
        let edges = graph.edges.iter().enumerate();
        let edges = edges.filter(|(_, edge)| graph.joins(edge));
        let doubted = |index: usize| doubted.get(index).copied().unwrap_or(false);
        let (doubted, edges): (Vec<bool>, Vec<&Edge<M, D>>) =
            edges.map(|(index, edge)| (doubted(index), edge)).unzip();
        let mut unknowns = 0..;
        let anchors = anchors(graph);
        let unknown: Vec<Option<usize>> = anchors
            .iter()
            .map(|anchor| if *anchor { None } else { unknowns.next() })
            .collect();
        let pairs = edges
            .iter()
            .filter_map(|edge| Some((unknown[edge.from]?, unknown[edge.to]?)));
        let structure = Structure::new(unknowns.start, pairs)?;
        Ok(Self {
            graph,
            weights: vec![1.0; edges.len()],
            edges,
            doubted,
            unknown,
            system: BlockSystem::new(structure)?,
        })
    }

    /// Adds `½ |x_to - A x_from|²_W` to the Hessian.
    fn add(&mut self, [from, to]: [usize; 2], a: &SMatrix<f64, R, R>, w: &SMatrix<f64, R, R>) {
        let wa = w * a;
        if let Some(from) = self.unknown[from] {
            self.system.add_diagonal(from, &a.tr_mul(&wa));
        }
        if let Some(to) = self.unknown[to] {
            self.system.add_diagonal(to, w);
        }
        if let (Some(from), Some(to)) = (self.unknown[from], self.unknown[to])
            && let Some(slot) = self.system.structure().slot(from, to)
        {
            self.system.add(slot, &-wa.transpose());
        }
    }

    /// Adds its gradient where the residual is `r`; `weighted` is `W r`.
    fn add_gradient(
        &mut self,
        [from, to]: [usize; 2],
        a: &SMatrix<f64, R, R>,
        weighted: &SVector<f64, R>,
    ) {
        if let Some(from) = self.unknown[from] {
            self.system.add_gradient(from, &-a.tr_mul(weighted));
        }
        if let Some(to) = self.unknown[to] {
            self.system.add_gradient(to, weighted);
        }
    }

    /// Solves again and again, each time with weights by what the edges' squared residuals are.
    fn reweighted<S>(
        &mut self,
        solve: impl Fn(&mut Self) -> S,
        squared: impl Fn(&Edge<M, D>, &S) -> f64,
    ) -> S {
        let mut solution = solve(self);
        if !self.doubted.contains(&true) {
            return solution;
        }
        // A residual has R degrees of freedom.
        let loss = Loss::Huber((R as f64).sqrt());
        let believed = self.weights.clone();
        for _ in 1..ROUNDS {
            for edge in (0..self.edges.len()).filter(|edge| self.doubted[*edge]) {
                let s = squared(self.edges[edge], &solution);
                self.weights[edge] = believed[edge] * loss.weight(s);
            }
            solution = solve(self);
        }
        solution
    }

    /// What the unknowns begin from: anchors stay, all others are zero.
    fn begin<T: Clone>(&self, zero: T, anchor: impl Fn(&M) -> T) -> Vec<T> {
        let poses = self.unknown.iter().zip(&self.graph.poses);
        poses
            .map(|(unknown, pose)| unknown.map_or_else(|| anchor(pose), |_| zero.clone()))
            .collect()
    }

    fn rotations<const H: usize>(&mut self) -> Vec<SMatrix<f64, R, R>>
    where
        M: Chordal<D, R, H>,
    {
        let measured = self.edges.iter();
        let measured: Vec<_> = measured
            .map(|edge| edge.measured.rotation_matrix().transpose())
            .collect();
        let solve = |problem: &mut Self| problem.transposed(&measured);
        let squared = |edge: &Edge<M, D>, x: &Vec<SMatrix<f64, R, R>>| {
            let turn = edge.measured.rotation_matrix().transpose();
            0.5 * turning::<M, D, R>(edge) * (x[edge.to] - turn * x[edge.from]).norm_squared()
        };
        let transposed = self.reweighted(solve, squared);
        transposed.iter().map(SMatrix::transpose).collect()
    }

    /// The transposed rotations `X` obey `X_to = Zᵀ X_from`, one column at a time.
    fn transposed<const H: usize>(
        &mut self,
        measured: &[SMatrix<f64, R, R>],
    ) -> Vec<SMatrix<f64, R, R>>
    where
        M: Chordal<D, R, H>,
    {
        let mut x = self.begin(SMatrix::zeros(), |pose| pose.rotation_matrix().transpose());
        let edges = self.edges.iter().zip(&self.weights).zip(measured);
        let edges: Vec<_> = edges
            .map(|((edge, weight), turn)| {
                (
                    [edge.from, edge.to],
                    weight * turning::<M, D, R>(edge),
                    *turn,
                )
            })
            .collect();
        self.system.clear();
        for (ends, weight, turn) in &edges {
            self.add(*ends, turn, &(SMatrix::identity() * *weight));
        }
        if self.system.factorise(DAMPING).is_none() {
            return x;
        }
        for column in 0..R {
            self.system.clear_gradient();
            for (ends, weight, turn) in &edges {
                let r = x[ends[1]].column(column) - turn * x[ends[0]].column(column);
                self.add_gradient(*ends, turn, &(r * *weight));
            }
            if self.system.back_substitute().is_some() {
                for (x, unknown) in x.iter_mut().zip(&self.unknown) {
                    if let Some(unknown) = unknown {
                        x.set_column(column, &self.system.step(*unknown));
                    }
                }
            }
        }
        x
    }

    /// Positions obey `t_to = t_from + R_from z`.
    fn positions<const H: usize>(&mut self, poses: &[M]) -> Vec<SVector<f64, R>>
    where
        M: Chordal<D, R, H>,
    {
        let information = |edge: &Edge<M, D>| {
            let turn = poses[edge.to].rotation_matrix();
            turn * edge.information.fixed_view::<R, R>(0, 0) * turn.transpose()
        };
        let residual = |edge: &Edge<M, D>, at: &[SVector<f64, R>]| {
            let step = poses[edge.from].rotation_matrix() * edge.measured.position();
            at[edge.to] - at[edge.from] - step
        };
        let same = SMatrix::identity();
        let solve = |problem: &mut Self| {
            let mut positions = problem.begin(SVector::zeros(), M::position);
            problem.system.clear();
            for index in 0..problem.edges.len() {
                let edge = problem.edges[index];
                let (ends, w) = (
                    [edge.from, edge.to],
                    information(edge) * problem.weights[index],
                );
                problem.add(ends, &same, &w);
                problem.add_gradient(ends, &same, &(w * residual(edge, &positions)));
            }
            if problem.system.solve(DAMPING).is_some() {
                for (position, unknown) in positions.iter_mut().zip(&problem.unknown) {
                    if let Some(unknown) = unknown {
                        *position = problem.system.step(*unknown);
                    }
                }
            }
            positions
        };
        let squared = |edge: &Edge<M, D>, at: &Vec<SVector<f64, R>>| {
            let r = residual(edge, at);
            r.dot(&(information(edge) * r))
        };
        self.reweighted(solve, squared)
    }
}

/// The mean information of an edge's rotation (1/rad²).
fn turning<M, const D: usize, const R: usize>(edge: &Edge<M, D>) -> f64 {
    (R..D).map(|at| edge.information[(at, at)]).sum::<f64>() / (D - R) as f64
}
