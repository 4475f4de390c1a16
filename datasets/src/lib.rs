//! MCAP logs as DataFusion tables, session manifests, converters.

pub mod log;
pub mod losses;
pub mod manifest;
pub mod scan;
pub mod session;
