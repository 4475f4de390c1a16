//! One self-contained page about a version of a map.

mod facts;
pub mod metric;
mod page;

pub use facts::{Facts, SessionFact, gather};
pub use page::page;
