//! A point from the rays that it was seen along.

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

use crate::geometry::pose::Pose;

/// Steps of the refinement; it converges quadratically, so few are needed.
const STEPS: usize = 8;
/// Residuals beyond this many times their sigma count less (Cauchy).
const ROBUST_SIGMAS: f64 = 2.0;

/// A sighting: where the camera was, along which ray it saw the point, and how exactly.
#[derive(Debug, Clone, Copy)]
pub struct Sight<'a> {
    /// The camera that saw it.
    pub map_from_camera: &'a Pose,
    /// Unit vector in the optical frame.
    pub ray: Vector3<f64>,
    /// Standard deviation of the ray, radians.
    pub sigma_rad: f64,
    /// Pixels per radian at the middle of the image.
    pub px_per_rad: f64,
}

impl Sight<'_> {
    /// How far off the ray a point of the map is, as two angles (radians); `None` for a point at the camera or behind.
    pub fn residual_rad(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let in_camera = self.map_from_camera.inverse().transform(point);
        ray_residual_rad(&self.ray, &in_camera)
    }

    /// How inexactly the point is seen, in units of the smallest features' standard deviation.
    pub fn blur(&self) -> f64 {
        self.sigma_rad * self.px_per_rad
    }

    /// The same as one distance, pixels at the middle of the image; infinite where there are no angles.
    pub fn off_px(&self, point: &Vector3<f64>) -> f64 {
        let angles = self.residual_rad(point);
        angles.map_or(f64::INFINITY, |angles| angles.norm() * self.px_per_rad)
    }
}

/// A point with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandmarkPoint {
    /// Where it is, metres in the map.
    pub point: Vector3<f64>,
    /// Covariance given the poses, m².
    pub covariance: Matrix3<f64>,
    /// Largest angle between two rays to it, radians.
    pub parallax_rad: f64,
}

impl LandmarkPoint {
    /// Largest standard deviation in any direction, metres.
    pub fn sigma_m(&self) -> f64 {
        self.covariance
            .symmetric_eigenvalues()
            .max()
            .max(0.0)
            .sqrt()
    }
}

/// How far off the ray a point of the optical frame is, as two angles (radians, exact for small ones) across the
/// ray; `None` for a point at the camera or behind the ray.
pub fn ray_residual_rad(ray: &Vector3<f64>, point: &Vector3<f64>) -> Option<Vector2<f64>> {
    let range = point.norm();
    let towards = ray.dot(point);
    (range > 1e-9 && towards > 0.0).then(|| across(ray) * point / range)
}

/// Two unit vectors across a ray.
pub(super) fn across(ray: &Vector3<f64>) -> Matrix2x3<f64> {
    // The axis that is least along the ray keeps the cross product away from zero.
    let axis = match ray.iamin() {
        0 => Vector3::x(),
        1 => Vector3::y(),
        _ => Vector3::z(),
    };
    let first = ray.cross(&axis).normalize();
    let second = ray.cross(&first);
    Matrix2x3::from_rows(&[first.transpose(), second.transpose()])
}

/// The point that minimises the robust sum of squared angles to the rays: from the point nearest to all rays, by
/// Gauss–Newton. `None` for fewer than two rays, rays that are parallel, and points behind a camera.
pub fn triangulate(sights: &[Sight<'_>]) -> Option<LandmarkPoint> {
    if sights.len() < 2 {
        return None;
    }
    let mut point = nearest_to_rays(sights)?;
    for _ in 0..STEPS {
        let (information, gradient) = normal_equations(sights, &point)?;
        let step = information.cholesky()?.solve(&gradient);
        point -= step;
        if step.norm_squared() < 1e-16 * (1.0 + point.norm_squared()) {
            break;
        }
    }
    let (information, _) = normal_equations(sights, &point)?;
    let covariance = information.cholesky()?.inverse();
    let sound = point.iter().chain(covariance.iter()).all(|x| x.is_finite());
    sound.then(|| LandmarkPoint {
        point,
        covariance,
        parallax_rad: parallax_rad(sights, &point),
    })
}

/// Of the robust sum, at a point; `None` where most cameras look away from it.
fn normal_equations(
    sights: &[Sight<'_>],
    point: &Vector3<f64>,
) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let mut information = Matrix3::zeros();
    let mut gradient = Vector3::zeros();
    let mut behind = 0;
    for sight in sights {
        let camera_from_map = sight.map_from_camera.rotation.inverse();
        let in_camera = camera_from_map * (point - sight.map_from_camera.translation);
        let Some(residual) = ray_residual_rad(&sight.ray, &in_camera) else {
            behind += 1;
            continue;
        };
        let range = in_camera.norm();
        let direction = in_camera / range;
        let by_point = across(&sight.ray)
            * (Matrix3::identity() - direction * direction.transpose())
            * camera_from_map.to_rotation_matrix().matrix()
            / range;
        let sigmas = residual.norm_squared() / (sight.sigma_rad * sight.sigma_rad);
        let robust = 1.0 / (1.0 + sigmas / (ROBUST_SIGMAS * ROBUST_SIGMAS));
        let weight = robust / (sight.sigma_rad * sight.sigma_rad);
        information += by_point.transpose() * by_point * weight;
        gradient += by_point.transpose() * residual * weight;
    }
    (2 * behind < sights.len()).then_some((information, gradient))
}

/// The point with the least sum of squared distances to all rays, in closed form.
fn nearest_to_rays(sights: &[Sight<'_>]) -> Option<Vector3<f64>> {
    let mut sum = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for sight in sights {
        let ray = sight.map_from_camera.rotation * sight.ray;
        let off = Matrix3::identity() - ray * ray.transpose();
        sum += off;
        right += off * sight.map_from_camera.translation;
    }
    sum.cholesky().map(|factors| factors.solve(&right))
}

/// Largest angle between two of the directions from a point, from the direction most off the first one: exact for
/// two, and never less than half for more.
fn parallax_rad(sights: &[Sight<'_>], point: &Vector3<f64>) -> f64 {
    let directions: Vec<Vector3<f64>> = sights
        .iter()
        .map(|sight| sight.map_from_camera.translation - point)
        .collect();
    let farthest = |from: &Vector3<f64>| {
        let angles = directions.iter().map(|to| (from.angle(to), to));
        angles.max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let Some((_, off)) = directions.first().and_then(farthest) else {
        return 0.0;
    };
    farthest(off).map_or(0.0, |(angle, _)| angle)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn exact_rays_give_the_point(
            point in prop::array::uniform3(-5.0..5.0f64),
            centres in prop::collection::vec(prop::array::uniform3(6.0..9.0f64), 2..6),
        ) {
            let point = Vector3::from(point);
            let poses: Vec<Pose> = centres
                .iter()
                .map(|[x, y, z]| Pose { translation: Vector3::new(*x, *y, *z), ..Pose::from_yaw(0.0, 0.0, *x) })
                .collect();
            let sights: Vec<Sight> = poses
                .iter()
                .map(|pose| Sight {
                    map_from_camera: pose,
                    ray: pose.inverse().transform(&point).normalize(),
                    sigma_rad: 0.005,
                px_per_rad: 127.0,
                })
                .collect();
            prop_assume!(parallax_rad(&sights, &point) > 0.02);
            let found = triangulate(&sights).unwrap();
            prop_assert!((found.point - point).norm() < 1e-6);
            prop_assert!(found.sigma_m() > 0.0);
        }
    }

    #[test]
    fn one_ray_or_parallel_rays_give_nothing() {
        let poses = [Pose::identity(), Pose::from_yaw(1.0, 0.0, 0.0)];
        let sight = |pose| Sight {
            map_from_camera: pose,
            ray: Vector3::z(),
            sigma_rad: 0.01,
            px_per_rad: 127.0,
        };
        assert!(triangulate(&[sight(&poses[0])]).is_none());
        assert!(triangulate(&[sight(&poses[0]), sight(&poses[1])]).is_none());
    }

    #[test]
    fn a_wrong_ray_among_many_hardly_matters() {
        let point = Vector3::new(0.0, 4.0, 1.0);
        let poses: Vec<Pose> = (0..10)
            .map(|at| Pose::from_yaw(f64::from(at) * 0.3, 0.0, 0.0))
            .collect();
        let mut sights: Vec<Sight> = poses
            .iter()
            .map(|pose| Sight {
                map_from_camera: pose,
                ray: pose.inverse().transform(&point).normalize(),
                sigma_rad: 0.005,
                px_per_rad: 127.0,
            })
            .collect();
        sights[3].ray = (sights[3].ray + Vector3::new(0.1, 0.0, 0.0)).normalize();
        let found = triangulate(&sights).unwrap();
        assert!((found.point - point).norm() < 0.02, "{found:?}");
    }
}
