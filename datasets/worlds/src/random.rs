//! Randomness that does not depend on the order of asking: every purpose has its own stream.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

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
