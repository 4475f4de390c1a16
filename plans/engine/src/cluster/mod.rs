//! Many machines: Ballista runs the units.
//!
//! A wave of ready units is one map-only job: the SQL function `run_unit` over an in-memory manifest with one partition a
//! unit. Nothing is shuffled, and Ballista's answer is not what counts: a unit is done when its receipt is in the map store.
//! So a lost executor, a lost job or a restarted scheduler costs a resubmission of what is missing, and can never
//! change an answer. Jobs that are given up, or whose run was stopped, are
//! cancelled; the units of a run whose lease has ended are not begun. How far units have come is noted among the map's
//! temporary files: what an executor is at work on, as another run gave it up, is waited for and not sent again.
//!
//! ```text
//!   ready units ──► job ──► executors ──► artifacts, receipts ──► map store
//!        ▲                                                            │ polled
//!        └────────── resubmit what is missing ◄── job ended or lost ◄─┘
//! ```

mod job;
mod note;
mod runner;
mod scheduler;
mod serve;

pub use runner::ClusterRunner;
pub use serve::{ExecutorOptions, executor, scheduler};
