//! Real roots of a polynomial in an interval.

use crate::geometry::camera::radial::polynomial as value;

/// Most roots of a polynomial handled here.
const MAX_DEGREE: usize = 8;

/// A bracket halves in every second step at the latest, so that this many steps use up a double's digits.
const STEPS: usize = 120;

/// The roots of `c[0] + c[1] x + … + c[8] x⁸` in `[low, high]` where it changes its sign, ascending.
///
/// Between two neighbouring roots of its derivative a polynomial is monotonic and has one root at most, so that the
/// roots of the derivatives, from the last to the first, bracket those of the next.
pub(super) fn roots(c: &[f64; MAX_DEGREE + 1], low: f64, high: f64) -> Roots {
    let mut found = Roots::default();
    for order in (0..MAX_DEGREE).rev() {
        let derivative = derivative(c, order);
        let polynomial = &derivative[..=MAX_DEGREE - order];
        let mut next = Roots::default();
        let mut from = low;
        for &to in found.as_slice().iter().chain([&high]) {
            if let Some(root) = bracketed(polynomial, from, to) {
                next.push(root);
            }
            from = to;
        }
        found = next;
    }
    found
}

/// At most eight roots.
#[derive(Default)]
pub(super) struct Roots {
    values: [f64; MAX_DEGREE],
    count: usize,
}

impl Roots {
    pub(super) fn as_slice(&self) -> &[f64] {
        &self.values[..self.count]
    }

    fn push(&mut self, root: f64) {
        let again = self.as_slice().last() == Some(&root);
        if self.count < MAX_DEGREE && !again {
            self.values[self.count] = root;
            self.count += 1;
        }
    }
}

fn derivative(c: &[f64; MAX_DEGREE + 1], order: usize) -> [f64; MAX_DEGREE + 1] {
    let mut out = [0.0; MAX_DEGREE + 1];
    for power in order..=MAX_DEGREE {
        let factor: f64 = (power - order + 1..=power).map(|k| k as f64).product();
        out[power - order] = c[power] * factor;
    }
    out
}

/// The root between two places of different sign: Newton's steps where they stay inside and shrink the bracket,
/// halving otherwise.
fn bracketed(c: &[f64], mut low: f64, mut high: f64) -> Option<f64> {
    let (at_low, at_high) = (value(c, low).0, value(c, high).0);
    if at_low == 0.0 {
        return Some(low);
    }
    if !(at_low < 0.0 && at_high >= 0.0 || at_low > 0.0 && at_high <= 0.0) {
        return None;
    }
    let mut x = 0.5 * (low + high);
    let mut halve = false;
    for _ in 0..STEPS {
        let (y, slope) = value(c, x);
        let width = high - low;
        if y == 0.0 {
            return Some(x);
        }
        if (y < 0.0) == (at_low < 0.0) {
            low = x;
        } else {
            high = x;
        }
        let newton = x - y / slope;
        let inside = newton > low && newton < high && !halve;
        // A step from one side only does not shrink the bracket; then the next one halves it.
        halve = high - low > 0.5 * width && inside;
        let next = if inside { newton } else { 0.5 * (low + high) };
        if (next - x).abs() <= f64::EPSILON * x.abs() {
            return Some(next);
        }
        x = next;
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn roots_that_are_apart_are_found(first in 0.0..0.1f64, gaps in prop::collection::vec(0.05..1.0f64, 1..8)) {
            let mut expected = vec![first];
            for gap in gaps {
                let last = expected[expected.len() - 1];
                expected.push(last + gap);
            }
            let mut c = [0.0; 9];
            c[0] = 1.0;
            for root in &expected {
                for power in (0..9).rev() {
                    let below = if power > 0 { c[power - 1] } else { 0.0 };
                    c[power] = below - root * c[power];
                }
            }
            let found = roots(&c, -1.0, 10.0);
            prop_assert_eq!(found.as_slice().len(), expected.len());
            for (a, b) in found.as_slice().iter().zip(expected) {
                prop_assert!((a - b).abs() < 1e-4, "{} {}", a, b);
            }
        }

        #[test]
        fn any_nine_numbers_give_an_answer(c in prop::array::uniform9(any::<f64>())) {
            prop_assert!(roots(&c, 0.0, 10.0).as_slice().len() <= 8);
        }
    }
}
