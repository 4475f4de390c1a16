//! Tables of records that are no messages: `attachments`, `metadata`, and roles that metadata plays.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::{ArrayRef, RecordBatch};
use arrow::datatypes::SchemaRef;
use evermap_schemas::{Bytes, Fault, Record as _, Stamp, record};
use mcap::records::Record;

use crate::log::index::{Unit, UnitKind};
use crate::log::record::{nanoseconds, parse, split};
use crate::scan::rows::{MessageAt, RowBuilder, projected};
use crate::session::LogPart;

record! {
    /// One attachment.
    pub struct Attachment {
        /// Session of the log.
        session: String,
        /// Name of the attachment.
        name: String,
        /// What the bytes are.
        media_type: String,
        /// When it was recorded.
        log_time: Stamp,
        /// When it was made.
        create_time: Stamp,
        /// Number of bytes.
        size: u64,
        /// The bytes.
        data: Bytes,
    }
}

record! {
    /// One metadata record.
    pub struct Metadata {
        /// Session of the log.
        session: String,
        /// Name of the record.
        name: String,
        /// What it says.
        metadata: BTreeMap<String, String>,
    }
}

/// The columns of a table, from some records of a file.
pub(crate) type Columns =
    Box<dyn Fn(&LogPart, Vec<Record<'static>>) -> Result<Vec<ArrayRef>, Fault> + Send>;

/// Columns of `attachments`.
pub(crate) fn attachments(
    part: &LogPart,
    records: Vec<Record<'static>>,
) -> Result<Vec<ArrayRef>, Fault> {
    let rows = records.into_iter().filter_map(|record| match record {
        Record::Attachment { header, data, .. } => Some(Attachment {
            session: part.session.to_string(),
            name: header.name,
            media_type: header.media_type,
            log_time: Stamp(nanoseconds(header.log_time)),
            create_time: Stamp(nanoseconds(header.create_time)),
            size: data.len() as u64,
            data: Bytes(data.into_owned()),
        }),
        _ => None,
    });
    Attachment::encode_columns(rows.collect())
}

/// Columns of `metadata`.
pub(crate) fn metadata(
    part: &LogPart,
    records: Vec<Record<'static>>,
) -> Result<Vec<ArrayRef>, Fault> {
    let rows = records.into_iter().filter_map(|record| match record {
        Record::Metadata(found) => Some(Metadata {
            session: part.session.to_string(),
            name: found.name,
            metadata: found.metadata,
        }),
        _ => None,
    });
    Metadata::encode_columns(rows.collect())
}

/// Builds rows from records that are no messages.
pub(crate) struct RecordRows {
    part: Arc<LogPart>,
    schema: SchemaRef,
    projection: Vec<usize>,
    columns: Columns,
    records: Vec<Record<'static>>,
    bytes: usize,
}

impl RecordRows {
    /// A builder of the projected columns of a table.
    pub fn new(
        part: &Arc<LogPart>,
        schema: SchemaRef,
        projection: &[usize],
        columns: Columns,
    ) -> Self {
        Self {
            part: part.clone(),
            schema,
            projection: projection.to_vec(),
            columns,
            records: Vec::new(),
            bytes: 0,
        }
    }
}

impl RowBuilder for RecordRows {
    fn wants(&self, _: u16) -> bool {
        false
    }

    fn push(&mut self, _: &MessageAt<'_>) -> Result<(), String> {
        Ok(())
    }

    fn push_record(&mut self, unit: &Unit, record: &[u8]) -> Result<(), String> {
        let (opcode, body, _) = split(record).ok_or("a record that is cut")?;
        if self.bytes + body.len() > i32::MAX as usize {
            return Err("records beyond 2 GiB".to_owned());
        }
        let record = parse(opcode, body)?.into_owned();
        match (unit.kind, &record) {
            (UnitKind::Attachment, Record::Attachment { .. })
            | (UnitKind::Metadata, Record::Metadata(_)) => {}
            _ => return Err("expected a record of the kind that the index says".to_owned()),
        }
        self.records.push(record);
        self.bytes += body.len();
        Ok(())
    }

    fn rows(&self) -> usize {
        self.records.len()
    }

    fn bytes(&self) -> usize {
        self.bytes
    }

    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault> {
        self.bytes = 0;
        let columns = (self.columns)(&self.part, std::mem::take(&mut self.records))?;
        let rows = columns.first().map_or(0, |column| column.len());
        projected(&self.schema, &self.projection, rows, |column| {
            columns[column].clone()
        })
    }
}
