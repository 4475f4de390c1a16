//! Where in a map a view was taken, and how well a method tells.

mod evaluation;
#[cfg(test)]
mod tests;

pub use evaluation::{Distances, Evaluation, EvaluationOptions, evaluate};
