//! Pose graphs on the plane, which half of the field's benchmarks are.
//!
//! Planar poses are moved as poses in space are, `pose · Exp(ξ)` with `ξ = (ρ, φ)` along the pose's own axes: the same
//! numbers as for the pose lifted into space, with half the unknowns.

use std::f64::consts::{PI, TAU};

use evermap_algorithms::geometry::lie::coefficients::{angle_minus_sin, one_minus_cos};
use evermap_algorithms::metric_map::pose_graph::Graph;
use evermap_algorithms::metric_map::pose_graph::chordal::Chordal;
use evermap_algorithms::metric_map::pose_graph::motion::{Linear, Motion};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

#[cfg(test)]
mod tests;

/// Where a vehicle stands on a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarPose {
    /// Position of the right-hand frame's origin in the left-hand frame, metres.
    pub translation: Vector2<f64>,
    /// Counter-clockwise heading of the right-hand frame in the left-hand frame, radians in
    /// (-π, π].
    pub yaw: f64,
}

/// A pose graph on the plane.
pub type PlanarGraph = Graph<PlanarPose, 3>;

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

    /// `self ⊞ ξ = self · Exp(ξ)`: moved along its own axes.
    pub fn plus(&self, xi: &Vector3<f64>) -> Self {
        self.compose(&exp(xi))
    }

    /// `self ⊟ from = Log(from⁻¹ · self)`: what moves `from` to `self`.
    pub fn minus(&self, from: &Self) -> Vector3<f64> {
        log(&from.inverse().compose(self))
    }
}

/// `sin θ / θ` and `(1 - cos θ) / θ`.
fn arc(theta: f64) -> (f64, f64) {
    let theta2 = theta * theta;
    (
        1.0 - theta2 * angle_minus_sin(theta2),
        theta * one_minus_cos(theta2),
    )
}

/// The motion that a constant twist `(ρ, φ)` makes in one unit of time: along an arc.
pub fn exp(xi: &Vector3<f64>) -> PlanarPose {
    let (a, b) = arc(xi.z);
    PlanarPose::new(a * xi.x - b * xi.y, b * xi.x + a * xi.y, xi.z)
}

/// The twist of a motion, with `|φ| ≤ π`.
pub fn log(motion: &PlanarPose) -> Vector3<f64> {
    let (a, b) = arc(motion.yaw);
    let (x, y) = (motion.translation.x, motion.translation.y);
    let norm = 1.0 / (a * a + b * b);
    Vector3::new((a * x + b * y) * norm, (a * y - b * x) * norm, motion.yaw)
}

/// `J⁻¹` with `Log(Exp(ξ) Exp(δ)) ≈ ξ + J⁻¹ δ`. Source: Solà et al., equation 163.
pub fn right_jacobian_inverse(xi: &Vector3<f64>) -> Matrix3<f64> {
    let theta2 = xi.z * xi.z;
    let (a, b) = arc(xi.z);
    let (c, d) = (xi.z * angle_minus_sin(theta2), one_minus_cos(theta2));
    // J = [[a, b, p], [-b, a, q], [0, 0, 1]].
    let (p, q) = (xi.x * c - xi.y * d, xi.x * d + xi.y * c);
    let norm = 1.0 / (a * a + b * b);
    let (a, b) = (a * norm, b * norm);
    Matrix3::new(a, -b, b * q - a * p, b, a, -b * p - a * q, 0.0, 0.0, 1.0)
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

impl Motion<3> for PlanarPose {
    fn identity() -> Self {
        PlanarPose::identity()
    }

    fn then(&self, right: &Self) -> Self {
        self.compose(right)
    }

    fn inverted(&self) -> Self {
        self.inverse()
    }

    fn moved(&self, xi: &Vector3<f64>) -> Self {
        self.plus(xi)
    }

    fn residual(measured: &Self, from: &Self, to: &Self) -> Vector3<f64> {
        from.inverse().compose(to).minus(measured)
    }

    fn linearise(measured: &Self, from: &Self, to: &Self) -> Linear<3> {
        let motion = from.inverse().compose(to);
        let r = motion.minus(measured);
        let by_to = right_jacobian_inverse(&r);
        let by_from = -by_to * inverse_adjoint(&motion);
        (r, by_from, by_to)
    }
}

impl Chordal<3, 2, 3> for PlanarPose {
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

    fn hat(twist: &Vector3<f64>) -> Matrix2<f64> {
        Matrix2::new(0.0, -twist.z, twist.z, 0.0)
    }
}
