//! The file source: what DataFusion asks for while it plans and opens a scan.

use std::fmt;
use std::sync::Arc;

use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::TreeNodeRecursion;
use datafusion::datasource::listing::PartitionedFile;
use datafusion::datasource::physical_plan::{
    FileOpenFuture, FileOpener, FileScanConfig, FileSource,
};
use datafusion::datasource::projection::{ProjectionOpener, SplitProjection};
use datafusion::datasource::table_schema::TableSchema;
use datafusion::error::Result;
use datafusion::execution::memory_pool::MemoryPool;
use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::physical_expr::projection::ProjectionExprs;
use datafusion::physical_expr::{PhysicalExpr, conjunction};
use datafusion::physical_plan::DisplayFormatType;
use datafusion::physical_plan::filter_pushdown::{FilterPushdownPropagation, PushedDown};
use datafusion::physical_plan::metrics::ExecutionPlanMetricsSet;
use futures::FutureExt;
use object_store::ObjectStore;

use crate::losses::LossLedger;
use crate::scan::external;
use crate::scan::plan::Wanted;
use crate::scan::stream::{Job, stream};
use crate::scan::table::LogTable;
use crate::session::LogPart;

/// Rows of a batch, until DataFusion says otherwise.
const BATCH_ROWS: usize = 8192;

/// One table's scan over MCAP files.
///
/// Filters choose the chunks that are read (by log time, session and topic); every row is checked again by the
/// filter above the scan. A projection reaches the message decoders.
#[derive(Clone)]
pub struct McapSource {
    table: LogTable,
    table_schema: TableSchema,
    projection: SplitProjection,
    predicate: Option<Arc<dyn PhysicalExpr>>,
    batch_rows: usize,
    metrics: ExecutionPlanMetricsSet,
    pool: Option<Arc<dyn MemoryPool>>,
    losses: LossLedger,
}

impl McapSource {
    /// A scan of `table` with the given schema.
    pub fn new(table: LogTable, table_schema: TableSchema, losses: LossLedger) -> Self {
        Self {
            table,
            projection: SplitProjection::unprojected(&table_schema),
            table_schema,
            predicate: None,
            batch_rows: BATCH_ROWS,
            metrics: ExecutionPlanMetricsSet::new(),
            pool: None,
            losses,
        }
    }

    /// Memory for chunks and batches is reserved from this pool.
    #[must_use]
    pub fn with_pool(mut self, pool: Arc<dyn MemoryPool>) -> Self {
        self.pool = Some(pool);
        self
    }
}

impl FileSource for McapSource {
    fn create_file_opener(
        &self,
        object_store: Arc<dyn ObjectStore>,
        base_config: &FileScanConfig,
        _partition: usize,
    ) -> Result<Arc<dyn FileOpener>> {
        let mut source = self.clone();
        // No batch needs to be larger than the rows that are asked for.
        let limit = base_config.limit.unwrap_or(usize::MAX);
        source.batch_rows = source.batch_rows.min(limit);
        let opener = Arc::new(McapOpener {
            source,
            object_store,
            store_url: base_config.object_store_url.clone(),
        });
        ProjectionOpener::try_new(
            self.projection.clone(),
            opener,
            self.table_schema.file_schema(),
        )
    }

    fn table_schema(&self) -> &TableSchema {
        &self.table_schema
    }

    fn with_batch_size(&self, batch_size: usize) -> Arc<dyn FileSource> {
        Arc::new(Self {
            batch_rows: batch_size,
            ..self.clone()
        })
    }

    fn filter(&self) -> Option<Arc<dyn PhysicalExpr>> {
        // Filters only prune: they must not be mistaken for filters that every row has passed.
        None
    }

    fn projection(&self) -> Option<&ProjectionExprs> {
        Some(&self.projection.source)
    }

    fn metrics(&self) -> &ExecutionPlanMetricsSet {
        &self.metrics
    }

    fn file_type(&self) -> &str {
        "mcap"
    }

    fn fmt_extra(&self, _: DisplayFormatType, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, ", table={}", self.table.name())?;
        match &self.predicate {
            Some(predicate) => write!(f, ", prune={predicate}"),
            None => Ok(()),
        }
    }

    fn try_pushdown_filters(
        &self,
        filters: Vec<Arc<dyn PhysicalExpr>>,
        _config: &ConfigOptions,
    ) -> Result<FilterPushdownPropagation<Arc<dyn FileSource>>> {
        let answers = vec![PushedDown::No; filters.len()];
        let propagation = FilterPushdownPropagation::with_parent_pushdown_result(answers);
        if filters.is_empty() {
            return Ok(propagation);
        }
        let mut source = self.clone();
        source.predicate = Some(conjunction(self.predicate.iter().cloned().chain(filters)));
        Ok(propagation.with_updated_node(Arc::new(source)))
    }

    fn try_pushdown_projection(
        &self,
        projection: &ProjectionExprs,
    ) -> Result<Option<Arc<dyn FileSource>>> {
        let merged = self.projection.source.try_merge(projection)?;
        Ok(Some(Arc::new(Self {
            projection: SplitProjection::new(self.table_schema.file_schema(), &merged),
            ..self.clone()
        })))
    }

    fn apply_expressions(
        &self,
        f: &mut dyn FnMut(&Arc<dyn PhysicalExpr>) -> Result<TreeNodeRecursion>,
    ) -> Result<TreeNodeRecursion> {
        let projected = self.projection.source.iter().map(|column| &column.expr);
        for expression in self.predicate.iter().chain(projected) {
            if f(expression)? == TreeNodeRecursion::Stop {
                return Ok(TreeNodeRecursion::Stop);
            }
        }
        Ok(TreeNodeRecursion::Continue)
    }
}

/// Opens a file, or a byte range of one.
struct McapOpener {
    source: McapSource,
    object_store: Arc<dyn ObjectStore>,
    store_url: ObjectStoreUrl,
}

impl FileOpener for McapOpener {
    fn open(&self, file: PartitionedFile) -> Result<FileOpenFuture> {
        let source = self.source.clone();
        let store = self.object_store.clone();
        let store_url = self.store_url.clone();
        Ok(async move {
            let part = match file.extension::<Arc<LogPart>>() {
                Some(part) => part.clone(),
                None => {
                    let meta = file.object_meta.clone();
                    let opened = LogPart::open(store, store_url, meta, &source.losses).await;
                    Arc::new(opened.map_err(external)?)
                }
            };
            let job = job(source, part, file.range()).map_err(external)?;
            Ok(stream(job))
        }
        .boxed())
    }
}

fn job(
    source: McapSource,
    part: Arc<LogPart>,
    range: (u64, u64),
) -> Result<Job, evermap_schemas::Fault> {
    let schema = source.table_schema.file_schema();
    let rows = source
        .table
        .rows(&part, schema, &source.projection.file_indices)?;
    let units = match source.table.records(&part.index) {
        Some(records) => records
            .iter()
            .filter(|unit| unit.offset >= range.0 && unit.offset < range.1)
            .map(|unit| crate::scan::plan::PlannedUnit {
                unit: unit.clone(),
                channels: None,
            })
            .collect(),
        None => {
            let channels = part.index.channels.keys().copied();
            Wanted {
                part: &part,
                range,
                channels: channels.filter(|channel| rows.wants(*channel)).collect(),
                predicate: source.predicate.as_ref(),
                schema,
            }
            .units()
        }
    };
    Ok(Job {
        topic: source.table.topic().to_owned(),
        part,
        units,
        rows,
        batch_rows: source.batch_rows,
        pool: source.pool,
    })
}
