//! Residuals of position along the chord of a motion, not its arc.
//!
//! The logarithm bends a motion's translation by its rotation. Without that, it is linear in position, which is what
//! the [`super::certificate`] is about.

use nalgebra::SVector;

use super::chordal::Chordal;
use super::motion::{Linear, Motion};

/// A motion whose residual is `(e, φ)`: the error's translation as it is, and the logarithm of its rotation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chords<M, const R: usize, const H: usize>(pub(super) M);

/// `e = Zᵀ (R_fromᵀ (t_to - t_from) - z)`, as twists have it.
pub(super) fn straight<M, const D: usize, const R: usize, const H: usize>(
    measured: &M,
    from: &M,
    to: &M,
) -> SVector<f64, R>
where
    M: Chordal<D, R, H>,
{
    let between = seen::<M, D, R, H>(from, to) - measured.position();
    measured.rotation_matrix().tr_mul(&between)
}

/// Where one pose sees the other.
fn seen<M, const D: usize, const R: usize, const H: usize>(from: &M, to: &M) -> SVector<f64, R>
where
    M: Chordal<D, R, H>,
{
    let apart = to.position() - from.position();
    from.rotation_matrix().tr_mul(&apart)
}

impl<M, const D: usize, const R: usize, const H: usize> Motion<D> for Chords<M, R, H>
where
    M: Chordal<D, R, H>,
{
    fn identity() -> Self {
        Self(M::identity())
    }

    fn then(&self, right: &Self) -> Self {
        Self(self.0.then(&right.0))
    }

    fn inverted(&self) -> Self {
        Self(self.0.inverted())
    }

    fn moved(&self, xi: &SVector<f64, D>) -> Self {
        Self(self.0.moved(xi))
    }

    fn residual(measured: &Self, from: &Self, to: &Self) -> SVector<f64, D> {
        let mut r = M::residual(&measured.0, &from.0, &to.0);
        r.fixed_rows_mut::<R>(0)
            .copy_from(&straight(&measured.0, &from.0, &to.0));
        r
    }

    fn linearise(measured: &Self, from: &Self, to: &Self) -> Linear<D> {
        let (mut r, mut by_from, mut by_to) = M::linearise(&measured.0, &from.0, &to.0);
        r.fixed_rows_mut::<R>(0)
            .copy_from(&straight(&measured.0, &from.0, &to.0));
        let turn = measured.0.rotation_matrix().transpose();
        let seen = seen(&from.0, &to.0);
        let between = from.0.rotation_matrix().tr_mul(&to.0.rotation_matrix());
        by_to.fixed_rows_mut::<R>(0).fill(0.0);
        by_to
            .fixed_view_mut::<R, R>(0, 0)
            .copy_from(&(turn * between));
        by_from.fixed_view_mut::<R, R>(0, 0).copy_from(&-turn);
        for axis in R..D {
            let about = SVector::<f64, D>::from_fn(|row, _| f64::from(row == axis));
            let turned = -(turn * M::hat(&about) * seen);
            by_from.fixed_view_mut::<R, 1>(0, axis).copy_from(&turned);
        }
        (r, by_from, by_to)
    }
}
