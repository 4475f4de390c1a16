//! The pinhole with Brown–Conrady distortion, plain or rational.
//!
//! Source: OpenCV `calib3d`, "Detailed description", the same numbers as ROS `plumb_bob` and
//! `rational_polynomial`. With a = x/z, b = y/z, r² = a² + b²:
//!
//! ```text
//! s = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
//! a' = a s + 2 p1 a b + p2 (r² + 2 a²)      u = fx a' + cx
//! b' = b s + p1 (r² + 2 b²) + 2 p2 a b      v = fy b' + cy
//! ```

use super::radial::{invert, rising_limit};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

/// Rays flatter than this (radians from the axis) are beyond any pinhole: tan is 573.
const STEEPEST: f64 = 1.569;

/// Distortion coefficients in OpenCV's meaning; all zero is a perfect pinhole.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BrownConrady {
    /// k1 … k6; the last three are the rational denominator.
    pub radial: [f64; 6],
    /// p1, p2.
    pub tangential: [f64; 2],
}

/// A pinhole camera with Brown–Conrady distortion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    focal: [f64; 2],
    centre: [f64; 2],
    distortion: BrownConrady,
    /// Largest undistorted radius before the radial curve turns back (no unit, tan of the angle).
    max_radius: f64,
}

impl Pinhole {
    /// `[fx, fy]`, pixels.
    pub fn focal(&self) -> [f64; 2] {
        self.focal
    }

    /// `[cx, cy]`, pixels.
    pub fn centre(&self) -> [f64; 2] {
        self.centre
    }

    /// The distortion.
    pub fn distortion(&self) -> &BrownConrady {
        &self.distortion
    }

    /// `[fx, fy]` and `[cx, cy]` in pixels.
    pub fn new(focal: [f64; 2], centre: [f64; 2], distortion: BrownConrady) -> Self {
        let slope = |angle: f64| distortion.radial_curve(angle.tan()).1;
        let max_radius = rising_limit(slope, STEEPEST).tan();
        Self {
            focal,
            centre,
            distortion,
            max_radius,
        }
    }

    pub(super) fn project(&self, point: &Vector3<f64>) -> Option<[f64; 2]> {
        self.project_with_jacobian(point).map(|(pixel, _)| pixel)
    }

    pub(super) fn project_with_jacobian(
        &self,
        point: &Vector3<f64>,
    ) -> Option<([f64; 2], Matrix2x3<f64>)> {
        if point.z <= 0.0 {
            return None;
        }
        let (a, b) = (point.x / point.z, point.y / point.z);
        if a * a + b * b > self.max_radius * self.max_radius {
            return None;
        }
        let (bent, bend) = self.distortion.bend(Vector2::new(a, b));
        // Tangential terms can fold the plane before the radial curve does.
        if bend.determinant() <= 0.0 {
            return None;
        }
        let ([fx, fy], near) = (self.focal, 1.0 / point.z);
        let (uu, uv) = (fx * near * bend.m11, fx * near * bend.m12);
        let (vu, vv) = (fy * near * bend.m21, fy * near * bend.m22);
        let jacobian = Matrix2x3::new(uu, uv, -(a * uu + b * uv), vu, vv, -(a * vu + b * vv));
        let pixel = [fx * bent.x + self.centre[0], fy * bent.y + self.centre[1]];
        Some((pixel, jacobian))
    }

    pub(super) fn unproject(&self, pixel: [f64; 2]) -> Option<Vector3<f64>> {
        let bent = Vector2::new(
            (pixel[0] - self.centre[0]) / self.focal[0],
            (pixel[1] - self.centre[1]) / self.focal[1],
        );
        let plane = self.distortion.straighten(bent, self.max_radius)?;
        Some(Vector3::new(plane.x, plane.y, 1.0).normalize())
    }
}

impl BrownConrady {
    /// Distorted radius and its derivative, radial terms only. The slope is negative where the
    /// rational denominator has crossed zero.
    fn radial_curve(&self, r: f64) -> (f64, f64) {
        let (scale, change) = self.scale(r * r);
        (r * scale, scale + 2.0 * r * r * change)
    }

    /// s and ds/d(r²). Beyond a pole of the denominator both are -∞-like, which ends the range.
    fn scale(&self, r2: f64) -> (f64, f64) {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        if under <= 0.0 {
            return (f64::NEG_INFINITY, 0.0);
        }
        let over_change = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);
        let under_change = k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6);
        let scale = over / under;
        (scale, (over_change - scale * under_change) / under)
    }

    /// The distorted point and the Jacobian of the distortion.
    fn bend(&self, plane: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [p1, p2] = self.tangential;
        let (a, b) = (plane.x, plane.y);
        let r2 = a * a + b * b;
        let (s, ds) = self.scale(r2);
        let bent = Vector2::new(
            a * s + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a),
            b * s + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b,
        );
        let cross = 2.0 * a * b * ds + 2.0 * p1 * a + 2.0 * p2 * b;
        let jacobian = Matrix2::new(
            s + 2.0 * a * a * ds + 2.0 * p1 * b + 6.0 * p2 * a,
            cross,
            cross,
            s + 2.0 * b * b * ds + 6.0 * p1 * b + 2.0 * p2 * a,
        );
        (bent, jacobian)
    }

    /// Undoes [`Self::bend`]: the radial part by a bracketed root, then Newton in the plane.
    fn straighten(&self, bent: Vector2<f64>, max_radius: f64) -> Option<Vector2<f64>> {
        let radius = bent.norm();
        if radius < 1e-12 && self.tangential == [0.0; 2] {
            return Some(bent);
        }
        let edge = self.radial_curve(max_radius).0;
        let start = invert(
            |r| self.radial_curve(r),
            radius.min(edge),
            (0.0, max_radius),
            radius,
        )?;
        let mut plane = if radius > 0.0 {
            bent * (start / radius)
        } else {
            bent
        };
        for _ in 0..50 {
            let (found, jacobian) = self.bend(plane);
            let step = jacobian.try_inverse()? * (bent - found);
            plane += step;
            if step.norm() <= 1e-15 * (1.0 + plane.norm()) {
                break;
            }
        }
        let (found, jacobian) = self.bend(plane);
        let exact = (found - bent).norm() <= 1e-11 * (1.0 + radius);
        let valid = plane.norm() <= max_radius && jacobian.determinant() > 0.0;
        (exact && valid).then_some(plane)
    }
}
