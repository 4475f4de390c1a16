//! The full panorama: columns are longitude, rows are latitude.
//!
//! ```text
//! u = cx + fx atan2(x, z)      v = cy + fy asin(y / |p|)
//! ```
//!
//! The centre column looks forward, columns grow to the right, rows downwards; fx and fy are in
//! pixels per radian. A panorama of width W that covers 360° has fx = W / 2π.

use nalgebra::{Matrix2x3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Angles this much (radians) past the seam or the pole are rounding, not another place.
const SLACK: f64 = 1e-9;

/// An equirectangular panorama.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Equirectangular {
    focal: [f64; 2],
    centre: [f64; 2],
}

impl Equirectangular {
    /// `[fx, fy]` in pixels per radian and `[cx, cy]` in pixels.
    pub fn new(focal: [f64; 2], centre: [f64; 2]) -> Self {
        Self { focal, centre }
    }

    /// `[fx, fy]` in pixels per radian.
    pub fn focal(&self) -> [f64; 2] {
        self.focal
    }

    /// `[cx, cy]` in pixels.
    pub fn centre(&self) -> [f64; 2] {
        self.centre
    }

    /// Whether the last column of an image of this width (px) is next to its first one, to half a pixel.
    pub fn wraps(&self, width: usize) -> bool {
        (TAU * self.focal[0] - width as f64).abs() < 0.5
    }

    /// Where a point or direction of the optical frame appears (px).
    pub fn pixel(&self, point: &Vector3<f64>) -> [f64; 2] {
        let latitude = point.y.atan2(point.x.hypot(point.z));
        let longitude = point.x.atan2(point.z);
        [
            self.centre[0] + self.focal[0] * longitude,
            self.centre[1] + self.focal[1] * latitude,
        ]
    }

    pub(super) fn project_with_jacobian(
        &self,
        point: &Vector3<f64>,
    ) -> Option<([f64; 2], Matrix2x3<f64>)> {
        let level2 = point.x * point.x + point.z * point.z;
        let level = level2.sqrt();
        if level <= f64::EPSILON * point.y.abs() {
            return None;
        }
        let pixel = self.pixel(point);
        let [fx, fy] = self.focal;
        let around = fx / level2;
        let up = fy / (level2 + point.y * point.y);
        let jacobian = Matrix2x3::new(
            around * point.z,
            0.0,
            -around * point.x,
            -up * point.y * point.x / level,
            up * level,
            -up * point.y * point.z / level,
        );
        Some((pixel, jacobian))
    }

    pub(super) fn unproject(&self, pixel: [f64; 2]) -> Option<Vector3<f64>> {
        let longitude = (pixel[0] - self.centre[0]) / self.focal[0];
        let latitude = (pixel[1] - self.centre[1]) / self.focal[1];
        if longitude.abs() > PI + SLACK || latitude.abs() > FRAC_PI_2 + SLACK {
            return None;
        }
        Some(Vector3::new(
            latitude.cos() * longitude.sin(),
            latitude.sin(),
            latitude.cos() * longitude.cos(),
        ))
    }
}
