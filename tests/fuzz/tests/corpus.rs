//! Every input of the corpus, and many that are like it. The seed is printed; `EVERMAP_TEST_SEED` sets it.

#![allow(clippy::unwrap_used)]

use std::path::Path;

use evermap_fuzz::{TARGETS, Target};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Mutated inputs of each target, and of those that take longer.
const MUTATED: usize = 20_000;
const MUTATED_SLOWLY: usize = 2_000;
const SLOW: [&str; 2] = ["images", "queries"];

fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("corpus")
        .join(target);
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|file| file.unwrap().path())
        .collect();
    files.sort();
    files
        .iter()
        .map(|file| std::fs::read(file).unwrap())
        .collect()
}

/// An input with some bytes changed, left out, doubled, or taken from another one.
fn mutated(inputs: &[Vec<u8>], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = inputs[random.random_range(0..inputs.len())].clone();
    for _ in 0..random.random_range(1..6) {
        let place = random.random_range(0..=bytes.len());
        let end = (place + random.random_range(0..12)).min(bytes.len());
        match random.random_range(0..5) {
            0 if place < bytes.len() => bytes[place] = random.random(),
            1 if place < bytes.len() => bytes[place] ^= 1 << random.random_range(0..8),
            2 => drop(bytes.drain(place..end)),
            3 => {
                let piece = bytes[place..end].to_vec();
                bytes.splice(place..place, piece);
            }
            _ => {
                let other = &inputs[random.random_range(0..inputs.len())];
                let from = random.random_range(0..=other.len());
                let piece = other[from..(from + 16).min(other.len())].to_vec();
                bytes.splice(place..end, piece);
            }
        }
    }
    bytes
}

/// Gives a target its corpus, and what is like it.
fn fed(name: &str, target: Target, seed: u64) {
    let inputs = corpus(name);
    inputs.iter().for_each(|input| target(input));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let many = if SLOW.contains(&name) {
        MUTATED_SLOWLY
    } else {
        MUTATED
    };
    for _ in 0..many {
        target(&mutated(&inputs, &mut random));
    }
}

/// Each target in a thread of its own, whose name a panic tells.
#[test]
fn every_target_comes_back_from_the_corpus_and_what_is_like_it() {
    let seed = evermap_test_data::seed();
    std::thread::scope(|scope| {
        for (name, target) in TARGETS {
            let thread = std::thread::Builder::new().name(name.to_owned());
            thread
                .spawn_scoped(scope, move || fed(name, target, seed))
                .unwrap();
        }
    });
}
