//! Rising curves and their inverses: what every central lens with radial symmetry comes down to.
//!
//! A lens curve fitted by a polynomial rises where it was fitted and does what it likes beyond.
//! Past its first turning point two rays share a pixel, so the map would show things that are not
//! there; the curve therefore ends at that point ([`rising_limit`]). Up to it an inverse exists
//! and safeguarded Newton finds it to the last bits ([`invert`]).

use nalgebra::{Matrix2x3, Vector2, Vector3};

/// Number of places where a slope is looked at before bisection sharpens the answer.
const SCAN_STEPS: u32 = 2_000;

/// The largest `x` in `[0, end]` such that `slope` is positive on all of `(0, x)`.
pub(super) fn rising_limit(slope: impl Fn(f64) -> f64, end: f64) -> f64 {
    let rises = |x: f64| slope(x) > 0.0;
    let at = |step: u32| end * f64::from(step) / f64::from(SCAN_STEPS);
    let Some(step) = (1..=SCAN_STEPS).find(|&step| !rises(at(step))) else {
        return end;
    };
    let (mut good, mut bad) = (at(step - 1), at(step));
    for _ in 0..60 {
        let middle = 0.5 * (good + bad);
        if rises(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}

/// Solves `curve(x) = target` on `[low, high]`, where `curve` gives value and slope and rises.
/// `None` when `target` is outside the curve's values (or NaN).
pub(super) fn invert(
    curve: impl Fn(f64) -> (f64, f64),
    target: f64,
    (mut low, mut high): (f64, f64),
    guess: f64,
) -> Option<f64> {
    if !(target >= curve(low).0 && target <= curve(high).0) {
        return None;
    }
    let mut x = if guess > low && guess < high {
        guess
    } else {
        0.5 * (low + high)
    };
    for _ in 0..100 {
        let (value, slope) = curve(x);
        let error = value - target;
        if error > 0.0 {
            high = x;
        } else {
            low = x;
        }
        let newton = x - error / slope;
        let next = if newton >= low && newton <= high {
            newton
        } else {
            0.5 * (low + high)
        };
        if (next - x).abs() <= 1e-15 * (1.0 + x.abs()) {
            return Some(next);
        }
        x = next;
    }
    Some(x)
}

/// Where a lens with radial symmetry puts a point on its plane, `r(θ) (cos φ, sin φ)`, and how
/// that changes with the point. `across` is √(x² + y²); `curve` is r and dr/dθ. `None` where
/// there is no derivative: on the axis behind the lens.
///
/// With n² = x² + y² + z², dθ = (z d(across) - across dz) / n². Along the axis everything is
/// written by the cosine and sine of φ, so nothing cancels near it.
pub(super) fn on_plane(
    point: &Vector3<f64>,
    across: f64,
    (radius, slope): (f64, f64),
) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    if across <= f64::EPSILON * point.z.abs() {
        if point.z <= 0.0 {
            return None;
        }
        let scale = slope / point.z;
        let jacobian = Matrix2x3::new(scale, 0.0, 0.0, 0.0, scale, 0.0);
        return Some((Vector2::new(point.x, point.y) * scale, jacobian));
    }
    let (cos, sin) = (point.x / across, point.y / across);
    let by_angle = slope / (across * across + point.z * point.z);
    // Outwards the radius grows, sideways the direction turns.
    let (outwards, sideways) = (by_angle * point.z, radius / across);
    let cross = cos * sin * (outwards - sideways);
    let jacobian = Matrix2x3::new(
        cos * cos * outwards + sin * sin * sideways,
        cross,
        -by_angle * across * cos,
        cross,
        sin * sin * outwards + cos * cos * sideways,
        -by_angle * across * sin,
    );
    Some((Vector2::new(cos, sin) * radius, jacobian))
}

/// Value and slope of `c[0] + c[1] x + c[2] x² + …` (Horner).
pub(in crate::geometry) fn polynomial(coefficients: &[f64], x: f64) -> (f64, f64) {
    coefficients
        .iter()
        .rev()
        .fold((0.0, 0.0), |(value, slope), &c| {
            (value * x + c, slope * x + value)
        })
}
