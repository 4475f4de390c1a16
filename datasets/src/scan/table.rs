//! The tables of a set of logs, as DataFusion's planner sees them.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::{Arc, OnceLock};

use arrow::datatypes::{Field, Schema, SchemaRef};
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
use evermap_schemas::{Column, Fault};

use crate::fault::external;
use crate::log::index::{LogIndex, Unit};
use crate::scan::rows::RowBuilder;
use crate::scan::source::McapSource;
use crate::scan::topic::head_fields;
use crate::session::LogPart;

/// A table of MCAP files: which columns it has, and what makes its rows.
#[async_trait]
pub trait LogTable: Debug + Send + Sync {
    /// Name of the table.
    fn name(&self) -> &str;

    /// Its columns.
    fn schema(&self) -> SchemaRef;

    /// The topic whose messages it decodes; empty where there is not just one.
    fn topic(&self) -> &str {
        ""
    }

    /// Its columns of which a log's index knows something: when a message was recorded, on which topic, in which session and of
    /// which site.
    fn indexed_columns(&self) -> &'static [&'static str] {
        &["log_time", "topic", "session", "site"]
    }

    /// Whether a file has anything of it; others are not opened.
    fn is_in(&self, part: &LogPart) -> bool;

    /// The records that it reads instead of messages.
    fn records<'a>(&self, index: &'a LogIndex) -> Option<&'a [Unit]> {
        let _ = index;
        None
    }

    /// The builder of its rows from one file.
    ///
    /// # Errors
    /// A data fault when the file's messages cannot be decoded.
    async fn rows(
        &self,
        part: &Arc<LogPart>,
        projection: &[usize],
    ) -> Result<Box<dyn RowBuilder>, Fault>;
}

/// The Arrow schema of declared columns.
pub(crate) fn schema_of(columns: &[Column]) -> SchemaRef {
    let fields: Vec<Field> = columns.iter().map(Column::field).collect();
    Arc::new(Schema::new(fields))
}

/// A table over the files of a dataset, whose indexes are already read.
#[derive(Debug)]
pub struct McapTable {
    table: Arc<dyn LogTable>,
    parts: Vec<Arc<LogPart>>,
}

impl McapTable {
    /// A table over these files.
    pub fn new(table: Arc<dyn LogTable>, parts: &[Arc<LogPart>]) -> Self {
        let holds = |part: &&Arc<LogPart>| table.is_in(part);
        let parts = parts.iter().filter(holds).cloned().collect();
        Self { table, parts }
    }

    /// Files as DataFusion lists them, by store; each carries its index.
    fn files(&self) -> BTreeMap<String, (ObjectStoreUrl, FileGroup)> {
        let mut stores = BTreeMap::new();
        for part in &self.parts {
            let url = part.store_url.clone();
            let (_, group) = stores
                .entry(url.as_str().to_owned())
                .or_insert_with(|| (url, FileGroup::new(Vec::new())));
            let file = PartitionedFile::new_from_meta(part.meta.clone());
            group.push(file.with_extension(part.clone()));
        }
        stores
    }
}

#[async_trait]
impl TableProvider for McapTable {
    fn schema(&self) -> SchemaRef {
        self.table.schema()
    }

    fn table_type(&self) -> TableType {
        TableType::Base
    }

    /// One scan per object store, over all files of that store.
    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        _filters: &[Expr],
        limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let pool = state.runtime_env().memory_pool.clone();
        let source: Arc<dyn FileSource> = Arc::new(McapSource::new(
            self.table.clone(),
            TableSchema::from(self.schema()),
            pool,
        ));
        let mut scans: Vec<Arc<dyn ExecutionPlan>> = Vec::new();
        for (url, group) in self.files().into_values() {
            let groups = group.split_files(state.config().target_partitions());
            let config = FileScanConfigBuilder::new(url, source.clone())
                .with_file_groups(groups)
                .with_limit(limit)
                .with_projection_indices(projection.cloned())?
                .build();
            scans.push(DataSourceExec::from_data_source(config));
        }
        match (scans.len(), scans.pop()) {
            (1, Some(scan)) => Ok(scan),
            (_, Some(last)) => {
                scans.push(last);
                UnionExec::try_new(scans)
            }
            (_, None) => {
                let schema = match projection {
                    Some(columns) => Arc::new(self.schema().project(columns)?),
                    None => self.schema(),
                };
                Ok(Arc::new(EmptyExec::new(schema)))
            }
        }
    }
}

/// Makes a table.
type Make = dyn Fn() -> Result<Arc<dyn TableProvider>, Fault> + Send + Sync;

/// A table that is made when it is asked for: of the topics of a log, a query names few. Where it cannot be made,
/// scanning it yields the fault.
pub(crate) struct LazyTable {
    make: Box<Make>,
    made: OnceLock<Result<Arc<dyn TableProvider>, Fault>>,
}

impl LazyTable {
    /// A table that this makes.
    pub fn new(
        make: impl Fn() -> Result<Arc<dyn TableProvider>, Fault> + Send + Sync + 'static,
    ) -> Self {
        Self {
            make: Box::new(make),
            made: OnceLock::new(),
        }
    }

    fn table(&self) -> &Result<Arc<dyn TableProvider>, Fault> {
        self.made.get_or_init(|| (self.make)())
    }
}

impl Debug for LazyTable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.made.fmt(f)
    }
}

#[async_trait]
impl TableProvider for LazyTable {
    fn schema(&self) -> SchemaRef {
        match self.table() {
            Ok(table) => table.schema(),
            Err(_) => Arc::new(Schema::new(head_fields().to_vec())),
        }
    }

    fn table_type(&self) -> TableType {
        TableType::Base
    }

    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        filters: &[Expr],
        limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        match self.table() {
            Ok(table) => table.scan(state, projection, filters, limit).await,
            Err(fault) => Err(external(fault.clone())),
        }
    }
}
