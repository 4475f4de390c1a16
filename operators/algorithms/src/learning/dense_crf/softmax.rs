//! Probabilities from logarithms, eight classes at a time.

use crate::learning::permutohedral::Eight;

/// Below this the exponential counts as zero (2e-22): its products would lose themselves in subnormal numbers.
const LEAST: f32 = -50.0;

/// exp of a number from [`LEAST`] to 0, within 2 units in the last place: Cephes' polynomial. Plain arithmetic, the
/// same on every machine, and eight at a time.
#[inline(always)]
fn exp(x: f32) -> f32 {
    // The sum's last bits are the nearest integer: there is no room for a fraction.
    const ROOM: f32 = 12_582_912.0;
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    let shifted = x.mul_add(std::f32::consts::LOG2_E, ROOM);
    let whole = shifted - ROOM;
    let rest = whole.mul_add(-LN2_LOW, whole.mul_add(-LN2_HIGH, x));
    let mut polynomial = 1.987_569_1e-4;
    for coefficient in [
        1.398_2e-3,
        8.333_452e-3,
        4.166_579_6e-2,
        1.666_666_5e-1,
        0.5,
    ] {
        polynomial = rest.mul_add(polynomial, coefficient);
    }
    let small = polynomial.mul_add(rest * rest, rest) + 1.0;
    f32::from_bits(small.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// Combines eight numbers in a fixed order that vectors can follow.
#[inline(always)]
fn fold(eight: &[f32; 8], combine: impl Fn(f32, f32) -> f32) -> f32 {
    let four: [f32; 4] = std::array::from_fn(|i| combine(eight[i], eight[i + 4]));
    combine(combine(four[0], four[2]), combine(four[1], four[3]))
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Pixels that are worked on side by side, step by step: no pixel waits for the end of another one's sum.
const SIDE_BY_SIDE: usize = 16;

/// Turns the logarithms (up to a constant) of each pixel, one of which is not among the lanes, into probabilities that sum to
/// one. What is far below the rest becomes zero.
#[inline(always)]
pub(super) fn softmax<const K: usize>(pixels: &mut [[Eight; K]], spare: &mut [f32]) {
    let (spare, _) = spare.as_chunks_mut::<SIDE_BY_SIDE>();
    for (pixels, spare) in pixels.chunks_mut(SIDE_BY_SIDE).zip(spare) {
        let mut tops = *spare;
        for (lanes, top) in pixels.iter().zip(&mut tops) {
            *top = larger(*top, fold(&across(lanes, larger), larger));
        }
        let mut sums = [[0.0; 8]; SIDE_BY_SIDE];
        for ((lanes, top), sums) in pixels.iter_mut().zip(tops).zip(&mut sums) {
            for eight in lanes.iter_mut() {
                for value in &mut eight.0 {
                    *value = power(*value - top);
                }
            }
            *sums = across(lanes, |a, b| a + b);
        }
        let mut scales = [1.0; SIDE_BY_SIDE];
        for pixel in 0..SIDE_BY_SIDE {
            spare[pixel] = power(spare[pixel] - tops[pixel]);
            scales[pixel] = 1.0 / (fold(&sums[pixel], |a, b| a + b) + spare[pixel]);
            spare[pixel] *= scales[pixel];
        }
        for (lanes, scale) in pixels.iter_mut().zip(scales) {
            for eight in lanes {
                for value in &mut eight.0 {
                    *value *= scale;
                }
            }
        }
    }
}

/// The sum of all lanes.
#[inline(always)]
pub(super) fn sum<const K: usize>(lanes: &[Eight; K]) -> f32 {
    fold(&across(lanes, |a, b| a + b), |a, b| a + b)
}

/// Combines the vectors of a pixel, one after the other.
#[inline(always)]
fn across<const K: usize>(lanes: &[Eight; K], combine: impl Fn(f32, f32) -> f32) -> [f32; 8] {
    let mut all = lanes[0].0;
    for eight in &lanes[1..] {
        for (all, value) in all.iter_mut().zip(&eight.0) {
            *all = combine(*all, *value);
        }
    }
    all
}

/// [`exp`] of a number of at most 0; nothing below [`LEAST`].
#[inline(always)]
fn power(below: f32) -> f32 {
    let power = exp(larger(below, LEAST));
    if below > LEAST { power } else { 0.0 }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn exp_is_exact_to_the_last_bits(x in -50.0..0.0f32) {
            let exact = f64::from(x).exp();
            prop_assert!((f64::from(exp(x)) / exact - 1.0).abs() < 2.5e-7);
        }

        #[test]
        fn softmax_is_a_distribution(values in prop::array::uniform8(-200.0..200.0f32)) {
            let (mut pixels, mut spare) = ([[Eight(values), Eight([-1e30; 8])]; 20], [-1e30; 32]);
            softmax(&mut pixels, &mut spare);
            prop_assert!(pixels.iter().all(|pixel| *pixel == pixels[0]));
            let lanes = pixels[0];
            let top = values.iter().copied().fold(f32::MIN, f32::max);
            let sum: f64 = values.iter().map(|value| f64::from(value - top).exp()).sum();
            for (value, lane) in values.iter().zip(&lanes[0].0) {
                let exact = f64::from(value - top).exp() / sum;
                prop_assert!((f64::from(*lane) - exact).abs() < 1e-6);
            }
            prop_assert_eq!(lanes[1].0, [0.0; 8]);
        }
    }
}
