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

pub mod bal;
pub mod g2o;
pub mod planar;
pub mod relocation;
#[cfg(feature = "opencv")]
pub mod remap;
pub mod timing;
pub mod trajectory;

/// Why an example ends early.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;
