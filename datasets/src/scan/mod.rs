//! MCAP as DataFusion tables.
//!
//! ```text
//!   McapFormat ── file_source ──► McapSource ── per file and byte range ──► units (chunks) that may matter
//!                                   ▲ projection, filters, limit                      │ fetch, one ahead
//!                                   │                                                 ▼
//!                            FileScanConfig  ◄── batches, bounded in bytes ──  RowBuilder of the table
//! ```
//!
//! A byte range of a file owns the chunks that start in it, so partitions share a file without sharing a chunk.
//! Within a partition, rows come chunk by chunk in file order and, inside a chunk, ordered by log time; an order
//! across chunks that overlap in time, or across partitions, is for a sort downstream to make.

mod format;
mod plan;
mod rows;
mod source;
mod stream;
mod table;
mod topic;
mod whole;

pub use format::McapFormat;
pub use rows::{MessageAt, RowBuilder};
pub use source::McapSource;
pub use table::{FaultyTable, LogTable, McapTable};
pub use topic::topic_schema;

pub(crate) use plan::Wanted;
pub(crate) use stream::{Job, stream};
pub(crate) use table::scan_parts;
pub(crate) use topic::timestamp;
pub(crate) use whole::{append_map, text_map_builder, text_map_type};

use datafusion::error::DataFusionError;
use evermap_schemas::Fault;

/// A fault inside DataFusion; [`fault_of`] takes it out again.
pub(crate) fn external(fault: Fault) -> DataFusionError {
    DataFusionError::External(Box::new(fault))
}

/// The fault inside a DataFusion error; an error that is not ours becomes a fault of the kind that it tells.
pub fn fault_of(error: &DataFusionError) -> Fault {
    let mut cause: Option<&dyn std::error::Error> = Some(error);
    while let Some(error) = cause {
        if let Some(fault) = error.downcast_ref::<Fault>() {
            return fault.clone();
        }
        cause = error.source();
    }
    match error.find_root() {
        DataFusionError::ResourcesExhausted(message) => Fault::resource(message.clone()),
        DataFusionError::SQL(..) | DataFusionError::Plan(_) | DataFusionError::SchemaError(..) => {
            Fault::user(error.strip_backtrace())
        }
        DataFusionError::ObjectStore(error) => Fault::resource(error.to_string()),
        DataFusionError::Internal(message) => Fault::bug(message.clone()),
        _ => Fault::data(error.strip_backtrace()),
    }
}
