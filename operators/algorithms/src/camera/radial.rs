//! Rising curves and their inverses: what every central lens with radial symmetry comes down to.
//!
//! A lens curve fitted by a polynomial rises where it was fitted and does what it likes beyond.
//! Past its first turning point two rays share a pixel, so the map would show things that are not
//! there; the curve therefore ends at that point ([`rising_limit`]). Up to it an inverse exists
//! and safeguarded Newton finds it to the last bits ([`invert`]).

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

/// Value and slope of `c[0] + c[1] x + c[2] x² + …` (Horner).
pub(super) fn polynomial(coefficients: &[f64], x: f64) -> (f64, f64) {
    coefficients
        .iter()
        .rev()
        .fold((0.0, 0.0), |(value, slope), &c| {
            (value * x + c, slope * x + value)
        })
}
