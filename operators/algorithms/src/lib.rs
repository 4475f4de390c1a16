//! The mathematics of evermap, without Arrow, OpenCV, files or clocks.
//!
//! Pure functions and plain types: everything here is `Send + Sync`, gives the same answer on
//! every run and any number of threads, and can be tested with numbers alone.

pub mod camera;
pub mod drive;
pub mod ground;
pub mod pose;
pub mod tiles;
