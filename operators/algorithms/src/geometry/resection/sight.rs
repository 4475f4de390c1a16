//! A ray of the rig with the point it should meet, and by how much it misses it.

use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Vector2, Vector3};

use super::Correspondence;
use super::minimal::Ray;
use crate::geometry::pose::Pose;

/// Nearer points (m) have no direction.
const MIN_RANGE_M: f64 = 1e-6;

/// A correspondence, in the vehicle's frame and ready for many poses.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    /// Its index in the caller's list.
    pub(super) index: usize,
    /// Higher is better.
    pub(super) quality: f64,
    /// The ray, and its point.
    pub(super) ray: Ray,
    /// Rows: two unit vectors across the ray and each other.
    across: Matrix2x3<f64>,
    /// Of the bearing, rad².
    variance: f64,
    /// Of the point, m².
    covariance: Matrix3<f64>,
    /// No direction of the point has a larger variance, m².
    spread: f64,
}

/// How a sight sees its point from a pose.
pub(super) struct Miss {
    /// Across the ray: sines of the angles by which the point lies beside it.
    pub(super) error: Vector2<f64>,
    /// Inverse covariance of the error.
    pub(super) information: Matrix2<f64>,
    /// The point in the vehicle frame, from the camera, metres.
    seen: Vector3<f64>,
    range: f64,
}

impl Miss {
    /// Squared distance in standard deviations; of two degrees of freedom.
    pub(super) fn squared(&self) -> f64 {
        self.error.dot(&(self.information * self.error))
    }
}

/// Two unit vectors across a ray.
pub(crate) fn across(ray: &Vector3<f64>) -> Matrix2x3<f64> {
    // The axis that is least along the ray keeps the cross product away from zero.
    let first = ray.cross(&Vector3::ith(ray.iamin(), 1.0)).normalize();
    let second = ray.cross(&first);
    Matrix2x3::from_rows(&[first.transpose(), second.transpose()])
}

impl Sight {
    /// None for a camera that the rig does not have, and for numbers that are none.
    pub(super) fn new(
        vehicle_from_camera: &[Pose],
        index: usize,
        given: &Correspondence,
    ) -> Option<Self> {
        let camera = vehicle_from_camera.get(given.camera)?;
        let direction = camera.rotate(&given.bearing).try_normalize(MIN_RANGE_M)?;
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        let covariance = given.point_covariance;
        let known = finite(direction.as_slice())
            && finite(given.point.as_slice())
            && finite(covariance.as_slice())
            && finite(&[given.sigma_rad, given.quality])
            && given.sigma_rad > 0.0
            && covariance.diagonal().min() >= 0.0;
        known.then(|| Self {
            index,
            quality: given.quality,
            ray: Ray {
                origin: camera.translation,
                direction,
                point: given.point,
            },
            across: across(&direction),
            variance: given.sigma_rad * given.sigma_rad,
            covariance,
            spread: covariance.trace(),
        })
    }

    /// From a pose `vehicle_from_world`, given as matrix and translation. None for a point behind the ray's half
    /// space, and for one that misses by more than `gate` standard deviations squared.
    pub(super) fn miss(&self, vehicle_from_world: &RigidMatrix, gate: f64) -> Option<Miss> {
        let seen = vehicle_from_world.rotation * self.ray.point + vehicle_from_world.translation
            - self.ray.origin;
        let range = seen.norm();
        if range < MIN_RANGE_M || seen.dot(&self.ray.direction) <= 0.0 {
            return None;
        }
        let error = self.across * (seen / range);
        let widest = self.variance + self.spread / (range * range);
        if error.norm_squared() > gate * widest {
            return None;
        }
        let turned = self.across * vehicle_from_world.rotation / range;
        let covariance =
            turned * self.covariance * turned.transpose() + Matrix2::identity() * self.variance;
        let information = covariance.try_inverse()?;
        let miss = Miss {
            error,
            information,
            seen,
            range,
        };
        (miss.squared() <= gate).then_some(miss)
    }

    /// How the error changes with the vehicle's pose in the world: with its translation along the world's axes, then
    /// its rotation about them.
    pub(super) fn slopes(
        &self,
        miss: &Miss,
        vehicle_from_world: &RigidMatrix,
        world_from_vehicle: &Pose,
    ) -> Matrix2x6<f64> {
        let towards = miss.seen / miss.range;
        let across = (Matrix3::identity() - towards * towards.transpose()) / miss.range;
        let turned = self.across * across * vehicle_from_world.rotation;
        let arm = self.ray.point - world_from_vehicle.translation;
        let mut slopes = Matrix2x6::zeros();
        slopes.fixed_view_mut::<2, 3>(0, 0).copy_from(&-turned);
        slopes
            .fixed_view_mut::<2, 3>(0, 3)
            .copy_from(&(turned * arm.cross_matrix()));
        slopes
    }
}

/// A pose as a matrix and a translation: quicker for many points.
pub(super) struct RigidMatrix {
    pub(super) rotation: Matrix3<f64>,
    pub(super) translation: Vector3<f64>,
}

impl From<&Pose> for RigidMatrix {
    fn from(pose: &Pose) -> Self {
        Self {
            rotation: pose.rotation.to_rotation_matrix().into_inner(),
            translation: pose.translation,
        }
    }
}
