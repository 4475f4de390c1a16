//! Randomness that does not depend on the order of asking: every purpose has its own stream, every place its own value.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::ops::Range;

/// Scrambles 64 bits (splitmix64's finaliser, Steele et al. 2014).
pub fn scramble(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The stream of random numbers for one purpose of one seed.
pub fn stream(seed: u64, purpose: &str, index: u64) -> ChaCha8Rng {
    let name = purpose
        .bytes()
        .fold(seed, |state, byte| scramble(state ^ u64::from(byte)));
    ChaCha8Rng::seed_from_u64(scramble(name ^ scramble(index)))
}

/// A number in [0, 1) belonging to a lattice point.
pub fn lattice(seed: u64, x: i64, y: i64) -> f32 {
    let bits = scramble(seed ^ scramble(x as u64 ^ (y as u64).rotate_left(32)));
    (bits >> 40) as f32 / (1u64 << 24) as f32
}

/// A standard normal number.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A number in a range where chance has it so, otherwise 0.
pub fn maybe(rng: &mut ChaCha8Rng, chance: f64, range: Range<f64>) -> f64 {
    if rng.random_bool(chance) {
        rng.random_range(range)
    } else {
        0.0
    }
}

/// Seconds (not negative) to whole nanoseconds.
pub fn nanoseconds(seconds: f64) -> u64 {
    (seconds.max(0.0) * 1e9).round() as u64
}

/// From 0 to 1 without edges.
pub fn smooth(f: f32) -> f32 {
    f * f * (3.0 - 2.0 * f)
}

/// Smooth noise in the plane, 0 to 1, that changes over a distance of 1.
pub fn noise2(seed: u64, p: [f64; 2]) -> f32 {
    let low = p.map(f64::floor);
    let f = [0, 1].map(|axis| smooth((p[axis] - low[axis]) as f32));
    let [x, y] = low.map(|part| part as i64);
    let at = |dx: i64, dy: i64| lattice(seed, x + dx, y + dy);
    let mix = |a: f32, b: f32, f: f32| a + f * (b - a);
    let south = mix(at(0, 0), at(1, 0), f[0]);
    let north = mix(at(0, 1), at(1, 1), f[0]);
    mix(south, north, f[1])
}

/// Smooth noise in space.
pub fn noise3(seed: u64, [x, y, z]: [f32; 3]) -> f32 {
    let (low, f) = (z.floor(), smooth(z - z.floor()));
    let layer = |k: i64| {
        let seed = scramble(seed ^ (low as i64 + k) as u64);
        noise2(seed, [x, y].map(f64::from))
    };
    let (a, b) = (layer(0), layer(1));
    a + f * (b - a)
}
