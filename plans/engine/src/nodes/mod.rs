//! The engine's own nodes of a DataFusion plan.

mod netpbm;
pub mod node;
pub mod operator;
pub mod pixels;
pub mod planned;
#[cfg(test)]
mod tests;
