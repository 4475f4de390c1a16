//! Tables of records that are no messages: `attachments`, `metadata`, and roles that metadata plays.

use std::collections::BTreeMap;
use std::fmt::{Debug, Formatter};
use std::sync::Arc;

use arrow::array::{ArrayRef, RecordBatch};
use arrow::datatypes::SchemaRef;
use async_trait::async_trait;
use evermap_schemas::{Bytes, Fault, Record as _, Stamp, record};
use mcap::records::{Record, op};

use crate::log::heads::{AttachmentHead, HEAD};
use crate::log::index::{LogIndex, Unit, UnitKind};
use crate::log::metadata;
use crate::log::record::{parse, split};
use crate::scan::rows::{MessageAt, RowBuilder, projected};
use crate::scan::table::{LogTable, schema_of};
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

/// What is kept of a record.
enum LogRecord {
    /// What metadata says, and where it lies in the file.
    Metadata(u64, mcap::records::Metadata),
    /// What stands before an attachment's bytes, and these. Where they are not asked for there are none, nor is the
    /// checksum compared.
    Attachment(AttachmentHead, Vec<u8>),
}

/// The columns of a table, from some records of a file.
type Columns = Arc<dyn Fn(&LogPart, Vec<LogRecord>) -> Result<Vec<ArrayRef>, Fault> + Send + Sync>;

/// A table of records that are no messages.
#[derive(Clone)]
pub(crate) struct RecordTable {
    name: &'static str,
    schema: SchemaRef,
    /// Where the records lie.
    units: fn(&LogIndex) -> &[Unit],
    columns: Columns,
    /// The column without which heads of records will do; only attachments have one.
    body: Option<usize>,
}

impl RecordTable {
    /// `attachments`.
    pub fn attachments() -> Self {
        let schema = schema_of(&Attachment::columns());
        Self {
            name: "attachments",
            body: schema.index_of("data").ok(),
            schema,
            units: |index| &index.attachments,
            columns: Arc::new(|part, records| {
                let rows = records
                    .into_iter()
                    .filter_map(|found| attachment(part, found));
                Attachment::encode_columns(rows.collect())
            }),
        }
    }

    /// `metadata`.
    pub fn metadata() -> Self {
        let schema = schema_of(&Metadata::columns());
        Self::of_metadata("metadata", schema, |part, records| {
            let rows = records.map(|(_, found)| Metadata {
                session: part.session.to_string(),
                name: found.name,
                metadata: found.metadata,
            });
            Metadata::encode_columns(rows.collect())
        })
    }

    /// A table that is made of metadata records.
    pub fn of_metadata(
        name: &'static str,
        schema: SchemaRef,
        columns: impl Fn(&LogPart, &mut MetadataRecords) -> Result<Vec<ArrayRef>, Fault>
        + Send
        + Sync
        + 'static,
    ) -> Self {
        Self {
            name,
            schema,
            units: |index| &index.metadata,
            columns: Arc::new(move |part, records| columns(part, &mut metadata(records))),
            body: None,
        }
    }
}

/// Metadata records, one after the other, each with its place in the file.
pub(crate) type MetadataRecords = dyn Iterator<Item = (u64, mcap::records::Metadata)>;

impl Debug for RecordTable {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

#[async_trait]
impl LogTable for RecordTable {
    fn name(&self) -> &str {
        self.name
    }

    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    fn is_in(&self, part: &LogPart) -> bool {
        !(self.units)(&part.index).is_empty()
    }

    fn records<'a>(&self, index: &'a LogIndex) -> Option<&'a [Unit]> {
        Some((self.units)(index))
    }

    async fn rows(
        &self,
        part: &Arc<LogPart>,
        projection: &[usize],
    ) -> Result<Box<dyn RowBuilder>, Fault> {
        Ok(Box::new(RecordRows {
            table: self.clone(),
            part: part.clone(),
            projection: projection.to_vec(),
            heads: self.body.is_some_and(|body| !projection.contains(&body)),
            records: Vec::new(),
            bytes: 0,
        }))
    }
}

fn attachment(part: &LogPart, held: LogRecord) -> Option<Attachment> {
    let LogRecord::Attachment(head, data) = held else {
        return None;
    };
    Some(Attachment {
        session: part.session.to_string(),
        name: head.name,
        media_type: head.media_type,
        log_time: Stamp(head.log_time),
        create_time: Stamp(head.create_time),
        size: head.bytes,
        data: Bytes(data),
    })
}

fn metadata(records: Vec<LogRecord>) -> impl Iterator<Item = (u64, mcap::records::Metadata)> {
    records.into_iter().filter_map(|record| match record {
        LogRecord::Metadata(offset, found) => Some((offset, found)),
        LogRecord::Attachment(..) => None,
    })
}

/// What is kept of a record, all of whose body is there.
fn held(unit: &Unit, opcode: u8, body: &[u8]) -> Result<LogRecord, String> {
    match (unit.kind, opcode) {
        (UnitKind::Attachment, op::ATTACHMENT) => {
            let (head, data) = AttachmentHead::whole(body)?;
            return Ok(LogRecord::Attachment(head, data.to_vec()));
        }
        (UnitKind::Metadata, op::METADATA) => {
            metadata::check(body)?;
            if let Record::Metadata(found) = parse(opcode, body)? {
                return Ok(LogRecord::Metadata(unit.offset, found));
            }
        }
        _ => {}
    }
    Err("expected a record of the kind that the index says".to_owned())
}

/// Builds rows from records that are no messages.
struct RecordRows {
    table: RecordTable,
    part: Arc<LogPart>,
    projection: Vec<usize>,
    /// Whether heads of records will do.
    heads: bool,
    records: Vec<LogRecord>,
    bytes: usize,
}

impl RecordRows {
    fn push_head(&mut self, unit: &Unit, record: &[u8]) -> Result<(), String> {
        let head = AttachmentHead::parse(record).filter(|_| unit.kind == UnitKind::Attachment);
        let head = head.ok_or_else(|| {
            format!(
                "expected an attachment with a name in its first {HEAD} B, found another record"
            )
        })?;
        self.bytes += size_of::<Attachment>() + head.name.len() + head.media_type.len();
        self.records.push(LogRecord::Attachment(head, Vec::new()));
        Ok(())
    }
}

impl RowBuilder for RecordRows {
    fn wants(&self, _: u16) -> bool {
        false
    }

    fn push(&mut self, _: &MessageAt<'_>) -> Result<(), String> {
        Ok(())
    }

    fn record_bytes(&self) -> u64 {
        match self.heads {
            true => HEAD,
            false => u64::MAX,
        }
    }

    fn push_record(&mut self, unit: &Unit, record: &[u8]) -> Result<(), String> {
        if self.heads {
            return self.push_head(unit, record);
        }
        let (opcode, body, _) = split(record).ok_or("a record that is cut")?;
        if self.bytes + body.len() > i32::MAX as usize {
            return Err("records larger than 2 GiB".to_owned());
        }
        self.records.push(held(unit, opcode, body)?);
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
        let records = std::mem::take(&mut self.records);
        let columns = (self.table.columns)(&self.part, records)?;
        let rows = columns.first().map_or(0, |column| column.len());
        projected(&self.table.schema, &self.projection, rows, |at| {
            columns[at].clone()
        })
    }
}
