//! What an operator is.
//!
//! An operator has parameters, named input [`Port`]s, one output layer, and a pure kernel in one of three shapes.
//! It never sees the engine: it is given batches and gives batches back.
//!
//! ```text
//!                 ┌──────────── Map ────────────┐   batch ──► rows           any split of the rows is as good
//!   driving port ─┼──────────── Group ──────────┤   one key's rows, in order ──► rows
//!                 └──────────── Fold ───────────┘   lift ──► merge ──► finish; merging is exactly associative
//!   other ports  ──►  Sides: whole tables, given before the first row
//! ```
//!
//! The *driving* port is the first one. How much of it a kernel must see at once is its [`Grain`]. A kernel is a
//! pure, deterministic function of rows, sides and parameters: no clock, no files, no logging, no randomness without
//! a seed. [`laws`] holds every registered operator to that.

mod emit;
mod fold;
mod kernel;
pub mod laws;
mod operator;
mod page;
mod port;
mod reference;
mod registry;
mod table;

pub use emit::{Emit, Losses};
pub use fold::{Fold, FoldKernel, Lifter, StateRow, fold};
pub use kernel::{
    Group, GroupKernel, Kernel, MapKernel, Mapper, Sides, group_whole, runs_of_equal, same_group,
};
pub use operator::Operator;
pub use page::{Example, Page};
pub use port::{Grain, Port};
pub use registry::{Entry, Registry};

pub use evermap_schemas::{Fault, Kind, Layer, LayerRow};
