//! What an operator is.
//!
//! An operator has parameters, named input [`Port`]s, one output layer, and [`Work`] in one of three shapes. It never
//! sees the engine: it is given rows and gives rows back.
//!
//! ```text
//!                 ┌──────────── Map ────────────┐   rows ──► rows             any split of the rows is as good
//!   driving port ─┼──────────── Group ──────────┤   one key's rows, in order ──► rows
//!                 └──────────── Fold ───────────┘   lift ──► merge ──► finish; merging is exactly associative
//!   other ports  ──►  Sides: whole tables, given before the first row; of those that are fetched, a row at a time
//! ```
//!
//! The *driving* port is the first one. How much of it a kernel must see at once is the work's [`Shape`]; what a kernel
//! is given is always of one site. A kernel is a pure, deterministic function of rows, sides and parameters: no clock,
//! no files, no logging, no randomness without a seed. [`laws`] holds every registered operator to that.
//!
//! Operators are written with [`Work`]'s constructors; engines run them as [`Job`]s.

mod emit;
mod file;
mod fold;
mod job;
mod kernel;
pub mod laws;
mod naive;
mod operator;
mod page;
mod params;
mod port;
mod reference;
mod registry;
mod row_store;
mod sides;
mod table;
mod work;

pub use emit::{Emit, Losses};
pub use file::GivenFile;
pub use fold::{Fold, StateRow};
pub use job::{Driving, Job, Phase, Worker};
pub use operator::{NothingToChoose, Operator};
pub use page::{Example, Page};
pub use params::{ParamFault, Parameter};
pub use port::{Key, Port, Reach, pixels_column};
pub use registry::{Entry, Registry};
pub use row_store::{FetchedRows, InMemory, RowStore, catalogue};
pub use sides::{Pixels, Sides};
pub use work::{Reason, Shape, Stream, Work};

pub use evermap_schemas::{Fault, Kind, Layer, LayerRow};
