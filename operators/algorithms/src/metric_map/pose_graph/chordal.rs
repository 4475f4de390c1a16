//! A first guess from all edges at once.
//!
//! Rotations are relaxed to arbitrary matrices: `R_to = R_from Z` is linear in them, so that one
//! sparse least-squares problem gives the matrices that fit all edges best, and the nearest
//! rotations are taken. With rotations known, positions are linear, too. No guess is needed, and
//! the result is mostly close enough for Gauss–Newton.
//!
//! Source: Martinec & Pajdla, *Robust rotation and translation estimation in multiview
//! reconstruction* (CVPR 2007); Carlone et al., *Initialization techniques for 3D SLAM* (ICRA
//! 2015), section III-B.

use nalgebra::{Matrix2, Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::initial::anchors;
use super::{Edge, Graph, Motion};
use crate::solving::least_squares::{BlockSystem, Structure, SystemError};
use crate::geometry::lie::se2::PlanarPose;
use crate::geometry::pose::Pose;

/// Keeps the factorisation definite; far below any weight that matters.
const DAMPING: f64 = 1e-12;

/// A motion as an R × R rotation matrix and a translation.
pub trait Chordal<const D: usize, const R: usize>: Motion<D> {
    /// Its rotation.
    fn rotation_matrix(&self) -> SMatrix<f64, R, R>;

    /// Its translation (m).
    fn position(&self) -> SVector<f64, R>;

    /// With the rotation that is nearest to a matrix; `None` when that has none.
    fn nearest(matrix: &SMatrix<f64, R, R>, position: &SVector<f64, R>) -> Option<Self>;
}

impl Chordal<3, 2> for PlanarPose {
    fn rotation_matrix(&self) -> Matrix2<f64> {
        self.rotation()
    }

    fn position(&self) -> Vector2<f64> {
        self.translation
    }

    fn nearest(matrix: &Matrix2<f64>, position: &Vector2<f64>) -> Option<Self> {
        let (sin, cos) = (matrix.m21 - matrix.m12, matrix.m11 + matrix.m22);
        let known = sin.hypot(cos) > 1e-9;
        known.then(|| Self::new(position.x, position.y, sin.atan2(cos)))
    }
}

impl Chordal<6, 3> for Pose {
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
        Some(Self::new(
            *position,
            UnitQuaternion::from_rotation_matrix(&rotation),
        ))
    }
}

/// Poses that fit all edges best, rotations first. Fixed poses stay; a connected part without one
/// hangs off its first pose. The poses of the graph are not used otherwise.
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn chordal<M: Chordal<D, R>, const D: usize, const R: usize>(
    graph: &Graph<M, D>,
) -> Result<Vec<M>, SystemError> {
    let anchors = anchors(graph);
    let (n, edges) = (graph.poses.len(), &graph.edges);
    let edges: Vec<&Edge<M, D>> = edges
        .iter()
        .filter(|edge| edge.from < n && edge.to < n && edge.from != edge.to)
        .collect();
    let mut linear = Linear::new(&anchors, &edges)?;
    let rotations = rotations(&mut linear, graph, &edges);
    let turned: Vec<M> = graph
        .poses
        .iter()
        .zip(&rotations)
        .map(|(pose, rotation)| M::nearest(rotation, &pose.position()).unwrap_or(*pose))
        .collect();
    let positions = positions(&mut linear, &turned, &edges);
    let poses = turned.iter().zip(&positions);
    let poses = poses.map(|(pose, at)| M::nearest(&pose.rotation_matrix(), at).unwrap_or(*pose));
    let mut poses: Vec<M> = poses.collect();
    for (pose, given) in (0..n)
        .filter(|pose| anchors[*pose])
        .map(|p| (p, graph.poses[p]))
    {
        poses[pose] = given;
    }
    Ok(poses)
}

/// A linear problem with a block of R unknowns per pose that is no anchor.
struct Linear<const R: usize> {
    unknown: Vec<Option<usize>>,
    system: BlockSystem<R>,
}

impl<const R: usize> Linear<R> {
    fn new<M, const D: usize>(
        anchors: &[bool],
        edges: &[&Edge<M, D>],
    ) -> Result<Self, SystemError> {
        let mut unknowns = 0;
        let unknown: Vec<_> = anchors
            .iter()
            .map(|anchor| {
                (!anchor).then(|| {
                    unknowns += 1;
                    unknowns - 1
                })
            })
            .collect();
        let pairs = edges
            .iter()
            .filter_map(|edge| Some((unknown[edge.from]?, unknown[edge.to]?)));
        let system = BlockSystem::new(Structure::new(unknowns, pairs)?)?;
        Ok(Self { unknown, system })
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

    /// Adds its gradient where the residual is `r`.
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

    /// The solution of one unknown; `given` for an anchor.
    fn solution(&self, pose: usize, given: SVector<f64, R>) -> SVector<f64, R> {
        self.unknown[pose].map_or(given, |unknown| self.system.step(unknown))
    }
}

/// The transposed rotations `X` obey `X_to = Zᵀ X_from`, one column at a time.
fn rotations<M: Chordal<D, R>, const D: usize, const R: usize>(
    linear: &mut Linear<R>,
    graph: &Graph<M, D>,
    edges: &[&Edge<M, D>],
) -> Vec<SMatrix<f64, R, R>> {
    let mut transposed: Vec<_> = graph
        .poses
        .iter()
        .map(|pose| pose.rotation_matrix().transpose())
        .collect();
    for (pose, x) in transposed.iter_mut().enumerate() {
        if linear.unknown[pose].is_some() {
            *x = SMatrix::zeros();
        }
    }
    let measured: Vec<_> = edges
        .iter()
        .map(|edge| {
            let mean = (R..D).map(|at| edge.information[(at, at)]).sum::<f64>() / (D - R) as f64;
            (edge.measured.rotation_matrix().transpose(), mean)
        })
        .collect();
    linear.system.clear();
    for (edge, (turn, weight)) in edges.iter().zip(&measured) {
        linear.add([edge.from, edge.to], turn, &(SMatrix::identity() * *weight));
    }
    if linear.system.factorise(DAMPING).is_none() {
        return transposed.iter().map(SMatrix::transpose).collect();
    }
    for column in 0..R {
        linear.system.clear_gradient();
        for (edge, (turn, weight)) in edges.iter().zip(&measured) {
            let r =
                transposed[edge.to].column(column) - turn * transposed[edge.from].column(column);
            linear.add_gradient([edge.from, edge.to], turn, &(r * *weight));
        }
        if linear.system.back_substitute().is_some() {
            for (pose, x) in transposed.iter_mut().enumerate() {
                let given = x.column(column).into_owned();
                x.set_column(column, &linear.solution(pose, given));
            }
        }
    }
    transposed.iter().map(SMatrix::transpose).collect()
}

/// Positions obey `t_to = t_from + R_from z`.
fn positions<M: Chordal<D, R>, const D: usize, const R: usize>(
    linear: &mut Linear<R>,
    poses: &[M],
    edges: &[&Edge<M, D>],
) -> Vec<SVector<f64, R>> {
    let mut positions: Vec<_> = poses.iter().map(M::position).collect();
    for (pose, position) in positions.iter_mut().enumerate() {
        if linear.unknown[pose].is_some() {
            *position = SVector::zeros();
        }
    }
    linear.system.clear();
    let same = SMatrix::identity();
    for edge in edges {
        let turn = poses[edge.to].rotation_matrix();
        let information = edge.information.fixed_view::<R, R>(0, 0).into_owned();
        let weight = turn * information * turn.transpose();
        let step = poses[edge.from].rotation_matrix() * edge.measured.position();
        let r = positions[edge.to] - positions[edge.from] - step;
        linear.add([edge.from, edge.to], &same, &weight);
        linear.add_gradient([edge.from, edge.to], &same, &(weight * r));
    }
    if linear.system.solve(DAMPING).is_some() {
        for (pose, position) in positions.iter_mut().enumerate() {
            *position = linear.solution(pose, *position);
        }
    }
    positions
}
