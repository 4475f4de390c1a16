//! The tables over a whole log: `messages`, `attachments`, `metadata`.

use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use async_trait::async_trait;
use evermap_schemas::{Fault, Record};

use crate::log::index::{LogIndex, Unit};
use crate::scan::messages::{MessageRows, messages_schema};
use crate::scan::records::{self, RecordRows};
use crate::scan::rows::RowBuilder;
use crate::scan::table::{LogTable, schema_of};
use crate::session::LogPart;

/// A table over a whole log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WholeTable {
    /// All messages, with their payloads as bytes.
    Messages,
    /// Attachment records.
    Attachments,
    /// Metadata records.
    Metadata,
}

impl WholeTable {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Messages, Self::Attachments, Self::Metadata];

    /// Name of the table.
    pub const fn table_name(self) -> &'static str {
        match self {
            Self::Messages => "messages",
            Self::Attachments => "attachments",
            Self::Metadata => "metadata",
        }
    }
}

#[async_trait]
impl LogTable for WholeTable {
    fn name(&self) -> &str {
        self.table_name()
    }

    fn schema(&self) -> SchemaRef {
        match self {
            Self::Messages => messages_schema(),
            Self::Attachments => schema_of(&records::Attachment::columns()),
            Self::Metadata => schema_of(&records::Metadata::columns()),
        }
    }

    fn is_in(&self, part: &LogPart) -> bool {
        self.records(&part.index).is_none_or(|r| !r.is_empty())
    }

    fn records<'a>(&self, index: &'a LogIndex) -> Option<&'a [Unit]> {
        match self {
            Self::Messages => None,
            Self::Attachments => Some(&index.attachments),
            Self::Metadata => Some(&index.metadata),
        }
    }

    async fn rows(
        &self,
        part: &Arc<LogPart>,
        projection: &[usize],
    ) -> Result<Box<dyn RowBuilder>, Fault> {
        let columns: records::Columns = match self {
            Self::Messages => return Ok(Box::new(MessageRows::new(part, projection))),
            Self::Attachments => Box::new(records::attachments),
            Self::Metadata => Box::new(records::metadata),
        };
        let rows = RecordRows::new(part, self.schema(), projection, columns);
        Ok(Box::new(rows))
    }
}
