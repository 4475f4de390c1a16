//! Residuals of measured motions, and their Jacobians.

use nalgebra::{SMatrix, SVector};

use crate::geometry::lie::se3;
use crate::geometry::pose::Pose;

/// Residual, and its Jacobians by moving `from` and by moving `to`.
pub type Linear<const D: usize> = (SVector<f64, D>, SMatrix<f64, D, D>, SMatrix<f64, D, D>);

/// A rigid motion with D degrees of freedom, moved along its own axes.
pub trait Motion<const D: usize>: Copy + Send + Sync {
    /// The motion that changes nothing.
    fn identity() -> Self;

    /// `a_from_b.then(&b_from_c)` is `a_from_c`.
    fn then(&self, right: &Self) -> Self;

    /// `a_from_b.inverted()` is `b_from_a`.
    fn inverted(&self) -> Self;

    /// Moved along its own axes.
    fn moved(&self, xi: &SVector<f64, D>) -> Self;

    /// What moves `from · measured` to `to`.
    fn residual(measured: &Self, from: &Self, to: &Self) -> SVector<f64, D>;

    /// The residual with its Jacobians.
    fn linearise(measured: &Self, from: &Self, to: &Self) -> Linear<D>;
}

impl Motion<6> for Pose {
    fn identity() -> Self {
        Pose::identity()
    }

    fn then(&self, right: &Self) -> Self {
        self.compose(right)
    }

    fn inverted(&self) -> Self {
        self.inverse()
    }

    fn moved(&self, xi: &SVector<f64, 6>) -> Self {
        se3::plus(self, xi)
    }

    fn residual(measured: &Self, from: &Self, to: &Self) -> SVector<f64, 6> {
        // Not `Pose::compose`: nothing accumulates here, so nothing needs normalising.
        let measured_to = from.rotation.inverse() * (to.translation - from.translation);
        let turn = measured.rotation.inverse();
        se3::log(&Pose::new(
            turn * (measured_to - measured.translation),
            turn * (from.rotation.inverse() * to.rotation),
        ))
    }

    /// With error `E = Z⁻¹ A⁻¹ B`, moving `B` by ξ gives `E Exp(ξ)`, so the Jacobian is `Jr⁻¹`;
    /// moving `A` gives `Exp(-Ad(Z⁻¹) ξ) E`, so it is `-Jl⁻¹ Ad(Z⁻¹)`.
    fn linearise(measured: &Self, from: &Self, to: &Self) -> Linear<6> {
        let r = Self::residual(measured, from, to);
        let by_to = se3::right_jacobian_inverse(&r);
        let by_from = -se3::left_jacobian_inverse(&r) * se3::adjoint(&measured.inverse());
        (r, by_from, by_to)
    }
}
