//! The tables of a set of logs, as DataFusion's planner sees them.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use async_trait::async_trait;
use datafusion::catalog::{Session, TableProvider};
use datafusion::datasource::listing::PartitionedFile;
use datafusion::datasource::physical_plan::{FileGroup, FileScanConfigBuilder, FileSource};
use datafusion::datasource::source::DataSourceExec;
use datafusion::datasource::table_schema::TableSchema;
use datafusion::error::Result;
use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::logical_expr::{Expr, TableType};
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_plan::empty::EmptyExec;
use datafusion::physical_plan::union::UnionExec;
use evermap_schemas::Fault;

use crate::log::index::{LogIndex, Unit};
use crate::losses::LossLedger;
use crate::roles::RoleScan;
use crate::scan::external;
use crate::scan::rows::RowBuilder;
use crate::scan::source::McapSource;
use crate::scan::topic::{TopicRows, head_fields, topic_schema};
use crate::scan::whole::{
    AttachmentRows, MessageRows, MetadataRows, attachments_schema, messages_schema, metadata_schema,
};
use crate::session::LogPart;

/// Which table a scan of MCAP files yields.
#[derive(Debug, Clone)]
pub enum LogTable {
    /// The messages of one topic, decoded.
    Topic(Arc<str>),
    /// All messages, with their payloads as bytes.
    Messages,
    /// Attachment records.
    Attachments,
    /// Metadata records.
    Metadata,
    /// A role: frames, odometry, calibration or transforms.
    Role(RoleScan),
}

impl LogTable {
    /// Name of the table.
    pub fn name(&self) -> &str {
        match self {
            LogTable::Topic(topic) => topic,
            LogTable::Messages => "messages",
            LogTable::Attachments => "attachments",
            LogTable::Metadata => "metadata",
            LogTable::Role(scan) => scan.role.name(),
        }
    }

    /// The table's schema over these files.
    ///
    /// # Errors
    /// As [`topic_schema`].
    pub fn schema(&self, parts: &[Arc<LogPart>]) -> Result<SchemaRef, Fault> {
        match self {
            LogTable::Topic(topic) => topic_schema(topic, parts),
            LogTable::Messages => Ok(messages_schema()),
            LogTable::Attachments => Ok(attachments_schema()),
            LogTable::Metadata => Ok(metadata_schema()),
            LogTable::Role(scan) => Ok(scan.role.layer().schema()),
        }
    }

    /// The topic whose messages this table decodes; empty where there is not just one.
    pub(crate) fn topic(&self) -> &str {
        match self {
            LogTable::Topic(topic) => topic,
            _ => "",
        }
    }

    /// The records that this table reads instead of messages.
    pub(crate) fn records<'a>(&self, index: &'a LogIndex) -> Option<&'a [Unit]> {
        match self {
            LogTable::Attachments => Some(&index.attachments),
            LogTable::Metadata => Some(&index.metadata),
            _ => None,
        }
    }

    /// The builder of this table's rows from one file.
    pub(crate) fn rows(
        &self,
        part: &Arc<LogPart>,
        schema: &SchemaRef,
        projection: &[usize],
    ) -> Result<Box<dyn RowBuilder>, Fault> {
        Ok(match self {
            LogTable::Topic(topic) => Box::new(TopicRows::new(topic, part, schema, projection)?),
            LogTable::Messages => Box::new(MessageRows::new(part, projection)),
            LogTable::Attachments => Box::new(AttachmentRows::new(part, projection)),
            LogTable::Metadata => Box::new(MetadataRows::new(part, projection)),
            LogTable::Role(scan) => scan.rows(part, projection)?,
        })
    }
}

/// A table over the files of a dataset, whose indexes are already read.
#[derive(Debug)]
pub struct McapTable {
    table: LogTable,
    parts: Vec<Arc<LogPart>>,
    schema: SchemaRef,
    losses: LossLedger,
}

impl McapTable {
    /// A table over these files; those that hold nothing of it are not opened.
    ///
    /// # Errors
    /// As [`LogTable::schema`].
    pub fn new(table: LogTable, parts: &[Arc<LogPart>], losses: LossLedger) -> Result<Self, Fault> {
        let holds = |part: &&Arc<LogPart>| match &table {
            LogTable::Topic(topic) => part.index.channels_of(topic).next().is_some(),
            table => table.records(&part.index).is_none_or(|r| !r.is_empty()),
        };
        let parts: Vec<_> = parts.iter().filter(holds).cloned().collect();
        Ok(Self {
            schema: table.schema(&parts)?,
            table,
            parts,
            losses,
        })
    }
}

/// Files as DataFusion lists them, by store; each carries its index.
pub(crate) fn files(parts: &[Arc<LogPart>]) -> BTreeMap<String, (ObjectStoreUrl, FileGroup)> {
    let mut stores = BTreeMap::new();
    for part in parts {
        let url = part.store_url.clone();
        let (_, group) = stores
            .entry(url.as_str().to_owned())
            .or_insert_with(|| (url, FileGroup::new(Vec::new())));
        let file = PartitionedFile::new_from_meta(part.meta.clone());
        group.push(file.with_extension(part.clone()));
    }
    stores
}

#[async_trait]
impl TableProvider for McapTable {
    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    fn table_type(&self) -> TableType {
        TableType::Base
    }

    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        _filters: &[Expr],
        limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        scan_parts(
            self.table.clone(),
            &self.schema,
            &self.parts,
            self.losses.clone(),
            state,
            projection,
            limit,
        )
    }
}

/// The scan of a table over files: one per object store, all files of a store in one.
pub(crate) fn scan_parts(
    table: LogTable,
    schema: &SchemaRef,
    parts: &[Arc<LogPart>],
    losses: LossLedger,
    state: &dyn Session,
    projection: Option<&Vec<usize>>,
    limit: Option<usize>,
) -> Result<Arc<dyn ExecutionPlan>> {
    let pool = state.runtime_env().memory_pool.clone();
    let source = McapSource::new(table, TableSchema::from(schema.clone()), losses);
    let source: Arc<dyn FileSource> = Arc::new(source.with_pool(pool));
    let mut scans: Vec<Arc<dyn ExecutionPlan>> = Vec::new();
    for (_, (url, group)) in files(parts) {
        let groups = group.split_files(state.config().target_partitions());
        let config = FileScanConfigBuilder::new(url, source.clone())
            .with_file_groups(groups)
            .with_limit(limit)
            .with_projection_indices(projection.cloned())?
            .build();
        scans.push(DataSourceExec::from_data_source(config));
    }
    match scans.len() {
        0 => {
            let schema = match projection {
                Some(columns) => Arc::new(schema.project(columns)?),
                None => schema.clone(),
            };
            Ok(Arc::new(EmptyExec::new(schema)))
        }
        1 => scans
            .pop()
            .ok_or_else(|| external(Fault::bug("no scan left"))),
        _ => UnionExec::try_new(scans),
    }
}

/// A table that cannot be read: scanning it yields the fault.
#[derive(Debug)]
pub struct FaultyTable {
    fault: Fault,
}

impl FaultyTable {
    /// A table that yields this fault.
    pub fn new(fault: Fault) -> Self {
        Self { fault }
    }
}

#[async_trait]
impl TableProvider for FaultyTable {
    fn schema(&self) -> SchemaRef {
        Arc::new(arrow::datatypes::Schema::new(head_fields().to_vec()))
    }

    fn table_type(&self) -> TableType {
        TableType::Base
    }

    async fn scan(
        &self,
        _state: &dyn Session,
        _projection: Option<&Vec<usize>>,
        _filters: &[Expr],
        _limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        Err(external(self.fault.clone()))
    }
}
