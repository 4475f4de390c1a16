//! Points from rays: where a landmark is, seen from known poses, and how well that is known.
//!
//! ```text
//! views ─unproject─► rays ─pairs, truncated vote─► inliers ─midpoint─► start ─Gauss–Newton─► point
//!                                                                 reprojection, robust   covariance
//! ```
//!
//! Everything is done on bearings first, so fields of view of 180° and more are no special case:
//! "in front of the camera" means *along the ray*. The start is the point nearest to all rays, each
//! distance divided by its range, so that angles count and not metres (Hartley & Zisserman,
//! *Multiple View Geometry*, section 12.2, on bearings instead of pixels; for two rays it is the
//! midpoint). Then the reprojection error itself is minimised. Views that disagree with the best
//! pair of rays are left out.

#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use crate::camera::Camera;
use crate::least_squares::Loss;
use crate::pose::Pose;

/// One sight of the landmark.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The camera that saw it.
    pub camera: &'a Camera,
    /// Where the camera was: optical frame to map.
    pub map_from_camera: Pose,
    /// Where in the image, pixels.
    pub pixel: [f64; 2],
    /// Standard deviation of either coordinate, pixels.
    pub sigma_px: f64,
}

/// What a point must fulfil.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// A view farther from the projected point than this many of its standard deviations is an
    /// outlier.
    pub outlier_sigmas: f64,
    /// Fewest views that agree.
    pub min_inliers: usize,
    /// Smallest angle between two rays, radians.
    pub min_parallax_rad: f64,
    /// Nearest range, metres.
    pub min_depth_m: f64,
    /// Farthest range, metres.
    pub max_depth_m: f64,
    /// Largest standard deviation of the point in its worst direction, as a part of its range
    /// from the nearest view.
    pub max_relative_sigma: f64,
}

impl Default for Options {
    /// 3.03 σ keeps 99 % of good views (χ² of two degrees: 9.21). One degree of parallax is the
    /// usual bound (COLMAP: 1.5°); the covariance, a tenth of the range, then does the finer
    /// work.
    fn default() -> Self {
        Self {
            outlier_sigmas: 3.03,
            min_inliers: 2,
            min_parallax_rad: 1f64.to_radians(),
            min_depth_m: 0.1,
            max_depth_m: 200.0,
            max_relative_sigma: 0.1,
        }
    }
}

/// A landmark.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Where it is in the map, metres.
    pub position: Vector3<f64>,
    /// Covariance of the position given the poses, m².
    pub covariance: Matrix3<f64>,
    /// Standard deviation in the worst direction, metres.
    pub sigma_m: f64,
    /// Largest angle between two rays of inliers, radians.
    pub parallax_rad: f64,
    /// Nearest and farthest range of inliers, metres.
    pub range_m: [f64; 2],
    /// Root mean square of the inliers' distances in the image, pixels.
    pub rms_px: f64,
    /// For each view: does it agree?
    pub inliers: Vec<bool>,
}

/// Why views give no point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Too few views see anything, or agree.
    #[error("too few views agree")]
    Views,
    /// All rays are nearly parallel.
    #[error("the rays are nearly parallel")]
    Parallax,
    /// The point is too near, too far, or behind a camera.
    #[error("the point lies outside the allowed range")]
    Depth,
    /// The point is too uncertain.
    #[error("the point is too uncertain")]
    Uncertain,
}

/// A ray in the map.
#[derive(Clone, Copy)]
struct Ray {
    origin: Vector3<f64>,
    direction: Vector3<f64>,
}

/// Pairs tried at most: enough to meet two good views among seven of ten false ones (9 % of
/// pairs) with a probability of 1 - 0.91^64 = 99.8 %.
const MAX_PAIRS: usize = 64;

/// The point that the views show.
///
/// # Errors
/// [`Refusal`].
pub fn triangulate(views: &[View<'_>], options: &Options) -> Result<Point, Refusal> {
    let rays: Vec<Option<Ray>> = views.iter().map(ray).collect();
    let usable: Vec<usize> = (0..views.len()).filter(|at| rays[*at].is_some()).collect();
    if usable.len() < options.min_inliers.max(2) {
        return Err(Refusal::Views);
    }
    let start = best_pair(views, &rays, &usable, options).ok_or(Refusal::Parallax)?;
    let mut inliers = agreeing(views, &start, options);
    let mut position = start;
    // Who agrees changes with the point; two rounds settle all but ties.
    for _ in 0..2 {
        let chosen: Vec<usize> = (0..views.len()).filter(|at| inliers[*at]).collect();
        if chosen.len() < options.min_inliers.max(2) {
            return Err(Refusal::Views);
        }
        let own: Vec<Ray> = chosen.iter().filter_map(|at| rays[*at]).collect();
        position = nearest_to_rays(&own, &position).unwrap_or(position);
        position = refine(views, &chosen, position, options);
        inliers = agreeing(views, &position, options);
    }
    judge(views, &rays, inliers, position, options)
}

fn ray(view: &View<'_>) -> Option<Ray> {
    (view.sigma_px > 0.0).then_some(())?;
    let bearing = view.camera.unproject(view.pixel)?;
    Some(Ray {
        origin: view.map_from_camera.translation,
        direction: view.map_from_camera.rotate(&bearing),
    })
}

/// Squared distance in the image, in variances; infinite where the view cannot see the point.
fn squared_error(view: &View<'_>, point: &Vector3<f64>) -> f64 {
    let seen = view.map_from_camera.inverse().transform(point);
    let pixel = view.camera.project(&seen);
    pixel.map_or(f64::INFINITY, |pixel| {
        let [x, y] = [pixel[0] - view.pixel[0], pixel[1] - view.pixel[1]];
        (x * x + y * y) / (view.sigma_px * view.sigma_px)
    })
}

fn agreeing(views: &[View<'_>], point: &Vector3<f64>, options: &Options) -> Vec<bool> {
    let bound = options.outlier_sigmas.powi(2);
    let agrees = |view| squared_error(view, point) <= bound;
    views.iter().map(agrees).collect()
}

/// The start on which most views agree: the midpoint of two rays that loses the least by
/// truncated squares.
fn best_pair(
    views: &[View<'_>],
    rays: &[Option<Ray>],
    usable: &[usize],
    options: &Options,
) -> Option<Vector3<f64>> {
    let bound = options.outlier_sigmas.powi(2);
    let mut best: Option<(f64, Vector3<f64>)> = None;
    for (first, second) in pairs(usable.len()) {
        let both = rays[usable[first]].zip(rays[usable[second]]);
        let Some(point) = both.and_then(|(a, b)| midpoint(&a, &b)) else {
            continue;
        };
        let lost: f64 = usable
            .iter()
            .map(|at| squared_error(&views[*at], &point).min(bound))
            .sum();
        if best.is_none_or(|(least, _)| lost < least) {
            best = Some((lost, point));
        }
    }
    best.map(|(_, point)| point)
}

/// Pairs of `count` views, those far apart in the list (and so on the path) first.
fn pairs(count: usize) -> impl Iterator<Item = (usize, usize)> {
    let apart = (1..count).rev();
    let all = apart.flat_map(move |apart| (0..count - apart).map(move |at| (at, at + apart)));
    let total = count * count.saturating_sub(1) / 2;
    // Spread over all of them where there are too many.
    all.step_by(total.div_ceil(MAX_PAIRS).max(1))
}

/// The point nearest to two rays; `None` where they are parallel or it lies behind one of them.
fn midpoint(a: &Ray, b: &Ray) -> Option<Vector3<f64>> {
    let cosine = a.direction.dot(&b.direction);
    let squared_sine = a.direction.cross(&b.direction).norm_squared();
    if squared_sine < 1e-10 {
        return None;
    }
    let between = b.origin - a.origin;
    let (by_a, by_b) = (between.dot(&a.direction), between.dot(&b.direction));
    let along_a = (by_a - cosine * by_b) / squared_sine;
    let along_b = (cosine * by_a - by_b) / squared_sine;
    if along_a <= 0.0 || along_b <= 0.0 {
        return None;
    }
    let on_a = a.origin + a.direction * along_a;
    let on_b = b.origin + b.direction * along_b;
    // Nearer to the nearer origin: an angle's error is small there.
    let part = along_a / (along_a + along_b);
    Some(on_a.lerp(&on_b, part))
}

/// Least squares of `|(I - d dᵀ)(X - o)| / range`, the range taken from `guess`.
fn nearest_to_rays(rays: &[Ray], guess: &Vector3<f64>) -> Option<Vector3<f64>> {
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for ray in rays {
        let range2 = (guess - ray.origin).norm_squared().max(1e-12);
        let across = (Matrix3::identity() - ray.direction * ray.direction.transpose()) / range2;
        matrix += across;
        right += across * (ray.origin - guess);
    }
    let point = guess + matrix.cholesky()?.solve(&right);
    point.iter().all(|x| x.is_finite()).then_some(point)
}

/// Normal matrix, right-hand side and robust cost of the reprojection error.
fn normal_equations(
    views: &[View<'_>],
    chosen: &[usize],
    point: &Vector3<f64>,
    loss: Loss,
) -> (Matrix3<f64>, Vector3<f64>, f64) {
    let (mut matrix, mut right, mut cost) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for view in chosen.iter().map(|at| &views[*at]) {
        let camera_from_map = view.map_from_camera.inverse();
        let seen = camera_from_map.transform(point);
        let Some((pixel, jacobian)) = view.camera.project_with_jacobian(&seen) else {
            return (matrix, right, f64::INFINITY);
        };
        let rotation = camera_from_map.rotation.to_rotation_matrix().into_inner();
        let jacobian = jacobian * rotation / view.sigma_px;
        let error = nalgebra::Vector2::new(pixel[0] - view.pixel[0], pixel[1] - view.pixel[1]);
        let error = error / view.sigma_px;
        let squared = error.norm_squared();
        let weight = loss.weight(squared);
        matrix += jacobian.transpose() * jacobian * weight;
        right -= jacobian.transpose() * error * weight;
        cost += loss.cost(squared);
    }
    (matrix, right, cost)
}

/// Gauss–Newton, damped where a step makes it worse.
fn refine(
    views: &[View<'_>],
    chosen: &[usize],
    start: Vector3<f64>,
    options: &Options,
) -> Vector3<f64> {
    let loss = Loss::Huber(0.5 * options.outlier_sigmas);
    let mut point = start;
    let (mut matrix, mut right, mut cost) = normal_equations(views, chosen, &point, loss);
    let mut damping = 0.0;
    for _ in 0..20 {
        let mut damped = matrix;
        for axis in 0..3 {
            damped[(axis, axis)] *= 1.0 + damping;
        }
        let Some(step) = damped.cholesky().map(|factor| factor.solve(&right)) else {
            break;
        };
        let trial = point + step;
        let next = normal_equations(views, chosen, &trial, loss);
        if next.2 < cost {
            let gained = cost - next.2;
            (point, (matrix, right, cost)) = (trial, next);
            damping *= 0.1;
            if gained <= 1e-9 * cost {
                break;
            }
        } else if damping > 1e6 || step.norm() <= 1e-12 * (1.0 + point.norm()) {
            break;
        } else {
            damping = (10.0 * damping).max(1e-3);
        }
    }
    point
}

/// Is the point good enough?
fn judge(
    views: &[View<'_>],
    rays: &[Option<Ray>],
    inliers: Vec<bool>,
    position: Vector3<f64>,
    options: &Options,
) -> Result<Point, Refusal> {
    let chosen: Vec<usize> = (0..views.len()).filter(|at| inliers[*at]).collect();
    if chosen.len() < options.min_inliers.max(2) {
        return Err(Refusal::Views);
    }
    let own: Vec<Ray> = chosen.iter().filter_map(|at| rays[*at]).collect();
    let parallax_rad = widest_angle(&own);
    if parallax_rad < options.min_parallax_rad {
        return Err(Refusal::Parallax);
    }
    let mut range_m = [f64::INFINITY, 0.0];
    for ray in &own {
        let depth = (position - ray.origin).dot(&ray.direction);
        range_m = [range_m[0].min(depth), f64::max(range_m[1], depth)];
    }
    if !(range_m[0] >= options.min_depth_m && range_m[1] <= options.max_depth_m) {
        return Err(Refusal::Depth);
    }
    let (information, ..) = normal_equations(views, &chosen, &position, Loss::Quadratic);
    let covariance = information.try_inverse().ok_or(Refusal::Uncertain)?;
    let sigma_m = SymmetricEigen::new(covariance).eigenvalues.max().sqrt();
    if sigma_m.is_nan() || sigma_m > options.max_relative_sigma * range_m[0] {
        return Err(Refusal::Uncertain);
    }
    let squared_px = chosen.iter().map(|at| {
        let view = &views[*at];
        squared_error(view, &position) * view.sigma_px * view.sigma_px
    });
    Ok(Point {
        position,
        covariance,
        sigma_m,
        parallax_rad,
        range_m,
        rms_px: (squared_px.sum::<f64>() / chosen.len() as f64).sqrt(),
        inliers,
    })
}

/// Largest angle between two of the rays.
fn widest_angle(rays: &[Ray]) -> f64 {
    let mut widest: f64 = 0.0;
    for (index, a) in rays.iter().enumerate() {
        for b in &rays[index + 1..] {
            let sine = a.direction.cross(&b.direction).norm();
            widest = widest.max(sine.atan2(a.direction.dot(&b.direction)));
        }
    }
    widest
}
