//! Rows of payloads as columns, whatever their format.

use crate::buffers::{Node, Pool};
use crate::{DecodeError, Decoder};
use arrow::array::ArrayRef;
use arrow::datatypes::Fields;
use arrow::error::ArrowError;

/// How payloads of one message type are read.
pub(crate) trait Format: Send {
    /// Appends a payload as row `row` of the columns; on error they may hold part of it.
    fn append(
        &mut self,
        payload: &[u8],
        columns: &Columns,
        row: usize,
        pool: &mut Pool,
    ) -> Result<(), DecodeError>;
}

/// The columns of a message type, of which some are left out.
pub(crate) struct Columns {
    /// Column of each member, where it is projected.
    column_of: Vec<Option<usize>>,
    nodes: Vec<Node>,
}

impl Columns {
    /// The column of a member, where it is projected.
    pub(crate) fn get(&self, member: usize) -> Option<&Node> {
        self.nodes.get((*self.column_of.get(member)?)?)
    }
}

/// The decoder of one message type.
pub(crate) struct Rows<F> {
    format: F,
    columns: Columns,
    pool: Pool,
    rows: usize,
}

impl<F: Format> Rows<F> {
    /// A decoder of the members named by `projection`, indices into `fields` without repeats.
    pub(crate) fn new(format: F, fields: &Fields, projection: &[usize]) -> Self {
        let mut pool = Pool::default();
        let mut column_of = vec![None; fields.len()];
        let mut nodes = Vec::new();
        for index in projection {
            if let (Some(field), Some(column)) = (fields.get(*index), column_of.get_mut(*index)) {
                *column = Some(nodes.len());
                nodes.push(Node::new(field, &mut pool));
            }
        }
        Self {
            format,
            columns: Columns { column_of, nodes },
            pool,
            rows: 0,
        }
    }
}

impl<F: Format> Decoder for Rows<F> {
    fn push(&mut self, payload: &[u8]) -> Result<(), DecodeError> {
        let (columns, pool) = (&self.columns, &mut self.pool);
        if let Err(error) = self.format.append(payload, columns, self.rows, pool) {
            for node in &columns.nodes {
                node.truncate(pool, self.rows);
            }
            return Err(error);
        }
        self.rows += 1;
        Ok(())
    }

    fn len(&self) -> usize {
        self.rows
    }

    fn bytes(&self) -> usize {
        self.pool.bytes()
    }

    fn finish(&mut self) -> Result<Vec<ArrayRef>, ArrowError> {
        let rows = std::mem::take(&mut self.rows);
        let pool = &mut self.pool;
        let nodes = self.columns.nodes.iter();
        nodes.map(|node| node.finish(pool, rows)).collect()
    }
}
