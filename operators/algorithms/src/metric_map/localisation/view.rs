//! What the cameras should see from a guess.

use super::motion::Guess;
use super::{LandmarkMap, LocalisationParams, MapLandmark};
use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::geometry::rig::Rig;
use crate::metric_map::visibility::{Reaches, Visibility};
use nalgebra::{Matrix2, Matrix2x6, Vector2, Vector3};
use rayon::prelude::*;

/// Of the depth's standard deviation this much is always taken to lie across the line of sight: landmarks are less
/// certain across too, by about the tangent of their parallax.
const ACROSS_SHARE: f64 = 0.2;
/// What lies within a cell of this angle, seen from the vehicle, errs together: a corner found at two scales or by two
/// cameras, a landmark triangulated twice, one leaf of a poster. Radians; a dozen pixels of a 127 px/rad fisheye.
const SHARED_RAD: f64 = 0.1;

/// A landmark where a camera should see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sighted {
    pub(super) landmark: usize,
    pub(super) camera: usize,
    pub(super) pixel: Vector2<f64>,
    /// Covariance of the pixel by feature, landmark and guess, px².
    pub(super) covariance: Matrix2<f64>,
}

/// A projection and how it changes.
pub(super) struct Projection {
    pub(super) pixel: Vector2<f64>,
    /// Pixels per change of the pose: translation along, then rotation about the map's axes.
    pub(super) by_pose: Matrix2x6<f64>,
    /// Pixels per metre across the line of sight, in the mean of directions.
    pub(super) px_per_m: f64,
}

/// A camera at a pose.
pub(super) struct Eye<'a> {
    camera: &'a Camera,
    camera_from_map: Pose,
    vehicle: Vector3<f64>,
    pub(super) centre: Vector3<f64>,
}

/// The cell of directions, by azimuth and elevation, that a ray in the vehicle's frame lies in.
pub(super) fn direction(ray: &Vector3<f64>) -> [i64; 2] {
    let up = ray.z.atan2(ray.x.hypot(ray.y));
    [ray.y.atan2(ray.x), up].map(|angle| (angle / SHARED_RAD).floor() as i64)
}

/// The cameras of a rig at a pose, in the rig's order.
pub(super) fn eyes<'a>(rig: &'a Rig, map_from_vehicle: &Pose) -> Vec<Eye<'a>> {
    let eyes = rig.cameras.iter().map(|mounted| {
        let map_from_camera = map_from_vehicle.compose(&mounted.vehicle_from_camera);
        Eye {
            camera: &mounted.camera,
            camera_from_map: map_from_camera.inverse(),
            vehicle: map_from_vehicle.translation,
            centre: map_from_camera.translation,
        }
    });
    eyes.collect()
}

impl Eye<'_> {
    /// The pixel of a point, in or out of the image; `None` where the lens does not see it.
    pub(super) fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let pixel = self
            .camera
            .project(&self.camera_from_map.transform(point))?;
        Some(pixel.into())
    }

    /// The pixel of a point, in or out of the image, with its derivatives; `None` where the lens does not see it.
    pub(super) fn projection(&self, point: &Vector3<f64>) -> Option<Projection> {
        let seen = self.camera_from_map.transform(point);
        let (pixel, by_point) = self.camera.project_with_jacobian(&seen)?;
        let by_map = by_point * self.camera_from_map.rotation.to_rotation_matrix().matrix();
        let mut by_pose = Matrix2x6::zeros();
        by_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&-by_map);
        let arm = (point - self.vehicle).cross_matrix();
        by_pose
            .fixed_view_mut::<2, 3>(0, 3)
            .copy_from(&(by_map * arm));
        Some(Projection {
            pixel: pixel.into(),
            by_pose,
            px_per_m: by_map.norm() * std::f64::consts::FRAC_1_SQRT_2,
        })
    }

    /// Variance in each axis of a landmark's pixel, given the pose: a landmark is uncertain mostly along the
    /// direction it was seen from, which another direction turns into the image.
    pub(super) fn noise_px2(&self, landmark: &MapLandmark, px_per_m: f64, feature_px: f64) -> f64 {
        let away = self.centre - landmark.position;
        let cos = away.dot(&landmark.view) / away.norm().max(1e-9);
        let across = (1.0 - cos * cos).max(ACROSS_SHARE * ACROSS_SHARE);
        let landmark_px = px_per_m * landmark.sigma_m;
        feature_px * feature_px + across * landmark_px * landmark_px
    }
}

/// Which landmarks of a map cameras should see.
#[derive(Debug, Clone)]
pub(super) struct InView {
    /// By landmark.
    visibilities: Vec<Visibility>,
    reaches: Reaches,
}

impl InView {
    /// Landmarks that are not sound are in no view.
    pub(super) fn new(rig: &Rig, map: &LandmarkMap, params: &LocalisationParams) -> Self {
        let landmarks = map.landmarks();
        let visibilities = landmarks.iter().map(|known| known.visibility(params));
        let visibilities: Vec<Visibility> = visibilities.collect();
        let sound = (0_u32..).zip(landmarks).zip(&visibilities);
        let sound = sound.filter(|((_, known), _)| known.is_sound());
        let sound = sound.map(|((number, _), visibility)| (number, visibility));
        Self {
            reaches: Reaches::new(sound, &rig.cameras),
            visibilities,
        }
    }

    /// As [`super::Localiser::sighted`], of features whose smallest ones lie to `sigma_px`.
    pub(super) fn sighted(
        &self,
        rig: &Rig,
        map: &LandmarkMap,
        guess: &Guess,
        sigma_px: f64,
    ) -> Vec<Sighted> {
        let around = self.reaches.around(&guess.pose.translation);
        let by_camera: Vec<Vec<Sighted>> = eyes(rig, &guess.pose)
            .par_iter()
            .enumerate()
            .map(|(camera, eye)| {
                let around = around.iter().map(|landmark| *landmark as usize);
                let visible =
                    around.filter(|landmark| self.visibilities[*landmark].from(&eye.centre));
                let seen = visible.filter_map(|landmark| {
                    let known = &map.landmarks()[landmark];
                    let Projection {
                        pixel,
                        by_pose,
                        px_per_m,
                    } = eye.projection(&known.position)?;
                    let noise_px2 = eye.noise_px2(known, px_per_m, sigma_px);
                    eye.camera.contains(pixel.into()).then(|| Sighted {
                        landmark,
                        camera,
                        pixel,
                        covariance: by_pose * guess.covariance * by_pose.transpose()
                            + Matrix2::identity() * noise_px2,
                    })
                });
                seen.collect()
            })
            .collect();
        by_camera.into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::super::motion::moved;
    use super::super::tests::world;
    use super::*;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_derivative_by_the_pose_is_the_numeric_one(
            point in prop::array::uniform3(-8.0..8.0f64),
            pose in prop::array::uniform6(-1.0..1.0f64),
        ) {
            let rig = world::rig();
            let pose = moved(&Pose::identity(), &Vector6::from(pose));
            let point = Vector3::from(point);
            for camera in 0..rig.cameras.len() {
                let here = &eyes(&rig, &pose)[camera];
                prop_assume!((point - here.centre).norm() > 0.3);
                let Some(projection) = here.projection(&point) else { continue };
                for axis in 0..6 {
                    let mut by = Vector6::zeros();
                    by[axis] = 1e-5;
                    let at = |by: &Vector6<f64>| Some(eyes(&rig, &moved(&pose, by))[camera].projection(&point)?.pixel);
                    let (Some(ahead), Some(behind)) = (at(&by), at(&-by)) else { continue };
                    let numeric = (ahead - behind) / 2e-5;
                    let analytic = projection.by_pose.column(axis);
                    prop_assert!((numeric - analytic).norm() < 1e-2 * (1.0 + analytic.norm()), "{numeric} {analytic}");
                }
            }
        }
    }
}
