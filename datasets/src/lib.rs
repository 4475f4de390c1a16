//! MCAP logs as DataFusion tables, session manifests, converters.
//!
//! ```text
//!   files, globs, URLs ─┐
//!   session manifest ───┴─► Dataset ── register ──► "/odom" …, messages, channels, sessions, attachments, metadata
//!                             │                      frames, odometry, calibration, transforms
//!                             ├── losses: what could not be read
//!                             └── images: references of frames ──► bytes
//! ```
//!
//! Logs are read by ranges of their object store, chunk by chunk; a log without a usable index is read once from its
//! start to make one. This crate knows no operators and no plans.

mod dataset;
mod images;
pub mod import;
mod listing;
pub mod log;
pub mod losses;
pub mod manifest;
pub mod roles;
pub mod scan;
pub mod session;
mod stores;

pub use dataset::Dataset;
pub use images::ImageReader;
pub use losses::{Loss, LossLedger, Reason};
pub use manifest::{Manifest, Roles};
pub use session::{LogPart, Session};
