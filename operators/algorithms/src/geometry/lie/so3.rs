//! Rotations: exponential, logarithm and the Jacobians between them.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::coefficients::{angle_minus_sin, inverse_square, one_minus_cos};

/// `[v]×`: the matrix that takes `w` to `v × w`.
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// The rotation by `|φ|` radians about φ.
pub fn exp(phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    let half2 = 0.25 * phi.norm_squared();
    // sin(θ/2)/θ; the series only where the quotient is 0/0.
    let (w, scale) = if half2 < 1e-8 {
        (1.0 - 0.5 * half2, 0.5 * (1.0 - half2 / 6.0))
    } else {
        let half = half2.sqrt();
        let (sin, cos) = half.sin_cos();
        (cos, 0.5 * sin / half)
    };
    let v = phi * scale;
    UnitQuaternion::new_normalize(Quaternion::new(w, v.x, v.y, v.z))
}

/// The shortest rotation vector of a rotation (rad), `|φ| ≤ π`. At half a turn, where two are
/// equally short, one of them.
pub fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = rotation.quaternion();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let (w, v) = (sign * q.w, q.imag() * sign);
    let n2 = v.norm_squared();
    if n2 < 1e-12 {
        // atan(n/w) = n/w - (n/w)³/3, and w is nearly 1.
        return v * (2.0 / w * (1.0 - n2 / (3.0 * w * w)));
    }
    let n = n2.sqrt();
    v * (2.0 * n.atan2(w) / n)
}

/// `J` with `Exp(φ + δ) ≈ Exp(J δ) Exp(φ)`.
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let theta2 = phi.norm_squared();
    combine(phi, one_minus_cos(theta2), angle_minus_sin(theta2))
}

/// Inverse of [`left_jacobian`]: `Log(Exp(δ) Exp(φ)) ≈ φ + J⁻¹ δ`. Singular only at a full turn.
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    combine(phi, -0.5, inverse_square(phi.norm_squared()))
}

/// `J⁻¹` with `Log(Exp(φ) Exp(δ)) ≈ φ + J⁻¹ δ`.
pub fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian_inverse(&-phi)
}

/// `I + a [φ]× + b [φ]×²`, with `[φ]×² = φφᵀ - |φ|² I`.
fn combine(phi: &Vector3<f64>, a: f64, b: f64) -> Matrix3<f64> {
    let mut sum = phi * phi.transpose() * b;
    let diagonal = 1.0 - b * phi.norm_squared();
    sum[(0, 0)] += diagonal;
    sum[(1, 1)] += diagonal;
    sum[(2, 2)] += diagonal;
    sum + hat(phi) * a
}
