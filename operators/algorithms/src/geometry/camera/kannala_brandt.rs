//! The equidistant fisheye of Kannala and Brandt, in OpenCV's `fisheye` form.
//!
//! Source: Kannala & Brandt 2006, eq. 6; OpenCV `calib3d` fisheye; ROS `equidistant`. With θ the
//! angle from the axis and φ the direction around it:
//!
//! ```text
//! θd = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)      u = fx θd cos φ + cx      v = fy θd sin φ + cy
//! ```
//!
//! θ comes from `atan2`, so rays at and behind 90° are fine: a lens of 190° is one model like any.

use super::radial::{invert, on_plane, rising_limit};
use nalgebra::{Matrix2x3, Vector3};
use std::f64::consts::PI;

/// An equidistant fisheye camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KannalaBrandt {
    focal: [f64; 2],
    centre: [f64; 2],
    k: [f64; 4],
    /// Largest θ (radians) before θd turns back; at most π.
    max_theta: f64,
}

impl KannalaBrandt {
    /// `[fx, fy]`, pixels.
    pub fn focal(&self) -> [f64; 2] {
        self.focal
    }

    /// `[cx, cy]`, pixels.
    pub fn centre(&self) -> [f64; 2] {
        self.centre
    }

    /// `[k1, k2, k3, k4]`.
    pub fn distortion(&self) -> [f64; 4] {
        self.k
    }

    /// `[fx, fy]` and `[cx, cy]` in pixels, `[k1, k2, k3, k4]`.
    pub fn new(focal: [f64; 2], centre: [f64; 2], k: [f64; 4]) -> Self {
        let max_theta = rising_limit(|theta| curve(&k, theta).1, PI);
        Self {
            focal,
            centre,
            k,
            max_theta,
        }
    }

    /// The largest angle from the axis (radians) that the lens curve can tell apart.
    pub fn max_theta(&self) -> f64 {
        self.max_theta
    }

    pub(super) fn project(&self, point: &Vector3<f64>) -> Option<[f64; 2]> {
        let across = (point.x * point.x + point.y * point.y).sqrt();
        let theta = across.atan2(point.z);
        if theta > self.max_theta {
            return None;
        }
        let scale = if across > 0.0 {
            curve(&self.k, theta).0 / across
        } else {
            0.0
        };
        Some([
            self.focal[0] * scale * point.x + self.centre[0],
            self.focal[1] * scale * point.y + self.centre[1],
        ])
    }

    pub(super) fn project_with_jacobian(
        &self,
        point: &Vector3<f64>,
    ) -> Option<([f64; 2], Matrix2x3<f64>)> {
        let across = (point.x * point.x + point.y * point.y).sqrt();
        let theta = across.atan2(point.z);
        if theta > self.max_theta {
            return None;
        }
        let (plane, mut jacobian) = on_plane(point, across, curve(&self.k, theta))?;
        let [fx, fy] = self.focal;
        jacobian.row_mut(0).scale_mut(fx);
        jacobian.row_mut(1).scale_mut(fy);
        let pixel = [fx * plane.x + self.centre[0], fy * plane.y + self.centre[1]];
        Some((pixel, jacobian))
    }

    pub(super) fn unproject(&self, pixel: [f64; 2]) -> Option<Vector3<f64>> {
        let x = (pixel[0] - self.centre[0]) / self.focal[0];
        let y = (pixel[1] - self.centre[1]) / self.focal[1];
        let radius = x.hypot(y);
        if radius == 0.0 {
            return Some(Vector3::z());
        }
        let theta = invert(|t| curve(&self.k, t), radius, (0.0, self.max_theta), radius)?;
        let across = theta.sin() / radius;
        Some(Vector3::new(x * across, y * across, theta.cos()))
    }
}

/// θd and dθd/dθ.
fn curve(k: &[f64; 4], theta: f64) -> (f64, f64) {
    let t2 = theta * theta;
    let value = 1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])));
    let slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])));
    (theta * value, slope)
}
