//! Runs plans.
//!
//! ```text
//!  plan ─► program ─► units ─► runner (this process, or a cluster) ─► receipts ─► version
//!          stages     one per session, site or map                    artifacts
//! ```
//! | module | what |
//! |---|---|
//! | [`program`] | a checked plan as stages with scopes |
//! | [`map`] | what a map keeps: artifacts, receipts, versions; and how it is read |
//! | [`nodes`] | the engine's own DataFusion nodes: the one that runs every operator |
//! | [`mod@unit`] | a self-contained piece of work, as one DataFusion plan |
//! | [`run`] | the units of a run in dependency order; publishing |
//! | [`cluster`] | many machines |
//!
//! Each may use those above it, none those below. The engine knows operators only through the registry, never by
//! name.

#[cfg(feature = "cluster")]
pub mod cluster;
pub mod conform;
pub mod digest;
pub mod erased;
pub mod error;
mod fingerprint;
mod locked;
pub mod map;
pub mod nodes;
pub mod plan_test;
pub mod preflight;
pub mod prepare;
pub mod program;
pub mod quoted;
pub mod run;
pub mod sql;
pub mod temporary;
pub mod unit;
