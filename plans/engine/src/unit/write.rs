//! Rows on their way into a Parquet file named by its content.

use std::sync::Arc;
use std::time::{Duration, Instant};

use arrow::compute::BatchCoalescer;
use arrow::datatypes::Schema;
use bytes::Bytes;
use datafusion::physical_plan::{ExecutionPlan, execute_stream};
use evermap_schemas::geoparquet::{self, GeoColumn};
use evermap_schemas::{Fault, Layer};
use futures::StreamExt;
use futures::future::BoxFuture;
use object_store::buffered::BufWriter;
use parquet::arrow::async_writer::AsyncFileWriter;
use parquet::arrow::{ArrowSchemaConverter, AsyncArrowWriter};
use parquet::basic::{Compression, LogicalType, Type, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::{KeyValue, SortingColumn};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::schema::types::{ColumnDescPtr, SchemaDescriptor};
use tokio::io::AsyncWriteExt;

use crate::error::OrFault;
use crate::map::receipt::Artifact;
use crate::map::store::{Store, TEMPORARY};
use crate::unit::build::Builder;
use crate::unit::work::NodeWork;

/// Encoded bytes after which a row group is closed: bounds the memory of the writer, and of readers.
const ROW_GROUP_BYTES: usize = 16 << 20;

/// Writes the rows of a plan's only partition into a file that has a temporary name.
///
/// # Errors
/// Whatever the plan says, or a resource fault when the store does not take the file.
pub async fn write(
    store: &Store,
    plan: Arc<dyn ExecutionPlan>,
    builder: &Builder<'_>,
) -> Result<(String, Artifact, NodeWork), Fault> {
    let temporary = format!("{TEMPORARY}/{}.parquet", uuid::Uuid::new_v4());
    match write_to(store, &temporary, plan, builder).await {
        Ok((artifact, writing)) => Ok((temporary, artifact, writing)),
        Err(fault) => {
            store.remove(&temporary).await?;
            Err(fault)
        }
    }
}

async fn write_to(
    store: &Store,
    name: &str,
    plan: Arc<dyn ExecutionPlan>,
    builder: &Builder<'_>,
) -> Result<(Artifact, NodeWork), Fault> {
    let file = Hashing::new(BufWriter::new(store.objects(), store.path(name)));
    let schema = builder.written(plan.schema())?;
    let properties = properties(builder.layer(), &schema)?;
    let mut writer =
        AsyncArrowWriter::try_new(file, schema, Some(properties)).map_err(parquet_fault)?;
    let geometry = match builder.layer() {
        Some(layer) => layer.geometry,
        None => Some(geoparquet::COLUMN),
    };
    let mut geometries = geometry.map(GeoColumn::new);
    let (mut rows, mut took) = (0, Duration::ZERO);
    // Where pages and row groups end depends on the batches that are written, and those that come on the memory.
    let mut batches = BatchCoalescer::new(plan.schema(), builder.written_rows());
    let mut stream = execute_stream(plan, builder.task_context()).or_fault()?;
    let mut ended = false;
    while !ended {
        match stream.next().await {
            Some(batch) => batches.push_batch(batch.or_fault()?)?,
            None => {
                batches.finish_buffered_batch()?;
                ended = true;
            }
        }
        while let Some(batch) = batches.next_completed_batch() {
            rows += batch.num_rows() as u64;
            let clock = Instant::now();
            if let Some(geometries) = &mut geometries {
                geometries.add(&batch);
            }
            writer.write(&batch).await.map_err(parquet_fault)?;
            if writer.in_progress_size() > ROW_GROUP_BYTES {
                writer.flush().await.map_err(parquet_fault)?;
            }
            took += clock.elapsed();
        }
    }
    let clock = Instant::now();
    // What nobody declares is a geometry if its values are.
    let is_geometry = |seen: &GeoColumn| builder.layer().is_some() || !seen.is_empty();
    if let Some(geometries) = geometries.filter(is_geometry) {
        let said = geometries.metadata(&serde_json::Value::Null);
        writer.append_key_value_metadata(KeyValue::new(geoparquet::KEY.to_owned(), said));
    }
    writer.finish().await.map_err(parquet_fault)?;
    took += clock.elapsed();
    let (content, bytes) = writer.into_inner().finish();
    let artifact = Artifact {
        content,
        rows,
        bytes,
        extent: builder.extent(),
    };
    Ok((artifact, NodeWork::writing(rows, bytes, took)))
}

fn parquet_fault(error: ParquetError) -> Fault {
    Fault::resource(format!("cannot write an artifact: {error}"))
}

fn properties(layer: Option<&Layer>, schema: &Schema) -> Result<WriterProperties, Fault> {
    let mut metadata = Vec::new();
    let mut note = |key: &str, value| metadata.push(KeyValue::new(key.to_owned(), value));
    if let Some(layer) = layer {
        note(Layer::SAID_AS, layer.name.to_owned());
        note("evermap.layer_version", layer.version.to_string());
    }
    let parquet = ArrowSchemaConverter::new().convert(schema);
    let parquet = parquet.map_err(parquet_fault)?;
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(1).unwrap_or_default()))
        .set_created_by("evermap".into())
        .set_key_value_metadata(Some(metadata))
        .set_sorting_columns(layer.map(|layer| sorting(layer, &parquet)));
    let floats = parquet.columns().iter().filter(|leaf| is_float(leaf));
    let properties = floats.fold(properties, |properties, leaf| {
        properties.set_column_statistics_enabled(leaf.path().clone(), EnabledStatistics::None)
    });
    Ok(properties.build())
}

/// Whether values may be NaN. Statistics leave those out, and who reads the file takes them for all that there is: of a
/// column whose least value is its greatest, each value would be that one.
fn is_float(leaf: &ColumnDescPtr) -> bool {
    let is_half = leaf.logical_type_ref() == Some(&LogicalType::Float16);
    is_half || matches!(leaf.physical_type(), Type::FLOAT | Type::DOUBLE)
}

/// The order of a layer's rows, told so that who wants them in it need not sort them.
fn sorting(layer: &Layer, parquet: &SchemaDescriptor) -> Vec<SortingColumn> {
    let leaf = |name: &&str| {
        let is_it = |leaf: &ColumnDescPtr| leaf.path().parts() == [(*name).to_owned()];
        parquet.columns().iter().position(is_it)
    };
    // Rows are in the order of the columns before one that no file can name.
    let leaves = layer.key.iter().map_while(leaf);
    let sorting = leaves.map(|leaf| SortingColumn {
        column_idx: leaf as i32,
        descending: false,
        nulls_first: true,
    });
    sorting.collect()
}

/// A file that is hashed as it is written.
struct Hashing {
    file: BufWriter,
    hasher: blake3::Hasher,
    bytes: u64,
}

impl Hashing {
    fn new(file: BufWriter) -> Self {
        Self {
            file,
            hasher: blake3::Hasher::new(),
            bytes: 0,
        }
    }

    fn finish(self) -> (String, u64) {
        (self.hasher.finalize().to_hex().to_string(), self.bytes)
    }
}

impl AsyncFileWriter for Hashing {
    fn write(&mut self, bytes: Bytes) -> BoxFuture<'_, parquet::errors::Result<()>> {
        self.hasher.update(&bytes);
        self.bytes += bytes.len() as u64;
        Box::pin(async move { self.file.put(bytes).await.map_err(external) })
    }

    fn complete(&mut self) -> BoxFuture<'_, parquet::errors::Result<()>> {
        Box::pin(async move { self.file.shutdown().await.map_err(external) })
    }
}

fn external(error: impl std::error::Error + Send + Sync + 'static) -> ParquetError {
    ParquetError::External(Box::new(error))
}
