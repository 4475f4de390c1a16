//! What exists for benchmarks and tests alone: files of the field's benchmarks, and measures of accuracy.
//!
//! | module | what it knows |
//! |---|---|
//! | [`bal`] | "bundle adjustment in the large": files, its camera, and its problems solved |
//! | [`g2o`] | pose graphs from files |
//! | [`planar`] | pose graphs on the plane |
//! | [`relocation`] | how well a method tells places apart |
//! | `remap` | OpenCV's resampling by look-up table, where the feature `opencv` is asked for |
//! | [`timing`] | how long something takes |
//! | [`trajectory`] | alignment and errors of trajectories |
//!
//! The programs in `examples/` are what `tests/peers` and `BENCHMARKS.md` run.
//!
//! Data that others made (`../shared` beside the repository, or `EVERMAP_SHARED`) is never part of the project: see
//! [`shared`].

pub mod bal;
pub mod g2o;
pub mod planar;
pub mod relocation;
#[cfg(feature = "opencv")]
pub mod remap;
pub mod timing;
pub mod trajectory;

use std::path::{Path, PathBuf};

/// Why an example ends early.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;

/// A path in the shared data; `None`, loudly, where it is not there. A test that needs it passes then.
#[allow(clippy::print_stderr)]
pub fn shared(path: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let root = std::env::var_os("EVERMAP_SHARED").map_or(beside, PathBuf::from);
    let full = root.join(path);
    if full.exists() {
        return Some(full);
    }
    eprintln!(
        "SKIPPED: {} is not there; set EVERMAP_SHARED",
        full.display()
    );
    None
}
