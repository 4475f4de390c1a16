//! Payloads as rows, whatever their format.

use crate::DecodeError;
use crate::buffers::{Node, Pool};
use arrow::array::ArrayRef;
use arrow::datatypes::Fields;
use arrow::error::ArrowError;
use bytes::Bytes;

/// How payloads of one message type are read.
pub(crate) trait Format: Send {
    /// Appends a payload as row `row` of a message's columns; on error they may hold part of it.
    fn append(
        &mut self,
        payload: &[u8],
        message: &Node,
        row: usize,
        pool: &mut Pool,
    ) -> Result<(), DecodeError>;
}

/// Appends messages of one type as rows.
pub struct Decoder {
    format: Box<dyn Format>,
    message: Node,
    projection: Vec<usize>,
    pool: Pool,
    rows: usize,
}

impl Decoder {
    /// A decoder of the members named by `projection`, indices into `fields` without repeats.
    pub(crate) fn new(format: Box<dyn Format>, fields: &Fields, projection: Vec<usize>) -> Self {
        let mut pool = Pool::default();
        Self {
            format,
            message: Node::message(fields, &projection, &mut pool),
            projection,
            pool,
            rows: 0,
        }
    }

    /// Appends one message as a row; long binary values of it may be views that keep the whole of `block`, which the
    /// payload lies in. On error nothing is appended, and the decoder can go on.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn push_of(&mut self, block: &Bytes, payload: &[u8]) -> Result<(), DecodeError> {
        self.pool.set_source(Some(block));
        self.append(payload)
    }

    /// Appends one message as a row. On error nothing is appended, and the decoder can go on.
    ///
    /// # Errors
    /// [`DecodeError`] when the payload does not fit the schema, or the batch is full.
    pub fn push(&mut self, payload: &[u8]) -> Result<(), DecodeError> {
        self.pool.set_source(None);
        self.append(payload)
    }

    fn append(&mut self, payload: &[u8]) -> Result<(), DecodeError> {
        let (message, pool) = (&self.message, &mut self.pool);
        let appended = self.format.append(payload, message, self.rows, pool);
        match appended {
            Ok(()) => self.rows += 1,
            Err(_) => message.truncate(pool, self.rows),
        }
        appended
    }

    /// Rows so far.
    pub fn len(&self) -> usize {
        self.rows
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// Bytes held so far, roughly, so that batches can be bounded.
    pub fn bytes(&self) -> usize {
        self.pool.bytes()
    }

    /// The columns so far, in the order of the projection; the decoder is empty afterwards and can go on.
    ///
    /// # Errors
    /// Arrow's, if the columns break its rules (a fault of this crate).
    pub fn finish(&mut self) -> Result<Vec<ArrayRef>, ArrowError> {
        let rows = std::mem::take(&mut self.rows);
        let members = self.projection.iter().map(|at| self.message.member(*at));
        let columns = members.map(|member| member.finish(&mut self.pool, rows));
        let columns = columns.collect();
        self.pool.clear_shared();
        columns
    }
}
