//! Typed rows as the algorithms want them: what several operators read in the same way.

pub(crate) mod asking;
pub(crate) mod backbone;
pub(crate) mod bodies;
pub(crate) mod boxes;
pub(crate) mod calibrated;
pub(crate) mod camera_poses;
pub(crate) mod classifier;
pub(crate) mod danger;
pub(crate) mod drive;
pub(crate) mod floors;
pub(crate) mod frames;
pub(crate) mod graphs;
pub mod labels;
pub(crate) mod lenses;
pub mod masks;
pub(crate) mod outside;
pub mod painting;
pub(crate) mod people;
pub(crate) mod pixels;
pub(crate) mod rig;
pub(crate) mod samples;
pub(crate) mod spheres;
pub(crate) mod survey;
pub(crate) mod tiles;
