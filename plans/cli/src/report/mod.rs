//! One self-contained page about a version of a map.

mod facts;
mod page;

pub use facts::{Facts, SessionFact, gather};
pub use page::page;
