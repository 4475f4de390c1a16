//! The engine's own nodes of a DataFusion plan.

pub mod node;
pub mod operator;
pub mod pixels;
pub mod planned;
mod raw;
#[cfg(test)]
mod tests;
