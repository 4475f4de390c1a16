//! Where in another view a ray's points can be.

use nalgebra::Vector3;

use crate::geometry::pose::Pose;

/// The directions, in camera b, of the points along a ray of camera a: an arc of a great circle from
/// the infinitely far point to the nearest one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arc {
    /// Direction of the point at infinity.
    far: Vector3<f64>,
    /// Unit vector at right angles to `far`, towards nearer points.
    towards: Vector3<f64>,
    /// Unit vector at right angles to both: the pole of the arc's circle.
    pole: Vector3<f64>,
    /// Angle from `far` to the nearest point.
    length_rad: f64,
}

impl Arc {
    pub(super) fn new(b_from_a: &Pose, ray: &Vector3<f64>, min_depth_m: f64) -> Self {
        let far = b_from_a.rotation * ray;
        let near = far * min_depth_m + b_from_a.translation;
        let across = b_from_a.translation - far * far.dot(&b_from_a.translation);
        let towards = across.try_normalize(1e-12).unwrap_or_else(Vector3::zeros);
        let length_rad = near.dot(&towards).atan2(near.dot(&far));
        Self {
            far,
            towards,
            pole: far.cross(&towards),
            length_rad: length_rad.clamp(0.0, std::f64::consts::PI),
        }
    }

    pub(super) fn length_rad(&self) -> f64 {
        self.length_rad
    }

    /// The direction at an angle from the point at infinity.
    pub(super) fn at(&self, angle_rad: f64) -> Vector3<f64> {
        self.far * angle_rad.cos() + self.towards * angle_rad.sin()
    }

    /// Whether a direction (a unit vector) is no farther from the nearest one of the arc than this angle.
    pub(super) fn is_within(&self, ray: &Vector3<f64>, angle_rad: f64) -> bool {
        // No direction is nearer to the arc than the sine of its angle to the whole circle: most are told without angles.
        ray.dot(&self.pole).abs() <= angle_rad && self.distance(ray) <= angle_rad
    }

    /// Angle between a direction (a unit vector) and the nearest one of the arc.
    pub(super) fn distance(&self, ray: &Vector3<f64>) -> f64 {
        let along = ray.dot(&self.towards).atan2(ray.dot(&self.far));
        let nearest = self.at(along.clamp(0.0, self.length_rad));
        // Exact for small angles, where an arc cosine is not.
        2.0 * (0.5 * (nearest - ray).norm()).min(1.0).asin()
    }
}
