//! A car park that somebody else's program simulated, with exact truth: mapped from its own images and odometry, taught,
//! and what perfect poses or people make of it.

mod floor;
mod lanes;
mod mapped;
mod page;
mod parking;
mod people;

use std::path::{Path, PathBuf};

use evermap_tests::shared;

/// The world, if it is there.
fn world() -> Option<PathBuf> {
    shared("worlds/carpark_small")
}

/// The log of one of its visits.
fn session(world: &Path, name: &str) -> PathBuf {
    world.join(name).join(format!("{name}.mcap"))
}
