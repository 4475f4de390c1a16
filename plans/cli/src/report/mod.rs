//! One self-contained page about a version of a map.

pub mod answers;
mod facts;
pub mod metric;
mod page;
pub mod semantic;

pub use facts::{Facts, SessionFact, gather};
pub use page::page;
