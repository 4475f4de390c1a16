//! The generalised three-point problem: the pose of a rig from three points and three rays that need not meet.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::polynomial::roots;
use crate::geometry::pose::Pose;

/// Rays closer to parallel than this sine, or points closer together than this part of their distances, fix no pose.
const DEGENERATE: f64 = 1e-3;

/// Newton steps on the three depths after the polynomial: each doubles the digits.
const POLISH_STEPS: usize = 4;

/// Relative error of the squared distances that is left at a true solution.
const RESIDUAL: f64 = 1e-8;

/// One ray of the rig and the point it sees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    /// Where the ray starts, vehicle frame, metres.
    pub(super) origin: Vector3<f64>,
    /// Unit vector, vehicle frame.
    pub(super) direction: Vector3<f64>,
    /// The point, world frame, metres.
    pub(super) point: Vector3<f64>,
}

/// The poses `world_from_vehicle` from which the rays meet their points in front of the cameras; up to eight.
///
/// With the depths l along the rays, the distances between the points give three equations
/// `|o_i + l_i d_i - o_j - l_j d_j|² = |X_i - X_j|²`, each quadratic in two depths. Eliminating the second and third
/// leaves a polynomial of degree eight in the first (Nistér, Stewénius: A Minimal Solution to the Generalised 3-Point
/// Pose Problem, 2007, has the same degree). Where the rays do meet in one point, it is even, and the problem the
/// classical one with four solutions.
pub(super) fn solve(rays: &[Ray; 3], mut each: impl FnMut(Pose)) {
    let points = rays.map(|ray| ray.point);
    let sides = [(0, 1), (0, 2), (1, 2)].map(|(i, j)| (points[i] - points[j]).norm());
    let apart = [(0, 1), (0, 2), (1, 2)].map(|(i, j)| (rays[i].origin - rays[j].origin).norm());
    let scale = sides.iter().chain(&apart).copied().fold(0.0, f64::max);
    let area = (points[1] - points[0])
        .cross(&(points[2] - points[0]))
        .norm();
    if !(scale.is_finite() && area > DEGENERATE * scale * scale) {
        return;
    }
    let unit = rays.map(|ray| Ray {
        origin: ray.origin / scale,
        ..ray
    });
    let pair = |i: usize, j: usize, side: f64| Pair::new(&unit[i], &unit[j], side / scale);
    let pairs = [
        pair(0, 1, sides[0]),
        pair(0, 2, sides[1]),
        pair(1, 2, sides[2]),
    ];
    let Some(longest) = longest(&unit, &sides, &apart, scale) else {
        return;
    };
    let eliminated = Eliminated::new(&pairs);
    for &first in roots(&eliminated.octic, 0.0, longest).as_slice() {
        let depths = eliminated
            .depths(first)
            .and_then(|depths| polish(&pairs, depths));
        if let Some(pose) = depths.and_then(|depths| pose(&unit, depths, scale, &points)) {
            each(pose);
        }
    }
}

/// A bound on the first depth, in units of `scale`: the far end of its ray leaves the other ray's line with the sine
/// of the angle between them.
fn longest(rays: &[Ray; 3], sides: &[f64; 3], apart: &[f64; 3], scale: f64) -> Option<f64> {
    let bound = |other: usize| {
        let (a, b) = (&rays[0].direction, &rays[other].direction);
        let sine = if a.dot(b) < 0.0 {
            1.0
        } else {
            a.cross(b).norm()
        };
        (sine > DEGENERATE).then(|| (sides[other - 1] + apart[other - 1]) / (scale * sine))
    };
    match (bound(1), bound(2)) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}

/// `x² + y² + 2 a x y + b x + c y + d = 0` for the depths x and y of two rays.
#[derive(Clone, Copy)]
struct Pair {
    a: f64,
    b: f64,
    c: f64,
    d: f64,
}

impl Pair {
    fn new(x: &Ray, y: &Ray, side: f64) -> Self {
        let apart = x.origin - y.origin;
        Self {
            a: -x.direction.dot(&y.direction),
            b: 2.0 * x.direction.dot(&apart),
            c: -2.0 * y.direction.dot(&apart),
            d: apart.norm_squared() - side * side,
        }
    }

    /// As `y² + linear(x) y + constant(x)`.
    fn in_second(&self) -> (Polynomial, Polynomial) {
        (
            Polynomial::new(&[self.c, 2.0 * self.a]),
            Polynomial::new(&[self.d, self.b, 1.0]),
        )
    }

    /// Value and slopes.
    fn value(&self, x: f64, y: f64) -> (f64, f64, f64) {
        (
            x * x + y * y + 2.0 * self.a * x * y + self.b * x + self.c * y + self.d,
            2.0 * (x + self.a * y) + self.b,
            2.0 * (y + self.a * x) + self.c,
        )
    }
}

/// What is left after elimination: with `y² + f y + g = 0` and `z² + h z + k = 0`, both in x, the third equation is
/// `(p + b y) z + q y + r = 0`, which put into the one for z is `u y + v = 0`, and that put into the one for y is the
/// octic.
struct Eliminated {
    p: Polynomial,
    q: Polynomial,
    r: Polynomial,
    b: f64,
    u: Polynomial,
    v: Polynomial,
    octic: [f64; 9],
}

impl Eliminated {
    fn new(pairs: &[Pair; 3]) -> Self {
        let (f, g) = pairs[0].in_second();
        let (h, k) = pairs[1].in_second();
        let last = &pairs[2];
        let b = 2.0 * last.a;
        let p = Polynomial::new(&[last.c]).minus(&h);
        let q = Polynomial::new(&[last.b]).minus(&f);
        let r = Polynomial::new(&[last.d]).minus(&g).minus(&k);
        // (q y + r)² - h (q y + r)(p + b y) + k (p + b y)², by powers of y.
        let hq = h.times(&q);
        let two = q.times(&q).minus(&hq.scaled(b)).plus(&k.scaled(b * b));
        let one = (q.times(&r).scaled(2.0))
            .minus(&hq.times(&p))
            .minus(&h.times(&r).scaled(b))
            .plus(&k.times(&p).scaled(2.0 * b));
        let none = (r.times(&r))
            .minus(&h.times(&r).times(&p))
            .plus(&k.times(&p).times(&p));
        let u = one.minus(&two.times(&f));
        let v = none.minus(&two.times(&g));
        let octic = (v.times(&v))
            .minus(&f.times(&u).times(&v))
            .plus(&g.times(&u).times(&u));
        let octic = octic.0;
        Self {
            p,
            q,
            r,
            b,
            u,
            v,
            octic,
        }
    }

    fn depths(&self, x: f64) -> Option<Vector3<f64>> {
        let y = -self.v.at(x) / self.u.at(x);
        let z = -(self.q.at(x) * y + self.r.at(x)) / (self.p.at(x) + self.b * y);
        let depths = Vector3::new(x, y, z);
        depths
            .iter()
            .all(|depth| depth.is_finite())
            .then_some(depths)
    }
}

/// Newton's method on the three equations; none where it does not settle on positive depths.
fn polish(pairs: &[Pair; 3], mut depths: Vector3<f64>) -> Option<Vector3<f64>> {
    for step in 0..=POLISH_STEPS {
        let [x, y, z] = [depths.x, depths.y, depths.z];
        let (e0, x0, y0) = pairs[0].value(x, y);
        let (e1, x1, z1) = pairs[1].value(x, z);
        let (e2, y2, z2) = pairs[2].value(y, z);
        let error = Vector3::new(e0, e1, e2);
        if error.amax() <= RESIDUAL * (1.0 + depths.norm_squared()) * 1e-4 || step == POLISH_STEPS {
            let settled = error.amax() <= RESIDUAL * (1.0 + depths.norm_squared());
            return (settled && depths.min() > 0.0).then_some(depths);
        }
        let slopes = Matrix3::new(x0, y0, 0.0, x1, 0.0, z1, 0.0, y2, z2);
        depths -= slopes.try_inverse()? * error;
    }
    None
}

/// The motion that lays the triangle at these depths on the triangle of points.
fn pose(
    rays: &[Ray; 3],
    depths: Vector3<f64>,
    scale: f64,
    points: &[Vector3<f64>; 3],
) -> Option<Pose> {
    let corner = |i: usize| (rays[i].origin + rays[i].direction * depths[i]) * scale;
    let of_vehicle = [corner(0), corner(1), corner(2)];
    let rotation =
        Rotation3::from_matrix_unchecked(triad(points)? * triad(&of_vehicle)?.transpose());
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    let centre = |points: &[Vector3<f64>; 3]| (points[0] + points[1] + points[2]) / 3.0;
    let translation = centre(points) - rotation * centre(&of_vehicle);
    let finite = translation
        .iter()
        .chain(rotation.coords.iter())
        .all(|value| value.is_finite());
    finite.then(|| {
        Pose::new(
            translation,
            UnitQuaternion::new_normalize(rotation.into_inner()),
        )
    })
}

/// Right-handed axes of a triangle: along its first side, across it in its plane, its normal.
fn triad([a, b, c]: &[Vector3<f64>; 3]) -> Option<Matrix3<f64>> {
    let along = (b - a).try_normalize(f64::MIN_POSITIVE)?;
    let normal = along.cross(&(c - a)).try_normalize(f64::MIN_POSITIVE)?;
    Some(Matrix3::from_columns(&[
        along,
        normal.cross(&along),
        normal,
    ]))
}

/// Of degree eight at most.
#[derive(Clone, Copy)]
struct Polynomial([f64; 9], usize);

impl Polynomial {
    fn new(coefficients: &[f64]) -> Self {
        let mut all = [0.0; 9];
        let count = coefficients.len().min(9);
        all[..count].copy_from_slice(&coefficients[..count]);
        Self(all, count.max(1) - 1)
    }

    fn at(&self, x: f64) -> f64 {
        self.0[..=self.1]
            .iter()
            .rev()
            .fold(0.0, |sum, c| sum * x + c)
    }

    fn plus(&self, other: &Self) -> Self {
        self.combined(other, 1.0)
    }

    fn minus(&self, other: &Self) -> Self {
        self.combined(other, -1.0)
    }

    fn combined(&self, other: &Self, factor: f64) -> Self {
        let mut sum = *self;
        for (a, b) in sum.0.iter_mut().zip(&other.0) {
            *a += factor * b;
        }
        sum.1 = self.1.max(other.1);
        sum
    }

    fn scaled(mut self, factor: f64) -> Self {
        self.0.iter_mut().for_each(|c| *c *= factor);
        self
    }

    fn times(&self, other: &Self) -> Self {
        let mut product = Self([0.0; 9], (self.1 + other.1).min(8));
        for (i, a) in self.0[..=self.1].iter().enumerate() {
            for (j, b) in other.0[..=other.1].iter().enumerate().take(9 - i) {
                product.0[i + j] += a * b;
            }
        }
        product
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    fn vectors(range: f64) -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-range..range).prop_map(Vector3::from)
    }

    fn nearest(truth: &Pose, rays: &[Ray; 3]) -> (f64, usize) {
        let (mut nearest, mut count) = (f64::INFINITY, 0);
        solve(rays, |pose| {
            let apart = (pose.translation - truth.translation).norm();
            nearest = nearest.min(apart + pose.rotation.angle_to(&truth.rotation));
            count += 1;
        });
        (nearest, count)
    }

    fn rays(truth: &Pose, origins: [Vector3<f64>; 3], points: [Vector3<f64>; 3]) -> [Ray; 3] {
        std::array::from_fn(|i| Ray {
            origin: origins[i],
            direction: (truth.inverse().transform(&points[i]) - origins[i]).normalize(),
            point: points[i],
        })
    }

    /// How far the triangle and the rays are from where the problem has no answer or two that touch.
    fn well_posed(rays: &[Ray; 3]) -> bool {
        let [a, b, c] = rays.map(|ray| ray.direction);
        let volume = a.dot(&b.cross(&c)).abs();
        let [x, y, z] = rays.map(|ray| ray.point);
        volume > 0.1 && (y - x).cross(&(z - x)).norm() > 1.0
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]
        #[test]
        fn the_true_pose_is_among_the_solutions(
            at in vectors(5.0), turn in vectors(2.0),
            origins in prop::array::uniform3(vectors(1.0)), points in prop::array::uniform3(vectors(8.0)),
        ) {
            let truth = Pose::new(at, UnitQuaternion::from_scaled_axis(turn));
            for origins in [origins, [origins[0]; 3], [origins[0], origins[0], origins[1]]] {
                let rays = rays(&truth, origins, points);
                prop_assume!(well_posed(&rays));
                let (error, count) = nearest(&truth, &rays);
                prop_assert!(count <= 8);
                prop_assert!(error < 1e-3, "error {} of {} solutions", error, count);
            }
        }
    }

    #[test]
    fn what_fixes_no_pose_gives_none() {
        let truth = Pose::identity();
        let same = Vector3::new(1.0, 2.0, 3.0);
        let line = [same, same * 2.0, same * 3.0];
        let origins = [Vector3::zeros(), Vector3::x(), Vector3::y()];
        assert_eq!(nearest(&truth, &rays(&truth, origins, [same; 3])).1, 0);
        assert_eq!(nearest(&truth, &rays(&truth, origins, line)).1, 0);
        let nan = rays(&truth, origins, [same * f64::NAN, same, same * 2.0]);
        assert_eq!(nearest(&truth, &nan).1, 0);
    }
}
