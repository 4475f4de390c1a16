//! Runs plans.
//!
//! ```text
//!  plan ─► program ─► units ─► runner (this process, or a cluster) ─► receipts ─► version
//!          stages     one per session, site or map                    artifacts
//! ```
//! | module | what |
//! |---|---|
//! | [`program`] | a checked plan as stages with scopes |
//! | [`run`] | the units of a run in dependency order; publishing |
//! | [`mod@unit`] | a self-contained piece of work and its receipt |
//! | [`build`] | a unit as one DataFusion plan |
//! | [`exec`] | the one `ExecutionPlan` that runs every operator |
//! | [`store`], [`version`], [`artifact`] | the map store |
//!
//! The engine knows operators only through the registry, never by name.

pub mod artifact;
mod assembly;
pub mod build;
#[cfg(feature = "cluster")]
pub mod cluster;
pub mod conform;
pub mod error;
pub mod exec;
pub mod explain;
mod fingerprint;
pub mod locality;
pub mod map;
pub mod needs;
mod pixels;
pub mod plan_test;
mod planned;
pub mod prepare;
pub mod previous;
pub mod program;
pub mod run;
pub mod runner;
pub mod sql;
pub mod store;
pub mod unit;
pub mod version;
