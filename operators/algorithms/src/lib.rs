//! The mathematics of evermap, without Arrow, OpenCV, files or clocks.
//!
//! Pure functions and plain types: everything here is `Send + Sync`, gives the same answer on
//! every run and any number of threads, and can be tested with numbers alone.
//!
//! | module | what it knows |
//! |---|---|
//! | [`pose`] | rigid transforms, checked at the door |
//! | [`camera`] | lens models: rays from pixels and pixels from rays |
//! | [`drive`] | keyframes at equal steps of driven path |
//! | [`road_network`] | lanes and intersections from driven positions |
//! | [`ground`] | images projected to cells of the ground plane |
//! | [`tiles`] | tile addressing and exact integer sums |

pub mod camera;
pub mod drive;
pub mod ground;
pub mod pose;
pub mod road_network;
pub mod tiles;

#[cfg(test)]
mod shared_data;
