//! The mathematics of evermap, without Arrow, OpenCV, files or clocks.
//!
//! Pure functions and plain types: everything here is `Send + Sync`, gives the same answer on
//! every run and any number of threads, and can be tested with numbers alone.
//!
//! | family | what it knows |
//! |---|---|
//! | [`geometry`] | rigid motions, lenses, and cameras fixed to a vehicle |
//! | [`ground`] | what lies on the ground: images projected onto it, tiles of it, roads on it |
//! | [`labels`] | what people say about a map, folded together, and tied to the poses that saw it |
//! | [`learning`] | pixels told apart by classifiers that are learnt, and labels that follow the edges of images |
//! | [`metric_map`] | from features of images to poses and landmarks, and back to a pose in them |
//! | [`semantic_map`] | what views show, as graphs of areas; how alike two views are, and places found again by it |
//! | [`solving`] | least squares, what hangs together, and repeatable random numbers |

pub mod geometry;
pub mod ground;
pub mod labels;
pub mod learning;
pub mod metric_map;
mod processor;
pub mod semantic_map;
pub mod solving;
