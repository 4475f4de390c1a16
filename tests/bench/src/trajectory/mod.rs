//! Alignment and errors of trajectories.
//!
//! A map may lie anywhere: before it is compared with the truth, one rigid motion ([`align`]) lays
//! it onto it. What is left is the *absolute* error ([`absolute_error`]). The *relative* error
//! ([`relative_error`]) needs no alignment: it compares how far the estimate and the truth moved
//! over the same distance.
//!
//! ```text
//! tum::read ── StampedPose ── associate ── PosePair ─┬─ align ── absolute_error
//!                                                    └─ relative_error
//! ```

mod alignment;
mod error;
mod pairs;
pub mod tum;

pub use alignment::{Similarity, align, align_points, align_points_scaled};
pub use error::{AbsoluteError, RelativeError, Statistics, absolute_error, relative_error};
pub use pairs::{PosePair, associate};
