//! Rows of attachments without their bytes, which are not read.

use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use evermap_schemas::{Bytes, Fault, Record as _, Stamp};

use crate::log::heads::{AttachmentHead, HEAD};
use crate::log::index::{Unit, UnitKind};
use crate::scan::records::Attachment;
use crate::scan::rows::{MessageAt, RowBuilder, projected};
use crate::session::LogPart;

/// Builds rows from what stands before the bytes of attachments. Their checksums are not compared.
pub(crate) struct HeadRows {
    part: Arc<LogPart>,
    schema: SchemaRef,
    projection: Vec<usize>,
    heads: Vec<AttachmentHead>,
    bytes: usize,
}

impl HeadRows {
    /// A builder of these columns of `attachments`, of which `data` is none.
    pub fn new(part: &Arc<LogPart>, schema: &SchemaRef, projection: &[usize]) -> Self {
        Self {
            part: Arc::clone(part),
            schema: Arc::clone(schema),
            projection: projection.to_vec(),
            heads: Vec::new(),
            bytes: 0,
        }
    }
}

impl RowBuilder for HeadRows {
    fn wants(&self, _: u16) -> bool {
        false
    }

    fn push(&mut self, _: &MessageAt<'_>) -> Result<(), String> {
        Ok(())
    }

    fn record_bytes(&self) -> u64 {
        HEAD
    }

    fn push_record(&mut self, unit: &Unit, record: &[u8]) -> Result<(), String> {
        let head = AttachmentHead::parse(record).filter(|_| unit.kind == UnitKind::Attachment);
        let head = head.ok_or_else(|| {
            format!(
                "expected an attachment with a name in its first {HEAD} B, found another record"
            )
        })?;
        self.bytes += size_of::<Attachment>() + head.name.len() + head.media_type.len();
        self.heads.push(head);
        Ok(())
    }

    fn rows(&self) -> usize {
        self.heads.len()
    }

    fn bytes(&self) -> usize {
        self.bytes
    }

    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault> {
        self.bytes = 0;
        let heads = std::mem::take(&mut self.heads).into_iter();
        let rows: Vec<Attachment> = heads
            .map(|head| Attachment {
                session: self.part.session.to_string(),
                name: head.name,
                media_type: head.media_type,
                log_time: Stamp(head.log_time),
                create_time: Stamp(head.create_time),
                size: head.bytes,
                data: Bytes(Vec::new()),
            })
            .collect();
        let count = rows.len();
        let columns = Attachment::encode_columns(rows)?;
        projected(&self.schema, &self.projection, count, |at| {
            columns[at].clone()
        })
    }
}
