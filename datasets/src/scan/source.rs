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
use datafusion::datasource::source::DataSourceExec;
use datafusion::datasource::table_schema::TableSchema;
use datafusion::error::Result;
use datafusion::execution::memory_pool::MemoryPool;
use datafusion::physical_expr::projection::ProjectionExprs;
use datafusion::physical_expr::{PhysicalExpr, conjunction};
use datafusion::physical_plan::DisplayFormatType;
use datafusion::physical_plan::filter_pushdown::{FilterPushdownPropagation, PushedDown};
use datafusion::physical_plan::metrics::ExecutionPlanMetricsSet;
use evermap_schemas::Fault;
use futures::FutureExt;
use object_store::ObjectStore;

use crate::fault::external;
use crate::scan::plan::{PlannedUnit, ScanRequest};
use crate::scan::stream::{Job, ScanMetrics, stream};
use crate::scan::table::LogTable;
use crate::session::LogPart;

/// Rows of a batch, until DataFusion says otherwise.
const BATCH_ROWS: usize = 8192;

/// One table's scan over MCAP files.
///
/// Filters choose the chunks that are read (by log time, session and topic); every row is checked again by the
/// filter above the scan. A projection reaches the message decoders.
#[derive(Clone)]
pub(crate) struct McapSource {
    table: Arc<dyn LogTable>,
    table_schema: TableSchema,
    projection: SplitProjection,
    predicate: Option<Arc<dyn PhysicalExpr>>,
    batch_rows: usize,
    metrics: ExecutionPlanMetricsSet,
    /// Memory for chunks and batches is reserved from this pool.
    pool: Arc<dyn MemoryPool>,
}

impl McapSource {
    /// A scan of `table`, whose schema this is.
    pub fn new(
        table: Arc<dyn LogTable>,
        table_schema: TableSchema,
        pool: Arc<dyn MemoryPool>,
    ) -> Self {
        Self {
            table,
            projection: SplitProjection::unprojected(&table_schema),
            table_schema,
            predicate: None,
            batch_rows: BATCH_ROWS,
            metrics: ExecutionPlanMetricsSet::new(),
            pool,
        }
    }
}

impl FileSource for McapSource {
    fn create_file_opener(
        &self,
        _object_store: Arc<dyn ObjectStore>,
        base_config: &FileScanConfig,
        partition: usize,
    ) -> Result<Arc<dyn FileOpener>> {
        let mut source = self.clone();
        // No batch needs to be larger than the rows that are asked for.
        let limit = base_config.limit.unwrap_or(usize::MAX);
        source.batch_rows = source.batch_rows.min(limit);
        let metrics = ScanMetrics::new(&self.metrics, partition);
        ProjectionOpener::try_new(
            self.projection.clone(),
            Arc::new(McapOpener { source, metrics }),
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

/// The table of a log that a plan node scans; `None` where it scans something else.
pub fn scanned(scan: &DataSourceExec) -> Option<String> {
    let (_, source) = scan.downcast_to_file_source::<McapSource>()?;
    Some(source.table.name().to_owned())
}

/// Opens a file, or a byte range of one.
struct McapOpener {
    source: McapSource,
    metrics: ScanMetrics,
}

impl FileOpener for McapOpener {
    fn open(&self, file: PartitionedFile) -> Result<FileOpenFuture> {
        let (source, metrics) = (self.source.clone(), self.metrics.clone());
        let part = file.extension::<Arc<LogPart>>().cloned();
        let part = part.ok_or_else(|| external(Fault::bug("a file without its index")))?;
        Ok(async move {
            let job = source
                .job(part, file.range(), metrics)
                .await
                .map_err(external)?;
            Ok(stream(job))
        }
        .boxed())
    }
}

impl McapSource {
    async fn job(
        self,
        part: Arc<LogPart>,
        range: (u64, u64),
        metrics: ScanMetrics,
    ) -> Result<Job, Fault> {
        let columns = &self.projection.file_indices;
        let rows = self.table.rows(&part, columns).await?;
        let units = match self.table.records(&part.index) {
            Some(records) => records
                .iter()
                .filter(|unit| unit.offset >= range.0 && unit.offset < range.1)
                .map(|unit| PlannedUnit {
                    unit: unit.first(rows.record_bytes()),
                    channels: None,
                })
                .collect(),
            None => {
                let channels = part.index.channels.keys().copied();
                ScanRequest {
                    part: &part,
                    range,
                    channels: channels.filter(|channel| rows.wants(*channel)).collect(),
                    predicate: self.predicate.as_ref(),
                    schema: self.table_schema.file_schema(),
                    indexed: self.table.indexed_columns(),
                }
                .units()
            }
        };
        Ok(Job {
            topic: self.table.topic().to_owned(),
            part,
            units,
            rows,
            batch_rows: self.batch_rows,
            pool: Some(self.pool),
            metrics,
        })
    }
}
