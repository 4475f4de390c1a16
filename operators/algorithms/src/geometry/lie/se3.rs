//! Rigid motions: the convention of this module's parent, and its Jacobians.
//!
//! A tangent vector is `(ρ, φ)`: translation (m), then rotation (rad).

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::coefficients::{angle_minus_sin, fifth, fourth};
use super::so3::{self, hat};
use crate::geometry::pose::Pose;

/// `(ρ, φ)`: translation (m), then rotation (rad).
pub type Tangent = Vector6<f64>;

/// The two halves of a tangent vector.
pub fn split(xi: &Tangent) -> (Vector3<f64>, Vector3<f64>) {
    (
        Vector3::new(xi[0], xi[1], xi[2]),
        Vector3::new(xi[3], xi[4], xi[5]),
    )
}

/// One tangent vector of two halves.
pub fn join(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Tangent {
    Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
}

/// The rigid motion that a constant twist `ξ` makes in one unit of time.
pub fn exp(xi: &Tangent) -> Pose {
    let (rho, phi) = split(xi);
    Pose::new(so3::left_jacobian(&phi) * rho, so3::exp(&phi))
}

/// The twist of a rigid motion, with `|φ| ≤ π`.
pub fn log(motion: &Pose) -> Tangent {
    let phi = so3::log(&motion.rotation);
    join(
        &(so3::left_jacobian_inverse(&phi) * motion.translation),
        &phi,
    )
}

/// `pose ⊞ ξ = pose · Exp(ξ)`: moved along its own axes.
pub fn plus(pose: &Pose, xi: &Tangent) -> Pose {
    pose.compose(&exp(xi))
}

/// `to ⊟ from = Log(from⁻¹ · to)`: what moves `from` to `to`.
pub fn minus(to: &Pose, from: &Pose) -> Tangent {
    log(&from.inverse().compose(to))
}

/// `Ad` with `T · Exp(ξ) = Exp(Ad ξ) · T`.
pub fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let r = pose.rotation.to_rotation_matrix().into_inner();
    blocks(&r, &(hat(&pose.translation) * r), &r)
}

/// `J` with `Exp(ξ + δ) ≈ Exp(J δ) Exp(ξ)`.
pub fn left_jacobian(xi: &Tangent) -> Matrix6<f64> {
    let (rho, phi) = split(xi);
    let j = so3::left_jacobian(&phi);
    blocks(&j, &coupling(&rho, &phi), &j)
}

/// Inverse of [`left_jacobian`]: `Log(Exp(δ) Exp(ξ)) ≈ ξ + J⁻¹ δ`.
pub fn left_jacobian_inverse(xi: &Tangent) -> Matrix6<f64> {
    let (rho, phi) = split(xi);
    let j = so3::left_jacobian_inverse(&phi);
    blocks(&j, &(-(j * coupling(&rho, &phi) * j)), &j)
}

/// `J⁻¹` with `Log(Exp(ξ) Exp(δ)) ≈ ξ + J⁻¹ δ`.
pub fn right_jacobian_inverse(xi: &Tangent) -> Matrix6<f64> {
    left_jacobian_inverse(&-xi)
}

/// A covariance of `a_from_b` along the axes of `a` (of the position as seen in `a`, m², then of a
/// rotation about the axes of `a`, rad²) turned to the axes of `b`, as the convention has it.
pub fn covariance_along_right(pose: &Pose, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let r = pose.rotation.to_rotation_matrix().into_inner();
    let turn = blocks(&r, &Matrix3::zeros(), &r);
    turn.transpose() * covariance * turn
}

/// `[[a, b], [0, d]]`.
fn blocks(a: &Matrix3<f64>, b: &Matrix3<f64>, d: &Matrix3<f64>) -> Matrix6<f64> {
    let mut all = Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).copy_from(a);
    all.fixed_view_mut::<3, 3>(0, 3).copy_from(b);
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(d);
    all
}

/// How rotation moves the translation part of the left Jacobian: `Q` of Barfoot, equation 7.86.
fn coupling(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Matrix3<f64> {
    let theta2 = phi.norm_squared();
    let (r, p) = (hat(rho), hat(phi));
    let (pr, rp) = (p * r, r * p);
    let prp = pr * p;
    r * 0.5
        + (pr + rp + prp) * angle_minus_sin(theta2)
        + (p * pr + rp * p - prp * 3.0) * fourth(theta2)
        + (prp * p + p * prp) * fifth(theta2)
}
