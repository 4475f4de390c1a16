//! The mathematics of evermap, without Arrow, OpenCV, files or clocks.
//!
//! Pure functions and plain types: everything here is `Send + Sync`, gives the same answer on
//! every run and any number of threads, and can be tested with numbers alone.

/// Lens models: rays from pixels and pixels from rays.
pub mod camera;
/// Keyframes at equal steps of driven path.
pub mod drive;
/// Images projected to cells of the ground plane.
pub mod ground;
/// Rigid transforms, checked at the door.
pub mod pose;
/// Lanes and intersections from driven positions.
pub mod road_network;
/// Tile addressing and exact integer sums.
pub mod tiles;

#[cfg(test)]
mod shared_data;
