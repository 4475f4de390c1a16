//! One MCAP file: its records, its index, its chunks. Knows object stores, not tables.

pub mod chunk;
pub mod index;
mod linear;
pub mod record;
mod summary;
pub(crate) mod window;
