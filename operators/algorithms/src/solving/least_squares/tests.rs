//! Losses against their derivatives, the sparse system against a dense one, the loop on problems
//! with known minima.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector, Vector2};
use proptest::prelude::*;

use super::*;

fn losses() -> impl Strategy<Value = Loss> {
    let scale = 0.3..4.0f64;
    prop_oneof![
        Just(Loss::Quadratic),
        scale.clone().prop_map(Loss::Huber),
        scale.clone().prop_map(Loss::Cauchy),
        scale.clone().prop_map(Loss::GemanMcClure),
        scale.prop_map(Loss::DynamicCovarianceScaling),
    ]
}

proptest! {
    #[test]
    fn weights_are_derivatives(loss in losses(), s in 1e-3..50.0f64) {
        let h = 1e-6 * s;
        let numeric = (loss.cost(s + h) - loss.cost(s - h)) / (2.0 * h);
        prop_assert!((numeric - loss.weight(s)).abs() < 1e-5);
        prop_assert!((0.0..=1.0).contains(&loss.weight(s)));
        prop_assert!(loss.cost(s) <= s * (1.0 + 1e-12));
    }

    #[test]
    fn sparse_systems_agree_with_dense_ones(
        unknowns in 1..30usize,
        pairs in prop::collection::vec((0..30usize, 0..30usize), 0..120),
        seed in any::<u32>(),
        damping in 1e-6..1.0f64,
    ) {
        check_against_dense::<3>(unknowns, &pairs, seed, damping);
        check_against_dense::<1>(unknowns, &pairs, seed, damping);
    }
}

/// Many pairs make the factor dense enough to go the supernodal way.
#[test]
fn dense_patterns_agree_too() {
    let pairs: Vec<_> = (0..40).flat_map(|a| (0..a).map(move |b| (a, b))).collect();
    check_against_dense::<6>(40, &pairs, 7, 0.1);
}

fn check_against_dense<const D: usize>(
    unknowns: usize,
    pairs: &[(usize, usize)],
    seed: u32,
    damping: f64,
) {
    let mut state = u64::from(seed);
    let mut random = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 33) as f64 / f64::from(u32::MAX >> 1) - 1.0
    };
    let structure = Structure::<D>::new(unknowns, pairs.iter().copied()).unwrap();
    let mut system = BlockSystem::new(structure).unwrap();
    let n = unknowns * D;
    let mut h = DMatrix::<f64>::zeros(n, n);
    let mut g = DVector::<f64>::zeros(n);
    for i in 0..unknowns {
        let block = SMatrix::<f64, D, D>::identity() * 0.1;
        system.add_diagonal(i, &block);
        h.fixed_view_mut::<D, D>(i * D, i * D)
            .add_assign_block(&block);
        let part = SVector::<f64, D>::from_fn(|_, _| random());
        system.add_gradient(i, &part);
        g.fixed_rows_mut::<D>(i * D).copy_from(&part);
    }
    for &(a, b) in pairs
        .iter()
        .filter(|(a, b)| a != b && *a < unknowns && *b < unknowns)
    {
        let ja = SMatrix::<f64, D, D>::from_fn(|_, _| random());
        let jb = SMatrix::<f64, D, D>::from_fn(|_, _| random());
        let cross = ja.transpose() * jb;
        system.add_diagonal(a, &(ja.transpose() * ja));
        system.add_diagonal(b, &(jb.transpose() * jb));
        system.add(system.structure().slot(a, b).unwrap(), &cross);
        h.fixed_view_mut::<D, D>(a * D, a * D)
            .add_assign_block(&(ja.transpose() * ja));
        h.fixed_view_mut::<D, D>(b * D, b * D)
            .add_assign_block(&(jb.transpose() * jb));
        h.fixed_view_mut::<D, D>(a * D, b * D)
            .add_assign_block(&cross);
        h.fixed_view_mut::<D, D>(b * D, a * D)
            .add_assign_block(&cross.transpose());
    }
    let step = system.solve(damping).unwrap();
    let d = DMatrix::from_diagonal(&h.diagonal());
    let expected = -(&h + &d * damping).clone().cholesky().unwrap().solve(&g);
    for i in 0..unknowns {
        let error = (system.step(i) - expected.fixed_rows::<D>(i * D)).norm();
        assert!(error < 1e-8 * expected.norm(), "{error}");
    }
    let falls = -(g.dot(&expected) + 0.5 * expected.dot(&(&h * &expected)));
    assert!((step.predicted_decrease - falls).abs() < 1e-9 * (1.0 + falls));
    assert!((step.moved - expected.amax()).abs() < 1e-8 * expected.norm());
}

trait AddAssignBlock<const D: usize> {
    fn add_assign_block(&mut self, block: &SMatrix<f64, D, D>);
}

impl<const D: usize, S> AddAssignBlock<D>
    for nalgebra::Matrix<f64, nalgebra::Const<D>, nalgebra::Const<D>, S>
where
    S: nalgebra::StorageMut<f64, nalgebra::Const<D>, nalgebra::Const<D>>,
{
    fn add_assign_block(&mut self, block: &SMatrix<f64, D, D>) {
        *self += block;
    }
}

/// Rosenbrock's valley as least squares: residuals `10 (y - x²)` and `1 - x`.
struct Valley {
    at: Vector2<f64>,
    step: Vector2<f64>,
    h: Matrix2<f64>,
    g: Vector2<f64>,
}

impl Valley {
    fn from(x: f64, y: f64) -> Self {
        Self {
            at: Vector2::new(x, y),
            step: Vector2::zeros(),
            h: Matrix2::zeros(),
            g: Vector2::zeros(),
        }
    }

    fn residual(at: Vector2<f64>) -> Vector2<f64> {
        Vector2::new(10.0 * (at.y - at.x * at.x), 1.0 - at.x)
    }
}

impl Problem for Valley {
    fn linearise(&mut self) -> Linearisation {
        let r = Self::residual(self.at);
        let j = Matrix2::new(-20.0 * self.at.x, 10.0, -1.0, 0.0);
        (self.h, self.g) = (j.transpose() * j, j.transpose() * r);
        Linearisation {
            cost: 0.5 * r.norm_squared(),
            gradient_max: self.g.amax(),
        }
    }

    fn solve(&mut self, damping: f64) -> Option<TrialStep> {
        let d = Matrix2::from_diagonal(&self.h.diagonal().map(damped_diagonal));
        self.step = -(self.h + d * damping).cholesky()?.solve(&self.g);
        Some(TrialStep {
            predicted_decrease: 0.5 * self.step.dot(&(d * damping * self.step - self.g)),
            moved: self.step.amax(),
        })
    }

    fn trial_cost(&mut self) -> f64 {
        0.5 * Self::residual(self.at + self.step).norm_squared()
    }

    fn accept(&mut self) {
        self.at += self.step;
    }
}

#[test]
fn the_valley_is_followed_to_its_end() {
    for (x, y) in [(-1.2, 1.0), (3.0, -5.0), (1.0, 1.0), (0.0, 0.0)] {
        let mut valley = Valley::from(x, y);
        let summary = minimise(&mut valley, &Options::default());
        assert!(summary.converged(), "{summary:?}");
        assert!((valley.at - Vector2::new(1.0, 1.0)).norm() < 1e-4);
        assert!(summary.final_cost <= summary.initial_cost);
    }
}

#[test]
fn a_nan_is_not_hidden_by_what_stands_beside_it() {
    for place in 0..3 {
        let mut entries = [1.0, -3.0, 2.0];
        assert_eq!(absolute_max(entries), 3.0);
        entries[place] = f64::NAN;
        assert!(absolute_max(entries).is_nan(), "{entries:?}");
    }
    assert_eq!(absolute_max([f64::NEG_INFINITY, 1.0]), f64::INFINITY);
    assert_eq!(absolute_max([0.0; 0]), 0.0);
}

#[test]
fn nonsense_stops_at_once() {
    let mut valley = Valley::from(f64::NAN, 0.0);
    let summary = minimise(&mut valley, &Options::default());
    assert_eq!(summary.stop, Stop::Stuck);
    assert_eq!(summary.accepted + summary.refused, 0);
}

#[test]
fn a_matrix_that_is_not_definite_is_no_step() {
    let mut system = BlockSystem::new(Structure::<2>::new(2, [(0, 1)]).unwrap()).unwrap();
    system.add_diagonal(0, &-Matrix2::identity());
    assert!(system.solve(1e-3).is_none());
    let empty = BlockSystem::new(Structure::<2>::new(0, []).unwrap())
        .unwrap()
        .solve(1.0);
    assert_eq!(empty.unwrap().moved, 0.0);
}
