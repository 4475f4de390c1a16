//! Files that are read as often as they are named. Units whose rows are equal leave one artifact, and each of them has its
//! rows; DataFusion reads a file once, however often a table names it.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use datafusion::catalog::{Session, TableProvider};
use datafusion::common::Statistics;
use datafusion::datasource::physical_plan::{FileGroup, FileScanConfig, FileScanConfigBuilder};
use datafusion::datasource::source::DataSourceExec;
use datafusion::error::Result;
use datafusion::logical_expr::{Expr, TableProviderFilterPushDown, TableType};
use datafusion::physical_plan::ExecutionPlan;
use futures::FutureExt;
use futures::future::BoxFuture;
use object_store::path::Path;

/// The rows of a table of files, those of each so many times.
#[derive(Debug)]
pub struct Repeated {
    /// The table, which has each file once.
    pub files: Arc<dyn TableProvider>,
    /// How often each is read.
    pub times: BTreeMap<Path, usize>,
}

impl Repeated {
    fn repeated(&self, config: &FileScanConfig) -> Result<FileScanConfig> {
        let group = |group: &FileGroup| {
            let files = group.iter().flat_map(|file| {
                let times = self.times.get(file.path()).copied().unwrap_or(1);
                std::iter::repeat_n(file.clone(), times)
            });
            FileGroup::new(files.collect())
        };
        let groups: Vec<FileGroup> = config.file_groups.iter().map(group).collect();
        // Rows are counted by them where nothing is filtered.
        let files = groups.iter().flat_map(|group| group.files());
        let known = files.filter_map(|file| file.statistics.as_deref());
        let statistics = Statistics::try_merge_iter(known, &self.files.schema())?;
        let repeated = FileScanConfigBuilder::from(config.clone());
        let repeated = repeated.with_statistics(statistics);
        Ok(repeated.with_file_groups(groups).build())
    }
}

impl TableProvider for Repeated {
    fn schema(&self) -> SchemaRef {
        self.files.schema()
    }

    fn table_type(&self) -> TableType {
        self.files.table_type()
    }

    fn supports_filters_pushdown(
        &self,
        filters: &[&Expr],
    ) -> Result<Vec<TableProviderFilterPushDown>> {
        self.files.supports_filters_pushdown(filters)
    }

    // Its future is boxed once: `crate::erased`.
    fn scan<'a, 'b, 'c, 'd, 'all>(
        &'a self,
        session: &'b dyn Session,
        projection: Option<&'c Vec<usize>>,
        filters: &'d [Expr],
        _: Option<usize>,
    ) -> BoxFuture<'all, Result<Arc<dyn ExecutionPlan>>>
    where
        'a: 'all,
        'b: 'all,
        'c: 'all,
        'd: 'all,
        Self: 'all,
    {
        self.scanned(session, projection, filters)
    }
}

impl Repeated {
    fn scanned<'a>(
        &'a self,
        session: &'a dyn Session,
        projection: Option<&'a Vec<usize>>,
        filters: &'a [Expr],
    ) -> BoxFuture<'a, Result<Arc<dyn ExecutionPlan>>> {
        let scanned = async move {
            // Without a limit, which would leave files out: it is pushed into the scan later.
            let plan = self.files.scan(session, projection, filters, None).await?;
            let scan = plan.downcast_ref::<DataSourceExec>();
            let config = scan.and_then(|scan| scan.data_source().downcast_ref::<FileScanConfig>());
            // Of files without rows nothing may be left to scan.
            let Some(config) = config else {
                return Ok(plan);
            };
            let repeated: Arc<dyn ExecutionPlan> =
                DataSourceExec::from_data_source(self.repeated(config)?);
            Ok(repeated)
        };
        scanned.boxed()
    }
}
