//! MCAP as DataFusion tables.
//!
//! ```text
//!   McapTable ── scan ──► McapSource ── per file and byte range ──► units (chunks) that may matter
//!                            ▲ projection, filters, limit                   │ fetch, one ahead
//!                            │                                              ▼
//!                      FileScanConfig  ◄── batches, bounded in bytes ──  RowBuilder of the LogTable
//! ```
//!
//! What a table's rows are made of, its [`LogTable`] says; this module has those of topics and of the whole log.
//! A byte range of a file owns the chunks that start in it, so partitions share a file without sharing a chunk.
//! Within a partition, rows come chunk by chunk in file order and, inside a chunk, ordered by log time; an order
//! across chunks that overlap in time, or across partitions, is for a sort downstream to make.

mod messages;
mod plan;
mod records;
mod rows;
mod source;
mod stream;
mod table;
mod topic;
mod whole;

pub use rows::{MessageAt, RowBuilder};
pub use table::{FaultyTable, LogTable, McapTable};
pub use whole::WholeTable;

pub(crate) use plan::Wanted;
pub(crate) use records::RecordRows;
pub(crate) use rows::projected;
pub(crate) use stream::{Job, stream};
pub(crate) use table::schema_of;
pub(crate) use topic::TopicTable;

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
        DataFusionError::IoError(error) => Fault::resource(error.to_string()),
        DataFusionError::Internal(message) => Fault::bug(message.clone()),
        _ => Fault::data(error.strip_backtrace()),
    }
}
