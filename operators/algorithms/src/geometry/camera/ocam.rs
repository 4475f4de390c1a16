//! The omnidirectional polynomial model of Scaramuzza's OCamCalib toolbox.
//!
//! Source: Scaramuzza, Martinelli & Siegwart 2006, eq. 2–4, and the toolbox's C code.
//!
//! The toolbox writes a ray as `(x, y, f(ρ))` with f(0) < 0: its z axis points *into* the camera,
//! and θ = atan(z / √(x² + y²)) is the elevation over the image plane, -π/2 on the axis, 0 at 90°
//! from it. Here z points forward as everywhere else, so with α the angle from the axis
//! θ = α - π/2. The image side is an affine map, in (column, row) order:
//!
//! ```text
//! u = c ρ cos φ + d ρ sin φ + cx      v = e ρ cos φ + ρ sin φ + cy
//! ```
//!
//! φ is measured in the optical frame (x right, y down). The toolbox itself counts (row, column)
//! and its MATLAB side from 1; calibration files that store the map as a matrix
//! `[c d cx; e 1 cy]` with cx along the columns (SensorsCalibration's do) are already in our order.
//!
//! Either polynomial defines the lens; the toolbox's two agree to a fraction of a pixel only, so
//! one of them is taken as the truth and inverted numerically, and projecting what was unprojected
//! gives the pixel back exactly.

use super::radial::{invert, on_plane, polynomial, rising_limit};
use nalgebra::{Matrix2, Matrix2x3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// The affine map from the lens plane to pixels: `[c d; e 1]` and the centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OcamAffine {
    /// Column change per unit of x.
    pub c: f64,
    /// Column change per unit of y.
    pub d: f64,
    /// Row change per unit of x.
    pub e: f64,
    /// Column of the centre, pixels.
    pub cx: f64,
    /// Row of the centre, pixels.
    pub cy: f64,
}

/// Which of the toolbox's two polynomials defines the lens; coefficients in rising powers.
#[derive(Debug, Clone, PartialEq)]
pub enum OcamCurve {
    /// `invpol` / `pol` of `world2cam`: ρ (pixels) by θ (radians).
    RadiusByElevation(Vec<f64>),
    /// `ss` of `cam2world`: f(ρ) (pixels) by ρ (pixels), f(0) < 0.
    DepthByRadius(Vec<f64>),
}

/// An omnidirectional camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Ocam {
    affine: OcamAffine,
    curve: OcamCurve,
    /// End of the rising part: α in radians, or ρ in pixels for [`OcamCurve::DepthByRadius`].
    limit: f64,
}

impl Ocam {
    /// `corner_radius` (pixels): a bound on ρ inside the image, where a depth polynomial ends.
    pub fn new(affine: OcamAffine, curve: OcamCurve, corner_radius: f64) -> Self {
        let limit = match &curve {
            OcamCurve::RadiusByElevation(c) => {
                rising_limit(|alpha| polynomial(c, alpha - FRAC_PI_2).1, PI)
            }
            OcamCurve::DepthByRadius(c) => {
                rising_limit(|rho| angle_by_radius(c, rho).1, corner_radius)
            }
        };
        Self {
            affine,
            curve,
            limit,
        }
    }

    pub(super) fn project(&self, point: &Vector3<f64>) -> Option<[f64; 2]> {
        let across = point.x.hypot(point.y);
        let rho = self.radius(across.atan2(point.z))?;
        let scale = if across > 0.0 { rho / across } else { 0.0 };
        let (x, y) = (scale * point.x, scale * point.y);
        let OcamAffine { c, d, e, cx, cy } = self.affine;
        Some([c * x + d * y + cx, e * x + y + cy])
    }

    pub(super) fn project_with_jacobian(
        &self,
        point: &Vector3<f64>,
    ) -> Option<([f64; 2], Matrix2x3<f64>)> {
        let across = point.x.hypot(point.y);
        let alpha = across.atan2(point.z);
        let rho = self.radius(alpha)?;
        let slope = match &self.curve {
            // Clamped at the axis, the radius does not change.
            OcamCurve::RadiusByElevation(_) if rho <= 0.0 => 0.0,
            OcamCurve::RadiusByElevation(c) => polynomial(c, alpha - FRAC_PI_2).1,
            OcamCurve::DepthByRadius(c) => 1.0 / angle_by_radius(c, rho).1,
        };
        let (plane, jacobian) = on_plane(point, across, (rho, slope))?;
        let OcamAffine { c, d, e, cx, cy } = self.affine;
        let affine = Matrix2::new(c, d, e, 1.0);
        let pixel = affine * plane;
        Some(([pixel.x + cx, pixel.y + cy], affine * jacobian))
    }

    pub(super) fn unproject(&self, pixel: [f64; 2]) -> Option<Vector3<f64>> {
        let OcamAffine { c, d, e, cx, cy } = self.affine;
        let (du, dv) = (pixel[0] - cx, pixel[1] - cy);
        let determinant = c - d * e;
        let x = (du - d * dv) / determinant;
        let y = (c * dv - e * du) / determinant;
        let rho = x.hypot(y);
        if rho == 0.0 {
            return Some(Vector3::z());
        }
        let alpha = self.angle(rho)?;
        let across = alpha.sin() / rho;
        Some(Vector3::new(x * across, y * across, alpha.cos()))
    }

    /// ρ in pixels by the angle α from the axis in radians. A fitted polynomial misses zero on
    /// the axis by a hair; below zero it is clamped, so no ray lands on the opposite side.
    fn radius(&self, alpha: f64) -> Option<f64> {
        match &self.curve {
            OcamCurve::RadiusByElevation(c) => {
                (alpha <= self.limit).then(|| polynomial(c, alpha - FRAC_PI_2).0.max(0.0))
            }
            OcamCurve::DepthByRadius(c) => {
                let guess = alpha * c.first().map_or(1.0, |a0| a0.abs());
                invert(
                    |rho| angle_by_radius(c, rho),
                    alpha,
                    (0.0, self.limit),
                    guess,
                )
            }
        }
    }

    /// α in radians by ρ in pixels; pixels closer to the centre than the polynomial's value on
    /// the axis look along the axis.
    fn angle(&self, rho: f64) -> Option<f64> {
        match &self.curve {
            OcamCurve::RadiusByElevation(c) => {
                let by_alpha = |alpha: f64| polynomial(c, alpha - FRAC_PI_2);
                let guess = rho / by_alpha(FRAC_PI_2).0 * FRAC_PI_2;
                invert(by_alpha, rho.max(by_alpha(0.0).0), (0.0, self.limit), guess)
            }
            OcamCurve::DepthByRadius(c) => (rho <= self.limit).then(|| angle_by_radius(c, rho).0),
        }
    }
}

/// α(ρ) = atan2(ρ, -f(ρ)) and its slope, from the toolbox's depth polynomial.
fn angle_by_radius(coefficients: &[f64], rho: f64) -> (f64, f64) {
    let (depth, change) = polynomial(coefficients, rho);
    let squared = rho * rho + depth * depth;
    (rho.atan2(-depth), (rho * change - depth) / squared)
}
