//! The file format: for whoever lists MCAP files through DataFusion's own listing tables.

use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use async_trait::async_trait;
use datafusion::catalog::Session;
use datafusion::common::Statistics;
use datafusion::common::parsers::CompressionTypeVariant;
use datafusion::datasource::file_format::FileFormat;
use datafusion::datasource::file_format::file_compression_type::FileCompressionType;
use datafusion::datasource::physical_plan::{FileScanConfig, FileScanConfigBuilder, FileSource};
use datafusion::datasource::source::DataSourceExec;
use datafusion::datasource::table_schema::TableSchema;
use datafusion::error::Result;
use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::physical_plan::ExecutionPlan;
use evermap_schemas::Fault;
use object_store::{ObjectMeta, ObjectStore};

use crate::losses::LossLedger;
use crate::scan::external;
use crate::scan::source::McapSource;
use crate::scan::table::LogTable;
use crate::session::LogPart;

/// MCAP, seen as one table: a topic's messages, or one of the tables over the whole log.
#[derive(Debug, Clone)]
pub struct McapFormat {
    table: LogTable,
    losses: LossLedger,
}

impl McapFormat {
    /// The format whose files yield `table`; what cannot be read is noted in `losses`.
    pub fn new(table: LogTable, losses: LossLedger) -> Self {
        Self { table, losses }
    }
}

#[async_trait]
impl FileFormat for McapFormat {
    fn get_ext(&self) -> String {
        "mcap".to_owned()
    }

    fn get_ext_with_compression(&self, compression: &FileCompressionType) -> Result<String> {
        match compression.get_variant() {
            CompressionTypeVariant::UNCOMPRESSED => Ok(self.get_ext()),
            _ => Err(external(
                Fault::user("expected an MCAP file that is not compressed as a whole")
                    .next("decompress it first: MCAP compresses its chunks itself"),
            )),
        }
    }

    fn compression_type(&self) -> Option<FileCompressionType> {
        Some(FileCompressionType::UNCOMPRESSED)
    }

    async fn infer_schema(
        &self,
        _state: &dyn Session,
        store: &Arc<dyn ObjectStore>,
        objects: &[ObjectMeta],
    ) -> Result<SchemaRef> {
        let mut parts = Vec::new();
        for meta in objects {
            let url = ObjectStoreUrl::local_filesystem();
            let part = LogPart::open(store.clone(), url, meta.clone(), &self.losses).await;
            parts.push(Arc::new(part.map_err(external)?));
        }
        self.table.schema(&parts).map_err(external)
    }

    async fn infer_stats(
        &self,
        _state: &dyn Session,
        _store: &Arc<dyn ObjectStore>,
        table_schema: SchemaRef,
        _object: &ObjectMeta,
    ) -> Result<Statistics> {
        Ok(Statistics::new_unknown(&table_schema))
    }

    async fn create_physical_plan(
        &self,
        state: &dyn Session,
        conf: FileScanConfig,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let pool = state.runtime_env().memory_pool.clone();
        let source = conf.file_source().downcast_ref::<McapSource>().cloned();
        let source = source.ok_or_else(|| external(Fault::bug("expected an MCAP scan")))?;
        let source = Arc::new(source.with_pool(pool));
        let config = FileScanConfigBuilder::from(conf)
            .with_source(source)
            .build();
        Ok(DataSourceExec::from_data_source(config))
    }

    fn file_source(&self, table_schema: TableSchema) -> Arc<dyn FileSource> {
        Arc::new(McapSource::new(
            self.table.clone(),
            table_schema,
            self.losses.clone(),
        ))
    }
}
