//! One MCAP file: its records, its index, its chunks. Knows object stores, not tables.

pub(crate) mod census;
pub(crate) mod checksum;
pub mod chunk;
mod collector;
pub mod definition;
pub mod heads;
pub mod index;
mod linear;
pub(crate) mod metadata;
pub mod pace;
pub mod record;
mod summary;
mod survey;
pub(crate) mod tally;
pub mod unpack;
pub(crate) mod walk;
pub(crate) mod window;
