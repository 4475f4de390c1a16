//! A map as its readers see it: layers as tables, versions, what changed between two, what may be forgotten.

pub mod artifact;
mod catalog;
pub mod columns;
mod context;
pub mod damage;
mod diff;
pub(crate) mod flat;
mod gc;
pub mod lease;
mod lineage;
mod local;
mod logs;
pub mod newest;
mod opened;
mod parameters;
mod parts;
pub mod receipt;
mod records;
mod rows;
mod sealed;
pub mod sound;
pub mod store;
mod table_function;
pub mod tables;
mod verify;
pub mod version;

pub use catalog::is_as_planned;
pub use diff::{Comparison, LayerDiff, documentation as diff_documentation};
pub use gc::{Collected, gc};
pub use lineage::{Origin, documentation as lineage_documentation, lineage};
pub(crate) use opened::make;
pub use opened::{Map, versions};
pub(crate) use records::{record_damage, record_name, record_version};
pub(crate) use rows::RUNS;
pub use rows::{LayerFile, LayerInfo, RunRow, VersionInfo};
pub use verify::{Finding, Remedy, Verified, verify};
