//! Planar rigid motions.
//!
//! Moved as poses in space are: along their own axes, `(x, y) + R(yaw) (ξx, ξy)`, `yaw + ξyaw`.
//! This is the retraction of g2o and GTSAM for planar graphs, not the exponential, from which it
//! differs by a term of second order; its residual is then exactly "difference in position along
//! the axes, difference in yaw".

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Where a vehicle stands on a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarPose {
    /// Position of the right-hand frame's origin in the left-hand frame, metres.
    pub translation: Vector2<f64>,
    /// Counter-clockwise heading of the right-hand frame in the left-hand frame, radians in
    /// (-π, π].
    pub yaw: f64,
}

/// An angle turned by whole turns into (-π, π]; NaN stays NaN.
pub fn wrap(angle: f64) -> f64 {
    if angle > -PI && angle <= PI {
        return angle;
    }
    let wrapped = angle - TAU * (angle / TAU).round();
    if wrapped <= -PI {
        wrapped + TAU
    } else {
        wrapped
    }
}

impl PlanarPose {
    /// From metres and radians.
    pub fn new(x: f64, y: f64, yaw: f64) -> Self {
        Self {
            translation: Vector2::new(x, y),
            yaw: wrap(yaw),
        }
    }

    /// The motion that changes nothing.
    pub fn identity() -> Self {
        Self::new(0.0, 0.0, 0.0)
    }

    /// `R(yaw)`.
    pub fn rotation(&self) -> Matrix2<f64> {
        let (sin, cos) = self.yaw.sin_cos();
        Matrix2::new(cos, -sin, sin, cos)
    }

    /// `a_from_b.compose(&b_from_c)` is `a_from_c`.
    pub fn compose(&self, right: &Self) -> Self {
        Self {
            translation: self.translation + self.rotation() * right.translation,
            yaw: wrap(self.yaw + right.yaw),
        }
    }

    /// `a_from_b.inverse()` is `b_from_a`.
    pub fn inverse(&self) -> Self {
        Self {
            translation: -(self.rotation().tr_mul(&self.translation)),
            yaw: wrap(-self.yaw),
        }
    }

    /// Moved along its own axes by `(x, y, yaw)` (m, m, rad).
    pub fn plus(&self, xi: &Vector3<f64>) -> Self {
        self.compose(&Self::new(xi.x, xi.y, xi.z))
    }

    /// What [`PlanarPose::plus`] needs to move `from` to `self`.
    pub fn minus(&self, from: &Self) -> Vector3<f64> {
        let motion = from.inverse().compose(self);
        Vector3::new(motion.translation.x, motion.translation.y, motion.yaw)
    }
}

/// `Ad` with `T⁻¹ ∘ (small ξ) ∘ T ≈ Ad ξ` for the motion `T`: the twist `ξ` of the frame before a
/// motion, as the frame after it sees it.
pub fn inverse_adjoint(motion: &PlanarPose) -> Matrix3<f64> {
    let (sin, cos) = motion.yaw.sin_cos();
    let (x, y) = (motion.translation.x, motion.translation.y);
    Matrix3::new(
        cos,
        sin,
        sin * x - cos * y,
        -sin,
        cos,
        cos * x + sin * y,
        0.0,
        0.0,
        1.0,
    )
}
