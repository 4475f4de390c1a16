//! Is a relaxed graph the best there is, or did it end in a wrong valley?
//!
//! A lower bound on the cost of *all* poses there are, from the dual problem: `R` are rotations, so that with
//! `X = [R₁ t₁ … Rₙ tₙ]` and any symmetric `Λᵢ`
//!
//! ```text
//! q(X) = c + tr(X M Xᵀ) = c + Σ tr Λᵢ + tr(X S Xᵀ),   S = M - diag(Λᵢ, 0)
//! ```
//!
//! and where `S` is positive semidefinite, `c + Σ tr Λᵢ` is a bound. The `Λᵢ` that make the gradient vanish,
//! `sym(Rᵢᵀ (X M)ᵢ)`, bring it up to the cost at the poses; whether `S` is semidefinite is one sparse Cholesky
//! factorisation, smaller than that of a step of relaxation. An eigenvalue slightly below zero costs the bound its
//! share and no more: `S + ε D` is factorised, `D` the weight of the rotations at each pose, with a few `ε` until it is
//! definite, and `ε tr(X D Xᵀ)` is taken off.
//!
//! # From an edge to a quadratic form
//!
//! Rosen et al. assume noise that is equal along all axes. An edge with any information `Ω` is bounded from below by a
//! quadratic form in `X` that has its value and slope at the poses given (`ρ`, `φ` of the residual at them, `θ = |φ|`):
//!
//! - `D = diag(a I, b I) ⪯ Ω`, as large as it may be, is the part that is equal along all axes.
//! - `a |ρ|²` is at least `a |t_to - t_from - R_from z|²`: the logarithm lengthens.
//! - `b θ²` is convex in `cos θ`, which is linear in `R_fromᵀ R_to`: its tangent lies below it.
//! - The rest `Ω - D` weighs the residual measured along chords, `r = (e, φ sin θ / θ)`, which is bilinear in `X`; as a
//!   square it lies above its tangent, `2 r₀ᵀ (Ω - D) r - r₀ᵀ (Ω - D) r₀`.
//!
//! So the bound is one of the very cost that is relaxed where the information of positions is equal along all axes and
//! not coupled with rotation; elsewhere it is one of the cost with that rest along chords, which differs from it by
//! parts of the order of θ.
//!
//! Where the information is not equal, the poses with the least cost along chords are a little elsewhere, and the forms
//! touch their cost there: if there is no bound at the poses given, it is looked for at those that relaxing them along
//! chords leads to.
//!
//! Source: Rosen, Carlone, Bandeira & Leonard, *SE-Sync* (IJRR 2019), theorem 7 and equation 25; the certificate of a
//! given estimate: Carlone et al., *Lagrangian duality in 3D SLAM* (IROS 2015).

use nalgebra::{DMatrix, SMatrix, SVector};

use super::anchors::anchors;
use super::chordal::{Chordal, chordal};
use super::chords::{Chords, straight};
use super::{Edge, Graph, Motion, options, relax};
use crate::solving::least_squares::{BlockSystem, Loss, Options, Structure, SystemError};

/// The part of the cost that a bound may be short of, and that other poses must save to be better.
///
/// A hundredth: a wrong valley costs many times as much, and the chords that the bound is measured along are shorter
/// than their arcs by half a hundredth where rotations are off by a quarter of a radian.
pub const GAP: f64 = 1e-2;

/// Shifts of `S` that are tried, each twice the one before.
const SHIFTS: u32 = 6;

/// The part of an edge's expected cost, D/2, that counts as none: measurements without noise have no cost.
const NONE: f64 = 1e-6;

/// The least shift of `S`, in parts of its diagonal, that factorisation can tell from rounding.
const ROUNDING: f64 = 1e-12;

/// Beyond this angle the tangent of `θ²` is taken here: it is upright at half a turn.
const MOST_RAD: f64 = 3.0;

/// What is known about the cost of a relaxed graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Optimality {
    /// No other poses cost less by more than [`GAP`]: proven by the dual bound.
    Optimal,
    /// Other poses cost less by more than [`GAP`]: a start from all edges led to them.
    NotOptimal,
    /// Neither is known: the bound is too low, and no better poses were found.
    Unknown,
}

impl Optimality {
    /// As layers have it: `optimal`, `not_optimal`, `unknown`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Optimal => "optimal",
            Self::NotOptimal => "not_optimal",
            Self::Unknown => "unknown",
        }
    }
}

/// Says whether any other poses could cost less than the graph's. Edges with a loss other than the quadratic one are
/// outside the theory: [`Optimality::NotOptimal`] is possible with them, [`Optimality::Optimal`] is not.
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn certify<M, const D: usize, const R: usize, const H: usize>(
    graph: &Graph<M, D>,
) -> Result<Optimality, SystemError>
where
    M: Chordal<D, R, H>,
{
    let cost = graph.cost();
    // No cost is below zero.
    if cost <= slack(graph) {
        return Ok(Optimality::Optimal);
    }
    if let Some(bound) = lower_bound(graph)?
        && cost - bound <= slack(graph)
    {
        return Ok(Optimality::Optimal);
    }
    let mut other = graph.clone();
    other.poses = chordal(graph, &[])?;
    relax(&mut other, &options())?;
    Ok(if other.cost() < cost - slack(graph) {
        Optimality::NotOptimal
    } else {
        Optimality::Unknown
    })
}

/// A cost that no poses of the graph are below; `None` where none was found near the cost of the graph's poses, or
/// an edge has a loss other than the quadratic one.
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn lower_bound<M, const D: usize, const R: usize, const H: usize>(
    graph: &Graph<M, D>,
) -> Result<Option<f64>, SystemError>
where
    M: Chordal<D, R, H>,
{
    if graph.edges.iter().any(|e| e.loss != Loss::Quadratic) {
        return Ok(None);
    }
    if let Some(bound) = bound_at(graph, &graph.poses)? {
        return Ok(Some(bound));
    }
    let chords = |edge: &Edge<M, D>| Edge {
        from: edge.from,
        to: edge.to,
        measured: Chords::<M, R, H>(edge.measured),
        information: edge.information,
        loss: edge.loss,
    };
    let mut along_chords = Graph {
        poses: graph.poses.iter().map(|pose| Chords(*pose)).collect(),
        fixed: graph.fixed.clone(),
        edges: graph.edges.iter().map(chords).collect(),
    };
    let closely = Options {
        cost_tolerance: 1e-9,
        ..options()
    };
    relax(&mut along_chords, &closely)?;
    let poses: Vec<M> = along_chords.poses.iter().map(|pose| pose.0).collect();
    bound_at(graph, &poses)
}

/// The bound that the forms at certain poses lead to.
fn bound_at<M, const D: usize, const R: usize, const H: usize>(
    graph: &Graph<M, D>,
    poses: &[M],
) -> Result<Option<f64>, SystemError>
where
    M: Chordal<D, R, H>,
{
    const { assert!(H == R + 1) };
    let mut form = Form::<R, H>::new(graph, poses)?;
    for edge in graph.edges.iter().filter(|edge| graph.joins(edge)) {
        let (from, to) = (&poses[edge.from], &poses[edge.to]);
        form.add([edge.from, edge.to], &quadratic(edge, from, to));
    }
    Ok(form.bound(0.5 * slack(graph)))
}

/// The difference of costs that counts as none.
fn slack<M: Motion<D>, const D: usize>(graph: &Graph<M, D>) -> f64 {
    GAP * graph.cost() + NONE * 0.5 * (D * graph.edges.len()) as f64
}

/// `c + tr(A F Aᵀ) + tr(B T Bᵀ) + 2 tr(A C Bᵀ)` of an edge's poses `A = [R_from t_from]` and `B = [R_to t_to]`.
pub(super) struct Quadratic<const H: usize> {
    pub(super) constant: f64,
    pub(super) from: SMatrix<f64, H, H>,
    pub(super) to: SMatrix<f64, H, H>,
    pub(super) cross: SMatrix<f64, H, H>,
    /// What the edge's rotation weighs.
    turning: f64,
}

/// The lower bound of `½ rᵀ Ω r` that touches it at the poses given.
pub(super) fn quadratic<M, const D: usize, const R: usize, const H: usize>(
    edge: &Edge<M, D>,
    from: &M,
    to: &M,
) -> Quadratic<H>
where
    M: Chordal<D, R, H>,
{
    let (a, b) = isotropic::<D, R>(&edge.information);
    let (z, z_turn) = (edge.measured.position(), edge.measured.rotation_matrix());
    let residual = M::residual(&edge.measured, from, to);
    let theta = residual.rows(R, D - R).norm();
    let mut chord = residual;
    chord
        .fixed_rows_mut::<R>(0)
        .copy_from(&straight(&edge.measured, from, to));
    let mut turned = chord.rows_mut(R, D - R);
    turned *= if theta > 1e-9 {
        theta.sin() / theta
    } else {
        1.0
    };

    // a |t_to - t_from - R_from z|²
    let end = SVector::<f64, H>::from_fn(|row, _| f64::from(row == R));
    let step = SVector::<f64, H>::from_fn(|row, _| z.get(row).copied().unwrap_or(1.0));
    let mut constant = 0.0;
    let mut from = step * step.transpose() * a;
    let mut cross = step * end.transpose() * -a;

    // b θ² ≥ b (θ₁² + 2 k (cos θ₁ - cos θ)), and 2 cos θ is tr(R_from Z R_toᵀ), less one in space.
    let at = theta.min(MOST_RAD);
    let k = if at > 1e-9 { at / at.sin() } else { 1.0 };
    let less = if R == 3 { 1.0 } else { 0.0 };
    constant += b * (at * at + k * (2.0 * at.cos() + less));
    let mut across = z_turn * (-0.5 * b * k);

    // The tangent of the rest.
    let rest = rest::<D, R>(&edge.information, a, b) * chord;
    let along = z_turn * rest.fixed_rows::<R>(0);
    constant -= rest.dot(&chord) + 2.0 * along.dot(&z);
    across += z_turn * M::hat(&rest) * 0.5;
    for row in 0..R {
        cross[(row, R)] += along[row];
        from[(row, R)] -= along[row];
        from[(R, row)] -= along[row];
    }
    let mut rotations = cross.fixed_view_mut::<R, R>(0, 0);
    rotations += across;
    Quadratic {
        constant: 0.5 * constant,
        from: from * 0.5,
        to: end * end.transpose() * (0.5 * a),
        cross: cross * 0.5,
        turning: 0.5 * b * k,
    }
}

/// The largest `a` and `b` in a proportion for which `diag(a I, b I) ⪯ Ω`.
fn isotropic<const D: usize, const R: usize>(information: &SMatrix<f64, D, D>) -> (f64, f64) {
    let least = |first: usize, size: usize| {
        let block = information.view((first, first), (size, size));
        block.into_owned().symmetric_eigenvalues().min().max(0.0)
    };
    let (a, b) = (least(0, R), least(R, D - R));
    if information.view((0, R), (R, D - R)).amax() == 0.0 {
        return (a, b);
    }
    if a * b <= 0.0 {
        return (0.0, 0.0);
    }
    let scale = |row: usize| (if row < R { a } else { b }).sqrt();
    let scaled = SMatrix::<f64, D, D>::from_fn(|row, column| {
        information[(row, column)] / (scale(row) * scale(column))
    });
    let eigenvalues = DMatrix::from_column_slice(D, D, scaled.as_slice()).symmetric_eigenvalues();
    let both = eigenvalues.min().clamp(0.0, 1.0);
    (both * a, both * b)
}

/// `Ω - diag(a I, b I)`.
fn rest<const D: usize, const R: usize>(
    information: &SMatrix<f64, D, D>,
    a: f64,
    b: f64,
) -> SMatrix<f64, D, D> {
    let equal = SVector::<f64, D>::from_fn(|row, _| if row < R { a } else { b });
    information - SMatrix::from_diagonal(&equal)
}

/// `c + tr(X M Xᵀ)` of the poses that are not held, after the rotation that all anchors share.
struct Form<const R: usize, const H: usize> {
    /// By pose: its block of `X`; 0 for anchors.
    block: Vec<usize>,
    /// By pose: what makes `[R t]` of its block: `[R t; 0 0]` for anchors, else the identity.
    within: Vec<SMatrix<f64, H, H>>,
    /// By pose: `[R t]`.
    poses: Vec<SMatrix<f64, R, H>>,
    /// By block: the rotation.
    rotations: Vec<SMatrix<f64, R, R>>,
    /// By block: `(X M)ᵢ`.
    slope: Vec<SMatrix<f64, R, H>>,
    /// By block: what its rotation weighs.
    turning: Vec<f64>,
    constant: f64,
    /// `M`.
    system: BlockSystem<H>,
}

impl<const R: usize, const H: usize> Form<R, H> {
    fn new<M, const D: usize>(graph: &Graph<M, D>, at: &[M]) -> Result<Self, SystemError>
    where
        M: Chordal<D, R, H>,
    {
        let anchors = anchors(graph);
        let mut rotations = vec![SMatrix::identity()];
        let (mut block, mut within, mut poses) = (Vec::new(), Vec::new(), Vec::new());
        for (pose, anchor) in at.iter().zip(&anchors) {
            let mut top = SMatrix::<f64, R, H>::zeros();
            top.fixed_columns_mut::<R>(0)
                .copy_from(&pose.rotation_matrix());
            top.set_column(R, &pose.position());
            poses.push(top);
            if *anchor {
                let mut held = SMatrix::<f64, H, H>::zeros();
                held.fixed_rows_mut::<R>(0).copy_from(&top);
                within.push(held);
                block.push(0);
            } else {
                within.push(SMatrix::identity());
                block.push(rotations.len());
                rotations.push(pose.rotation_matrix());
            }
        }
        let edges = graph.edges.iter().filter(|edge| graph.joins(edge));
        let pairs = edges.map(|edge| (block[edge.from], block[edge.to]));
        let structure = Structure::new(rotations.len(), pairs)?;
        Ok(Self {
            within,
            poses,
            slope: vec![SMatrix::zeros(); rotations.len()],
            turning: vec![0.0; rotations.len()],
            constant: 0.0,
            system: BlockSystem::new(structure)?,
            block,
            rotations,
        })
    }

    fn add(&mut self, [from, to]: [usize; 2], edge: &Quadratic<H>) {
        let [a, b] = [self.block[from], self.block[to]];
        let [of_a, of_b] = [&self.within[from], &self.within[to]];
        let [x_a, x_b] = [&self.poses[from], &self.poses[to]];
        self.constant += edge.constant;
        self.turning[a] += edge.turning;
        self.turning[b] += edge.turning;
        self.slope[a] += (x_a * edge.from + x_b * edge.cross.transpose()) * of_a.transpose();
        self.slope[b] += (x_b * edge.to + x_a * edge.cross) * of_b.transpose();
        self.system
            .add_diagonal(a, &(of_a * edge.from * of_a.transpose()));
        self.system
            .add_diagonal(b, &(of_b * edge.to * of_b.transpose()));
        let cross = of_a * edge.cross * of_b.transpose();
        match self.system.structure().slot(a, b).filter(|_| a != b) {
            Some(slot) => self.system.add(slot, &cross),
            None => self.system.add_diagonal(a, &(cross + cross.transpose())),
        }
    }

    /// The dual bound, short of the best one by at most `share`; `None` where `S` is not semidefinite even so.
    fn bound(mut self, share: f64) -> Option<f64> {
        let mut bound = self.constant;
        for block in 0..self.rotations.len() {
            let slope = self.slope[block].fixed_columns::<R>(0);
            let multiplier = self.rotations[block].tr_mul(&slope);
            bound += multiplier.trace();
            let mut added = SMatrix::<f64, H, H>::zeros();
            let mut rotation = added.fixed_view_mut::<R, R>(0, 0);
            rotation -= (multiplier + multiplier.transpose()) * 0.5;
            // The anchors' rotation has no position of its own.
            added[(R, R)] = f64::from(block == 0);
            self.system.add_diagonal(block, &added);
        }
        let turning = R as f64 * self.turning.iter().sum::<f64>();
        if turning <= 0.0 {
            return None;
        }
        let shifts = (0..SHIFTS).rev().map(|halvings| {
            let part = share / f64::from(1 << halvings);
            (part / turning).max(ROUNDING)
        });
        let mut before = 0.0;
        for shift in shifts {
            self.shift(shift - before);
            if self.system.factorise(0.0).is_some() {
                return Some(bound - shift * turning);
            }
            before = shift;
        }
        None
    }

    /// `S` becomes `S + shift · D`.
    fn shift(&mut self, shift: f64) {
        for (block, turning) in self.turning.iter().enumerate() {
            let along = SVector::<f64, H>::from_fn(|row, _| f64::from(row < R) * shift * turning);
            self.system
                .add_diagonal(block, &SMatrix::from_diagonal(&along));
        }
    }
}
