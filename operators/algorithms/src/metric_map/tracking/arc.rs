//! Where in another view a ray's points can be.

use std::f64::consts::PI;

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
    /// Direction of the nearest point.
    near: Vector3<f64>,
    /// Angle from `far` to `near`.
    length_rad: f64,
}

impl Arc {
    pub(super) fn new(b_from_a: &Pose, ray: &Vector3<f64>, min_depth_m: f64) -> Self {
        let far = b_from_a.rotation * ray;
        let near = far * min_depth_m + b_from_a.translation;
        let across = b_from_a.translation - far * far.dot(&b_from_a.translation);
        let towards = across.try_normalize(1e-12).unwrap_or_else(Vector3::zeros);
        let length_rad = near.dot(&towards).atan2(near.dot(&far)).clamp(0.0, PI);
        Self {
            far,
            towards,
            pole: far.cross(&towards),
            near: far * length_rad.cos() + towards * length_rad.sin(),
            length_rad,
        }
    }

    pub(super) fn length_rad(&self) -> f64 {
        self.length_rad
    }

    /// The direction at an angle from the point at infinity.
    pub(super) fn at(&self, angle_rad: f64) -> Vector3<f64> {
        self.far * angle_rad.cos() + self.towards * angle_rad.sin()
    }

    /// Whether a direction (a unit vector) is no farther from the nearest one of the arc than this angle, which is below a
    /// right one.
    pub(super) fn is_within(&self, ray: &Vector3<f64>, angle_rad: f64) -> bool {
        // Beside the arc it is as far as from the whole circle, elsewhere as from an end: told without its own angles.
        let off_circle = ray.dot(&self.pole).abs();
        if off_circle > angle_rad {
            return false;
        }
        let half = (0.5 * angle_rad).sin();
        let along = ray.dot(&self.towards);
        let before_near = ray.dot(&self.far) * self.near.dot(&self.towards);
        let end = match along > 0.0 {
            true if before_near >= along * self.near.dot(&self.far) => {
                return off_circle <= 2.0 * half * (1.0 - half * half).sqrt();
            }
            true => &self.near,
            false => &self.far,
        };
        (ray - end).norm_squared() <= 4.0 * half * half
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    /// Angle between a direction (a unit vector) and the nearest one of an arc.
    fn distance(arc: &Arc, ray: &Vector3<f64>) -> f64 {
        let along = ray.dot(&arc.towards).atan2(ray.dot(&arc.far));
        let nearest = arc.at(along.clamp(0.0, arc.length_rad));
        // Exact for small angles, where an arc cosine is not.
        2.0 * (0.5 * (nearest - ray).norm()).min(1.0).asin()
    }

    proptest! {
        /// Every point on a ray, from the nearest allowed on, lies on the ray's arc.
        #[test]
        fn points_on_the_ray_are_on_the_arc(
            t in prop::array::uniform3(-0.5..0.5_f64), turn in prop::array::uniform3(-0.3..0.3_f64),
            ray in prop::array::uniform3(-1.0..1.0_f64), depth in 0.4..1e4_f64, off in 0.001..0.01_f64
        ) {
            prop_assume!(Vector3::from(ray).norm() > 0.1);
            let ray = Vector3::from(ray).normalize();
            let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
            let pose = Pose::new(Vector3::from(t), turn);
            prop_assume!(pose.transform(&(ray * depth)).norm() > 0.05);
            let arc = Arc::new(&pose, &ray, 0.4);
            let seen = pose.transform(&(ray * depth)).normalize();
            prop_assert!(distance(&arc, &seen) < 1e-6, "{}", distance(&arc, &seen));
            let normal = pose.translation.cross(&(pose.rotation * ray));
            prop_assume!(normal.norm() > 1e-3);
            let beside = (seen + normal.normalize() * off).normalize();
            prop_assert!((distance(&arc, &beside) - off.atan()).abs() < 1e-6);
        }

        #[test]
        fn what_is_within_an_angle_is_as_near(
            t in prop::array::uniform3(-0.5..0.5_f64), turn in prop::array::uniform3(-0.3..0.3_f64),
            rays in prop::array::uniform2(prop::array::uniform3(-1.0..1.0_f64)), angle in 0.0..1.5_f64
        ) {
            prop_assume!(rays.iter().all(|ray| Vector3::from(*ray).norm() > 0.1));
            let [ray, other] = rays.map(|ray| Vector3::from(ray).normalize());
            let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
            for scale in [0.0, 1e-13, 1.0] {
                let arc = Arc::new(&Pose::new(Vector3::from(t) * scale, turn), &ray, 0.4);
                prop_assert_eq!(arc.is_within(&other, angle), distance(&arc, &other) <= angle);
            }
        }
    }
}
