//! A point from the rays that it was seen along.

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

use crate::geometry::pose::Pose;
use crate::geometry::resection::across;

/// Steps of the refinement; it converges quadratically, so few are needed.
const STEPS: usize = 8;
/// Residuals beyond this many times their sigma count less (Cauchy).
const ROBUST_SIGMAS: f64 = 2.0;
/// Nearer points (m) have no direction.
const NEAREST_M: f64 = 1e-9;

/// Where a camera is, and along which ray it sees something: in any frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct LineOfSight {
    camera: Vector3<f64>,
    /// Unit vector.
    ray: Vector3<f64>,
    /// Rows: two unit vectors across the ray and each other.
    across: Matrix2x3<f64>,
}

/// How a line of sight sees a point that it should meet.
pub(super) struct Miss {
    /// Across the ray, radians (exact for small angles).
    pub(super) angles: Vector2<f64>,
    /// Of the angles by the point, radians per metre.
    pub(super) by_point: Matrix2x3<f64>,
}

impl LineOfSight {
    /// `ray` is a unit vector in the optical frame.
    pub(super) fn new(frame_from_camera: &Pose, ray: &Vector3<f64>) -> Self {
        let ray = frame_from_camera.rotation * ray;
        Self {
            camera: frame_from_camera.translation,
            ray,
            across: across(&ray),
        }
    }

    /// How far off the ray a point is, as two angles (radians); `None` for a point at the camera or behind it.
    pub(super) fn angles(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let (direction, _) = self.direction(point)?;
        Some(self.across * direction)
    }

    /// The same with its derivative.
    pub(super) fn miss(&self, point: &Vector3<f64>) -> Option<Miss> {
        let (direction, range_m) = self.direction(point)?;
        let angles = self.across * direction;
        Some(Miss {
            angles,
            by_point: (self.across - angles * direction.transpose()) / range_m,
        })
    }

    /// Unit vector to a point, and how far it is.
    fn direction(&self, point: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
        let away = point - self.camera;
        let range_m = away.norm();
        (range_m > NEAREST_M && self.ray.dot(&away) > 0.0).then(|| (away / range_m, range_m))
    }
}

/// A sighting: where the camera was, along which ray it saw the point, and how exactly.
#[derive(Debug, Clone, Copy)]
pub struct Sight {
    line: LineOfSight,
    /// Standard deviation of the ray, radians.
    pub sigma_rad: f64,
    /// Pixels per radian at the middle of the image.
    pub px_per_rad: f64,
}

impl Sight {
    /// By a camera that stood at `map_from_camera`, along a unit vector in its optical frame.
    pub fn new(
        map_from_camera: &Pose,
        ray: &Vector3<f64>,
        sigma_rad: f64,
        px_per_rad: f64,
    ) -> Self {
        Self {
            line: LineOfSight::new(map_from_camera, ray),
            sigma_rad,
            px_per_rad,
        }
    }

    /// How inexactly the point is seen, in units of the smallest features' standard deviation.
    pub fn blur(&self) -> f64 {
        self.sigma_rad * self.px_per_rad
    }

    /// How far off the ray a point of the map is, pixels at the middle of the image; `None` for a point at the camera or
    /// behind it.
    pub fn off_px(&self, point: &Vector3<f64>) -> Option<f64> {
        let angles = self.line.angles(point)?;
        Some(angles.norm() * self.px_per_rad)
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

/// The point that minimises the robust sum of squared angles to the rays: from the point nearest to all rays, by
/// Gauss–Newton. `None` for fewer than two rays, rays that are parallel, and points behind a camera.
pub fn triangulate(sights: &[Sight]) -> Option<LandmarkPoint> {
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
    sights: &[Sight],
    point: &Vector3<f64>,
) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let mut information = Matrix3::zeros();
    let mut gradient = Vector3::zeros();
    let mut behind = 0;
    for sight in sights {
        let Some(Miss { angles, by_point }) = sight.line.miss(point) else {
            behind += 1;
            continue;
        };
        let variance = sight.sigma_rad * sight.sigma_rad;
        let robust =
            1.0 / (1.0 + angles.norm_squared() / (variance * ROBUST_SIGMAS * ROBUST_SIGMAS));
        let weight = robust / variance;
        information += by_point.transpose() * by_point * weight;
        gradient += by_point.transpose() * angles * weight;
    }
    (2 * behind < sights.len()).then_some((information, gradient))
}

/// The point with the least sum of squared distances to all rays, in closed form.
fn nearest_to_rays(sights: &[Sight]) -> Option<Vector3<f64>> {
    let mut sum = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for sight in sights {
        let LineOfSight { camera, ray, .. } = sight.line;
        let off = Matrix3::identity() - ray * ray.transpose();
        sum += off;
        right += off * camera;
    }
    sum.cholesky().map(|factors| factors.solve(&right))
}

/// Largest angle between two of the directions from a point, from the direction most off the first one: exact for
/// two, and never less than half for more.
fn parallax_rad(sights: &[Sight], point: &Vector3<f64>) -> f64 {
    let directions: Vec<Vector3<f64>> = sights
        .iter()
        .map(|sight| sight.line.camera - point)
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
                .map(|pose| {
                    let ray = pose.inverse().transform(&point).normalize();
                    Sight::new(pose, &ray, 0.005, 127.0)
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
        let sight = |pose| Sight::new(pose, &Vector3::z(), 0.01, 127.0);
        assert!(triangulate(&[sight(&poses[0])]).is_none());
        assert!(triangulate(&[sight(&poses[0]), sight(&poses[1])]).is_none());
    }

    #[test]
    fn a_wrong_ray_among_many_hardly_matters() {
        let point = Vector3::new(0.0, 4.0, 1.0);
        let poses: Vec<Pose> = (0..10)
            .map(|at| Pose::from_yaw(f64::from(at) * 0.3, 0.0, 0.0))
            .collect();
        let wrong = Vector3::new(0.1, 0.0, 0.0);
        let sights = poses.iter().enumerate().map(|(at, pose)| {
            let off = if at == 3 { wrong } else { Vector3::zeros() };
            let ray = (pose.inverse().transform(&point).normalize() + off).normalize();
            Sight::new(pose, &ray, 0.005, 127.0)
        });
        let sights: Vec<Sight> = sights.collect();
        let found = triangulate(&sights).unwrap();
        assert!((found.point - point).norm() < 0.02, "{found:?}");
    }
}
