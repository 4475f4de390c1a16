//! The engine's own nodes of a DataFusion plan.

pub mod operator;
pub mod pixels;
pub mod planned;
