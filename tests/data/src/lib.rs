//! What tests of several crates share: data of others, seeds, and, with the feature `stores`, stores of objects that are looked at.
//!
//! Data that others made (`../shared` beside the repository, or `EVERMAP_SHARED`) is never part of the project. A test
//! that needs what is not there says so and passes; where `EVERMAP_SKIP=never` is set, as in CI, it fails.

#![allow(clippy::print_stderr, clippy::panic)]

#[cfg(feature = "stores")]
pub mod stores;

use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// A path in the shared data; `None` where it is not there, and the test is to be skipped.
///
/// # Panics
/// As [`skipped`].
pub fn shared(path: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let root = std::env::var_os("EVERMAP_SHARED").map_or(beside, PathBuf::from);
    there(root.join(path), "set EVERMAP_SHARED")
}

/// A path; `None` where nothing is there, and the test is to be skipped. `next` says how it gets there.
///
/// # Panics
/// As [`skipped`].
pub fn there(path: PathBuf, next: &str) -> Option<PathBuf> {
    if path.exists() {
        return Some(path);
    }
    skipped(&format!("{} is not there; {next}", path.display()));
    None
}

/// Says that a test is skipped, and why.
///
/// # Panics
/// Where `EVERMAP_SKIP` is `never`.
pub fn skipped(why: &str) {
    let never = std::env::var("EVERMAP_SKIP").is_ok_and(|skip| skip == "never");
    assert!(!never, "EVERMAP_SKIP is never, and {why}");
    eprintln!("SKIPPED: {why}");
}

/// The seed of a random test: `EVERMAP_TEST_SEED`, which `.cargo/config.toml` sets, or another one in every run where a
/// test is not started by cargo. It is printed.
///
/// # Panics
/// Where `EVERMAP_TEST_SEED` is no number.
pub fn seed() -> u64 {
    let now = || {
        SystemTime::UNIX_EPOCH
            .elapsed()
            .map_or(0, |now| now.as_secs())
    };
    let seed = match std::env::var("EVERMAP_TEST_SEED") {
        Ok(text) => match text.parse() {
            Ok(seed) => seed,
            Err(_) => panic!("EVERMAP_TEST_SEED: expected a whole number, found {text}"),
        },
        Err(_) => now(),
    };
    eprintln!("seed: EVERMAP_TEST_SEED={seed}");
    seed
}
