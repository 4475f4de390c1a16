//! Drives round a block in any group of motions: what tests in space and on the plane share.

use nalgebra::{SMatrix, SVector};

use super::{Edge, Graph, Loss, Motion, options, relax};

pub(super) fn jacobians_are_derivatives<M: Motion<D>, const D: usize>(measured: M, from: M, to: M) {
    let (r, by_from, by_to) = M::linearise(&measured, &from, &to);
    assert!((r - M::residual(&measured, &from, &to)).norm() < 1e-12);
    // At half a turn the residual jumps.
    if r.amax() > 3.0 {
        return;
    }
    for column in 0..D {
        let mut xi = SVector::<f64, D>::zeros();
        xi[column] = 1e-6;
        let by = |plus: [M; 2], minus: [M; 2]| {
            (M::residual(&measured, &plus[0], &plus[1])
                - M::residual(&measured, &minus[0], &minus[1]))
                / 2e-6
        };
        let from_numeric = by([from.moved(&xi), to], [from.moved(&-xi), to]);
        let to_numeric = by([from, to.moved(&xi)], [from, to.moved(&-xi)]);
        let size = 1.0 + by_from.norm() + by_to.norm();
        assert!((from_numeric - by_from.column(column)).norm() < 1e-6 * size);
        assert!((to_numeric - by_to.column(column)).norm() < 1e-6 * size);
    }
}

/// Reproducible noise.
pub(super) struct Noise(pub(super) u64);

impl Noise {
    pub(super) fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(super) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().max(1e-300).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    pub(super) fn twist<const D: usize>(&mut self, sigma: f64) -> SVector<f64, D> {
        SVector::from_fn(|_, _| sigma * self.normal())
    }
}

/// A drive round and round a block, with odometry, and loops where a round meets the one before.
/// A part of the loops is false.
pub(super) fn rounds<M: Motion<D>, const D: usize>(
    truth: impl Fn(f64) -> M,
    false_part: f64,
    seed: u64,
) -> (Graph<M, D>, Vec<M>, Vec<bool>) {
    let mut noise = Noise(seed);
    const ROUND: usize = 60;
    let truth: Vec<M> = (0..3 * ROUND)
        .map(|step| truth(step as f64 / ROUND as f64))
        .collect();
    let edge = |from: usize, to: usize, measured: M, sigma: f64| Edge {
        from,
        to,
        measured,
        information: SMatrix::identity() / (sigma * sigma),
        loss: Loss::Quadratic,
    };
    let between = |from: usize, to: usize| truth[from].inverted().then(&truth[to]);
    let mut edges = Vec::new();
    for step in 1..truth.len() {
        let measured = between(step - 1, step).moved(&noise.twist(0.02));
        edges.push(edge(step - 1, step, measured, 0.02));
    }
    let mut is_false = vec![false; edges.len()];
    for step in (ROUND..truth.len()).step_by(2) {
        let lie = noise.uniform() < false_part;
        let other = if lie {
            (noise.uniform() * step as f64) as usize
        } else {
            step - ROUND
        };
        let mut measured = between(other, step).moved(&noise.twist(0.01));
        if lie {
            // Farther off than odometry can be after a round: nobody can tell smaller lies.
            let mut off = SVector::<f64, D>::zeros();
            off[0] =
                (10.0 + 10.0 * noise.uniform()) * if noise.uniform() < 0.5 { -1.0 } else { 1.0 };
            measured = measured.moved(&off).moved(&noise.twist(0.3));
        }
        edges.push(edge(other, step, measured, 0.01));
        is_false.push(lie);
    }
    let mut poses = vec![truth[0]];
    for step in 1..truth.len() {
        poses.push(poses[step - 1].then(&edges[step - 1].measured));
    }
    let mut fixed = vec![false; poses.len()];
    fixed[0] = true;
    (
        Graph {
            poses,
            fixed,
            edges,
        },
        truth,
        is_false,
    )
}

/// The relaxed poses that somebody finds who knows which edges are false.
pub(super) fn honest<M: Motion<D>, const D: usize>(
    graph: &Graph<M, D>,
    is_false: &[bool],
) -> Vec<M> {
    let mut honest = graph.clone();
    let mut lies = is_false.iter();
    honest.edges.retain(|_| lies.next() == Some(&false));
    relax(&mut honest, &options()).unwrap();
    honest.poses
}

/// Holds what was found among false loops to what somebody finds who knows which they are: no false loop is believed,
/// and the poses explain the edges as well, but for what one loop may cost: that cost has many minima. Where a place hangs on a few loops, leaving a true one out may explain them
/// better than the truth does; then nothing in the edges tells that it is true.
pub(super) fn is_found_as_well_as_by_who_knows<M: Motion<D>, const D: usize>(
    graph: &Graph<M, D>,
    weights: &[f64],
    is_false: &[bool],
    honest: &[M],
    cutoff: f64,
) {
    let pairs = || weights.iter().zip(is_false);
    let wrongly = pairs().filter(|(weight, lie)| **lie && **weight > 0.5);
    assert_eq!(wrongly.count(), 0, "false loops that were believed");
    let cost = |poses: &[M]| -> f64 {
        let cost = |(edge, lie): (&Edge<M, D>, &bool)| {
            let r = M::residual(&edge.measured, &poses[edge.from], &poses[edge.to]);
            let s = (r.transpose() * edge.information * r)[(0, 0)];
            let is_loop = edge.to != edge.from + 1 || *lie;
            if is_loop { s.min(cutoff) } else { s }
        };
        graph.edges.iter().zip(is_false).map(cost).sum()
    };
    let (found, best) = (cost(&graph.poses), cost(honest));
    assert!(found < best + cutoff, "cost {found}, known {best}");
    let lost = pairs().filter(|(weight, lie)| !**lie && **weight < 0.5);
    let lost = lost.count();
    assert!(lost <= 3, "{lost} true loops lost");
    let off = error(&graph.poses, honest);
    assert!(lost > 0 || off < 0.01, "{off} off with all true loops");
}

/// Largest distance of a pose from the truth.
pub(super) fn error<M: Motion<D>, const D: usize>(poses: &[M], truth: &[M]) -> f64 {
    let errors = poses.iter().zip(truth);
    let errors = errors.map(|(pose, truth)| M::residual(&M::identity(), truth, pose).norm());
    errors.fold(0.0, f64::max)
}
