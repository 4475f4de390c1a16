//! Cameras: which ray a pixel sees, and which pixel a ray meets.
//!
//! One type for all lenses, so that everything above (ground projection, landmarks, relocation)
//! is written once. Directions are given in the optical frame: z forward, x right, y down. Pixel
//! (0, 0) is the *centre* of the top-left pixel, so the image spans [-0.5, width - 0.5).
//!
//! [`Camera::project`] refuses what the lens model cannot tell apart: rays behind a pinhole, and
//! rays past the point where a fitted distortion curve turns back on itself. It does not look at
//! the image's borders; [`Camera::contains`] does.

mod brown;
mod calibration;
mod equirectangular;
mod kannala_brandt;
mod ocam;
pub(super) mod radial;
mod spread;
#[cfg(test)]
pub(crate) mod tests;

pub use brown::{BrownConrady, Pinhole};
pub use calibration::{CameraError, MODEL_NAMES};
pub use equirectangular::Equirectangular;
pub use kannala_brandt::KannalaBrandt;
pub use ocam::{Ocam, OcamAffine, OcamCurve};

use nalgebra::{Matrix2x3, Vector3};
use std::f64::consts::{PI, TAU};

/// A calibrated camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// The lens.
    pub model: Model,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Rays farther than this from the axis (radians) are not seen; π where only the lens model
    /// limits the view. Set it to the edge of the image circle where that is known.
    pub max_angle_rad: f64,
}

/// The lens models.
#[derive(Debug, Clone, PartialEq)]
pub enum Model {
    /// Pinhole with Brown–Conrady distortion.
    Pinhole(Pinhole),
    /// Equidistant fisheye.
    KannalaBrandt(KannalaBrandt),
    /// Panorama.
    Equirectangular(Equirectangular),
    /// Omnidirectional polynomial.
    Ocam(Ocam),
}

impl Camera {
    /// A camera whose view is limited by its lens model alone.
    pub fn new(model: Model, width: u32, height: u32) -> Self {
        Self {
            model,
            width,
            height,
            max_angle_rad: PI,
        }
    }

    /// The same camera, blind beyond `max_angle_rad` from its axis.
    #[must_use]
    pub fn with_max_angle(mut self, max_angle_rad: f64) -> Self {
        self.max_angle_rad = max_angle_rad;
        self
    }

    /// The pixel `[u, v]` where a point or direction of the optical frame appears. `None` for
    /// rays the lens cannot see, and for a vector of no length or with a NaN.
    pub fn project(&self, point: &Vector3<f64>) -> Option<[f64; 2]> {
        let length = point.norm();
        if !(length > 0.0 && length.is_finite() && self.sees_angle(point)) {
            return None;
        }
        match &self.model {
            Model::Pinhole(lens) => lens.project(point),
            Model::KannalaBrandt(lens) => lens.project(point),
            Model::Equirectangular(lens) => Some(lens.pixel(point)),
            Model::Ocam(lens) => lens.project(point),
        }
    }

    /// [`Camera::project`] and how the pixel changes with the point: pixels per unit of the
    /// point. `None` where there is no pixel, and on the few rays where the lens model has no
    /// derivative (straight back, or straight up in a panorama).
    pub fn project_with_jacobian(
        &self,
        point: &Vector3<f64>,
    ) -> Option<([f64; 2], Matrix2x3<f64>)> {
        let squared = point.norm_squared();
        if !(squared > 0.0 && squared.is_finite() && self.sees_angle(point)) {
            return None;
        }
        match &self.model {
            Model::Pinhole(lens) => lens.project_with_jacobian(point),
            Model::KannalaBrandt(lens) => lens.project_with_jacobian(point),
            Model::Equirectangular(lens) => lens.project_with_jacobian(point),
            Model::Ocam(lens) => lens.project_with_jacobian(point),
        }
    }

    /// The unit vector, in the optical frame, that pixel `[u, v]` looks along. `None` where no
    /// ray meets that pixel.
    pub fn unproject(&self, pixel: [f64; 2]) -> Option<Vector3<f64>> {
        if !(pixel[0].is_finite() && pixel[1].is_finite()) {
            return None;
        }
        let ray = match &self.model {
            Model::Pinhole(lens) => lens.unproject(pixel),
            Model::KannalaBrandt(lens) => lens.unproject(pixel),
            Model::Equirectangular(lens) => lens.unproject(pixel),
            Model::Ocam(lens) => lens.unproject(pixel),
        }?;
        self.sees_angle(&ray).then_some(ray)
    }

    /// Whether `[u, v]` falls on a pixel of the image.
    pub fn contains(&self, [u, v]: [f64; 2]) -> bool {
        let inside = |x: f64, size: u32| x >= -0.5 && x < f64::from(size) - 0.5;
        inside(u, self.width) && inside(v, self.height)
    }

    /// Pixels per radian at the middle of the image, from the rays a pixel left and right, and above and below, of it;
    /// where the lens sees nothing there, those of half a circle over the image's width.
    pub fn px_per_rad(&self) -> f64 {
        let [u, v] = [self.width, self.height].map(|size| f64::from(size) / 2.0 - 0.5);
        let across = |du: f64, dv: f64| {
            let before = self.unproject([u - du, v - dv])?;
            let after = self.unproject([u + du, v + dv])?;
            let angle = before.angle(&after);
            (angle > 0.0).then(|| 2.0 / angle)
        };
        match (across(1.0, 0.0), across(0.0, 1.0)) {
            (Some(a), Some(b)) => (a + b) / 2.0,
            (one, other) => one
                .or(other)
                .unwrap_or_else(|| f64::from(self.width.max(1)) / PI),
        }
    }

    /// Whether the last column is next to the first, as in a panorama that goes all around.
    pub fn wraps(&self) -> bool {
        match &self.model {
            Model::Equirectangular(lens) => lens.wraps(self.width as usize),
            Model::Pinhole(_) | Model::KannalaBrandt(_) | Model::Ocam(_) => false,
        }
    }

    /// The angle from the left edge of the image to the right one along its middle row (rad), a full turn at most. `None`
    /// where the lens sees nothing at an edge.
    pub fn horizontal_field_of_view_rad(&self) -> Option<f64> {
        let width = f64::from(self.width);
        if let Model::Equirectangular(lens) = &self.model {
            return Some((width / lens.focal()[0]).min(TAU));
        }
        let row = f64::from(self.height) / 2.0 - 0.5;
        let ray = |column: f64| self.unproject([column - 0.5, row]);
        let (left, middle, right) = (ray(0.0)?, ray(width / 2.0)?, ray(width)?);
        Some(left.angle(&middle) + middle.angle(&right))
    }

    fn sees_angle(&self, ray: &Vector3<f64>) -> bool {
        self.max_angle_rad >= PI || ray.z >= ray.norm() * self.max_angle_rad.cos()
    }
}
