//! One self-contained page about a version of a map.

mod answers;
mod facts;

pub use facts::{Facts, gather};

#[cfg(test)]
mod tests;
