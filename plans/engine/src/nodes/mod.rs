//! The engine's own nodes of a DataFusion plan.

pub mod light;
pub mod node;
pub mod operator;
pub mod pixels;
pub mod planned;
pub mod python;
pub mod raw;
pub mod row_store;
mod spared;
#[cfg(test)]
mod tests;
pub mod weight;
