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
//! Within a partition, rows come chunk by chunk in file order and, inside a chunk, ordered by log time (of a chunk that
//! does not fit into memory, inside each of its portions); an order across chunks that overlap in time, or across partitions, is for a sort downstream to make.

mod messages;
mod plan;
mod portions;
mod records;
mod rows;
mod source;
mod strays;
mod stream;
mod stretch;
mod table;
mod topic;
mod worker;

pub use messages::MessagesTable;
pub use rows::{MessageAt, RowBuilder};
pub use source::scanned;
pub use table::{LogTable, McapTable};

pub(crate) use plan::ScanRequest;
pub(crate) use records::RecordTable;
pub(crate) use rows::projected;
pub(crate) use stream::{Job, ScanMetrics, stream};
pub(crate) use table::{LazyTable, schema_of};
pub(crate) use topic::TopicTable;
