//! How well a method tells places apart, and indexes that answer what paper 2 asks of a map's views.
//!
//! The measures are for any method ([`evaluate`]). The indexes are those of the paper's content requests; maps answer
//! them by SQL on their layers instead.

mod count_index;
mod evaluation;
mod scales;
#[cfg(test)]
mod tests;

pub use count_index::{CountIndex, like};
pub use evaluation::{Distances, Evaluation, EvaluationOptions, evaluate};
pub use scales::estimate_scales;
