//! MCAP logs as DataFusion tables, session manifests, converters.
//!
//! ```text
//!   files, globs, URLs ─┐
//!   session manifest ───┴─► Recordings ── open ──► Dataset ── register ──► a table for each topic and each role,
//!                                                    │                      messages, channels, sessions, …
//!                                                    ├── losses: what could not be read
//!                                                    └── images: references of frames ──► bytes
//! ```
//!
//! Logs are read by ranges of their object store, chunk by chunk; a log without a usable index is read once from its
//! start to make one. This crate knows no operators and no plans.

pub mod address;
mod dataset;
mod escapes;
pub mod fault;
mod images;
pub mod import;
mod listing;
pub mod log;
pub mod losses;
pub mod manifest;
pub mod recordings;
mod roles;
pub mod scan;
pub mod session;
mod stores;
mod yaml;

pub use dataset::Dataset;
pub use evermap_messages::ros2;
pub use evermap_recording::{
    Goes, LogWriter, Times, annotations, finish_folder, parent, recorder_of, unfinished_file,
    unfinished_folder,
};
pub use images::ImageReader;
pub use losses::{Loss, LossLedger, Reason};
pub use manifest::{Manifest, Roles};
pub use recordings::{Recording, Recordings};
pub use session::{LogPart, Session};
pub use stores::{LogFile, no_file, read_at_most, read_bytes, read_text, without_mark};
