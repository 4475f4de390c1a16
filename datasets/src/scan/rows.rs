//! From messages to record batches: what a table's rows are made of.

use std::sync::Arc;

use arrow::array::{ArrayRef, RecordBatch, RecordBatchOptions};
use arrow::datatypes::SchemaRef;
use evermap_schemas::Fault;

use crate::log::chunk::Block;
use crate::log::index::Unit;
use crate::log::record::MessageHead;
use crate::session::LogPart;

/// A message, and where it came from.
pub struct MessageAt<'a> {
    /// The file.
    pub part: &'a LogPart,
    /// The chunk, decompressed, or what of it is in memory.
    pub block: &'a Block,
    /// Channel number, sequence and times.
    pub head: MessageHead,
    /// First byte of the payload in all records of the block.
    pub at: u64,
    /// The payload.
    pub payload: &'a [u8],
    /// Whether values may be views that keep the block: it is all in memory, and at least half of it is messages of the
    /// table.
    pub shares: bool,
}

/// Turns the messages (or other records) of one file into the rows of one table.
///
/// A builder knows the projection; its batches have exactly the projected columns.
pub trait RowBuilder: Send {
    /// Whether payloads are decoded; else they are taken as they lie in the file.
    fn decodes(&self) -> bool {
        true
    }

    /// Whether messages of this channel become rows.
    fn wants(&self, channel: u16) -> bool;

    /// Takes a message. On error nothing was added.
    ///
    /// # Errors
    /// In words, when the payload does not fit its schema: the message is then counted as lost.
    fn push(&mut self, message: &MessageAt<'_>) -> Result<(), String>;

    /// Bytes from the start of a record that is no message that it takes.
    fn record_bytes(&self) -> u64 {
        u64::MAX
    }

    /// Takes a record that is no message (an attachment, a metadata record), or its first bytes.
    ///
    /// # Errors
    /// In words, when the record is damaged.
    fn push_record(&mut self, unit: &Unit, record: &[u8]) -> Result<(), String> {
        let _ = (unit, record);
        Ok(())
    }

    /// Rows held.
    fn rows(&self) -> usize;

    /// Bytes held, about.
    fn bytes(&self) -> usize;

    /// The rows so far, as batches that are not empty; the builder starts anew.
    ///
    /// # Errors
    /// A fault of ours, or of a value that no layer can hold.
    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault>;
}

/// A batch of the projected columns of a table, unless there are no rows; `column` makes each.
pub(crate) fn projected(
    schema: &SchemaRef,
    projection: &[usize],
    rows: usize,
    column: impl FnMut(usize) -> ArrayRef,
) -> Result<Vec<RecordBatch>, Fault> {
    if rows == 0 {
        return Ok(Vec::new());
    }
    let columns = projection.iter().copied().map(column).collect();
    let options = RecordBatchOptions::new().with_row_count(Some(rows));
    let schema = Arc::new(schema.project(projection)?);
    let batch = RecordBatch::try_new_with_options(schema, columns, &options)?;
    Ok(vec![batch])
}
