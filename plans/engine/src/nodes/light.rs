//! Batches that are light, whatever their rows are. DataFusion counts a batch in rows, and rows may have a megabyte.
//!
//! Its sort spills what does not fit, but a batch must fit into its share of the memory, and so must two batches of what
//! it has spilled, to be merged. So [`LightSortExec`] cuts what comes by bytes, looks how heavy the rows are, and then
//! has them sorted so many at a time that a batch has a megabyte. Files are read in batches of a few megabytes, as far
//! as they tell how large they are. What filters and repartitions leave of batches is put together by bytes
//! (`filtered`), and what joins make of logs is made of few rows at a time (`joined`).
//! What an expression makes of rows is made of few at a time (`spared`). How many rows
//! a batch has depends on the rows alone, never on the memory there is, as results may depend on it.

mod filtered;
mod joined;

pub use filtered::is_filter;

use std::fmt;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use arrow::array::{
    Array, ArrayRef, AsArray, RecordBatch, RecordBatchOptions, StructArray, UInt32Array,
};
use arrow::compute::{concat_batches, take_record_batch};
use arrow::datatypes::{DataType, SchemaRef};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::common::utils::memory::get_record_batch_memory_size;
use datafusion::datasource::physical_plan::{FileScanConfigBuilder, ParquetSource};
use datafusion::datasource::source::DataSourceExec;
use datafusion::error::{DataFusionError, Result};
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::{EquivalenceProperties, LexOrdering, Partitioning, PhysicalExpr};
use datafusion::physical_optimizer::PhysicalOptimizerRule;
use datafusion::physical_plan::metrics::{BaselineMetrics, RecordOutput};
use datafusion::physical_plan::sorts::sort::SortExec;
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::streaming::{PartitionStream, StreamingTableExec};
use datafusion::physical_plan::{ExecutionPlan, ExecutionPlanProperties};
use futures::stream::BoxStream;
use futures::{Stream, StreamExt, TryStreamExt};

use self::filtered::light_filter;
use self::joined::light_join;
use crate::locked::locked;
use crate::nodes::node::{Duty, Node, first};
use crate::nodes::spared::spared;
use crate::nodes::weight::weight;

/// Bytes of a batch that is sorted, unless it is of a single row.
const SORTED_BYTES: usize = 1 << 20;

/// Bytes of a batch that is read from a file of the map, unless it is of a single row.
const READ_BYTES: usize = 4 << 20;

/// The rule that keeps the batches of any plan light.
#[derive(Debug)]
pub struct LightBatches;

impl PhysicalOptimizerRule for LightBatches {
    fn optimize(
        &self,
        plan: Arc<dyn ExecutionPlan>,
        options: &ConfigOptions,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let most = options.execution.batch_size.get();
        let lighter = plan.transform_up(|plan| {
            let light = light_sort(&plan)?
                .or_else(|| light_scan(&plan, most))
                .or(light_filter(&plan)?)
                .or(light_join(&plan, most)?);
            let plan = light.map_or_else(|| Transformed::no(plan), Transformed::yes);
            let spared = spared(&plan.data, most)?;
            Ok(spared.map_or(plan, Transformed::yes))
        });
        Ok(lighter?.data)
    }

    fn name(&self) -> &str {
        "light_batches"
    }

    fn schema_check(&self) -> bool {
        true
    }
}

/// Sorts the rows of each partition.
pub type LightSortExec = Node<Sorting>;

/// The order that rows are brought into.
pub struct Sorting {
    order: LexOrdering,
}

impl fmt::Display for Sorting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "expr=[{}]", self.order)
    }
}

/// A plan that sorts the rows of a plan, partition by partition.
///
/// # Errors
/// When the order does not fit the rows.
pub fn sorted(plan: Arc<dyn ExecutionPlan>, order: LexOrdering) -> Result<Arc<dyn ExecutionPlan>> {
    let sorting = Arc::new(Sorting { order });
    Ok(Arc::new(LightSortExec::try_new(sorting, vec![plan])?))
}

/// What stands in for a sort of DataFusion's. One that keeps few rows is left as it is.
fn light_sort(plan: &Arc<dyn ExecutionPlan>) -> Result<Option<Arc<dyn ExecutionPlan>>> {
    let Some(sort) = plan.downcast_ref::<SortExec>() else {
        return Ok(None);
    };
    let input = sort.input();
    let single = input.output_partitioning().partition_count() == 1;
    if sort.fetch().is_some() || !(single || sort.preserve_partitioning()) {
        return Ok(None);
    }
    sorted(Arc::clone(input), sort.expr().clone()).map(Some)
}

/// The scan of Parquet files with fewer rows in a batch, where they are heavy.
fn light_scan(plan: &Arc<dyn ExecutionPlan>, most: usize) -> Option<Arc<dyn ExecutionPlan>> {
    let scan = plan.downcast_ref::<DataSourceExec>()?;
    let (config, _) = scan.downcast_to_file_source::<ParquetSource>()?;
    let statistics = config.statistics();
    let rows = *statistics.num_rows.get_value()?;
    let bytes = *statistics.total_byte_size.get_value()?;
    let each = (READ_BYTES / (bytes / rows.max(1)).max(1)).max(1);
    if each >= config.batch_size.unwrap_or(most) {
        return None;
    }
    let config = FileScanConfigBuilder::from(config.clone()).with_batch_size(Some(each));
    Some(DataSourceExec::from_data_source(config.build()))
}

impl Duty for Sorting {
    const NAME: &'static str = "LightSortExec";
    type Shared = ();

    fn output(
        &self,
        children: &[Arc<dyn ExecutionPlan>],
    ) -> Result<(EquivalenceProperties, Partitioning)> {
        let child = first(children)?;
        let mut equivalences = child.equivalence_properties().clone();
        equivalences.reorder(self.order.clone())?;
        Ok((equivalences, child.output_partitioning().clone()))
    }

    fn expressions(&self) -> Vec<&Arc<dyn PhysicalExpr>> {
        self.order.iter().map(|by| &by.expr).collect()
    }

    fn execute(
        node: &LightSortExec,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        // What is below registers for memory when its rows are asked for: until then others may have its share.
        let input = Arc::clone(first(&node.children)?);
        let (schema, order) = (node.schema(), node.duty.order.clone());
        let metrics = BaselineMetrics::new(&node.metrics, partition);
        let begun = async move {
            let input = input.execute(partition, Arc::clone(&context))?;
            begin(input, order, context, metrics).await
        };
        let batches = futures::stream::once(begun).try_flatten();
        Ok(Box::pin(RecordBatchStreamAdapter::new(schema, batches)))
    }
}

/// Begins to sort, in batches for rows like the first ones.
async fn begin(
    input: SendableRecordBatchStream,
    order: LexOrdering,
    context: Arc<TaskContext>,
    metrics: BaselineMetrics,
) -> Result<impl Stream<Item = Result<RecordBatch>> + Send> {
    let schema = input.schema();
    let pieces = input
        .map(|batch| Ok::<_, DataFusionError>(futures::stream::iter(pieces(&batch?))))
        .try_flatten()
        .boxed();
    let mut pieces = gathered(Arc::clone(&schema), pieces).boxed();
    let first = pieces.try_next().await?;
    let most = context.session_config().batch_size();
    let rows = first
        .as_ref()
        .map_or(most, |first| light_rows(first).min(most));
    let all = futures::stream::iter(first.map(Ok)).chain(pieces);
    let all = RecordBatchStreamAdapter::new(Arc::clone(&schema), all);
    let once = Once {
        schema: Arc::clone(&schema),
        rows: Mutex::new(Some(Box::pin(all))),
    };
    let input = StreamingTableExec::try_new(schema, vec![Arc::new(once)], None, [], false, None)?;
    let sort = SortExec::new(order, Arc::new(input));
    let sorted = sort.execute(0, with_batch_rows(&context, rows))?;
    let busy = metrics.elapsed_compute().clone();
    let sorted = sorted.map(move |batch| Ok(compacted(&batch?)?.record_output(&metrics)));
    let told = futures::stream::once(async move {
        let took = sort.metrics().and_then(|metrics| metrics.elapsed_compute());
        busy.add_duration(Duration::from_nanos(took.unwrap_or_default() as u64));
    });
    let nothing_more = told.filter_map(|()| std::future::ready(None));
    Ok(sorted.chain(nothing_more))
}

/// The context with batches of so many rows.
fn with_batch_rows(context: &TaskContext, rows: usize) -> Arc<TaskContext> {
    let config = context.session_config().clone();
    Arc::new(TaskContext::new(
        context.task_id(),
        context.session_id(),
        config.with_batch_size(rows),
        context.scalar_functions().clone(),
        context.higher_order_functions().clone(),
        context.aggregate_functions().clone(),
        context.window_functions().clone(),
        context.runtime_env(),
    ))
}

/// Rows like those of a batch that have [`SORTED_BYTES`] together.
fn light_rows(batch: &RecordBatch) -> usize {
    let bytes = weight(batch);
    let row_bytes = bytes / batch.num_rows().max(1);
    (SORTED_BYTES / row_bytes.max(1)).max(1)
}

/// Pieces that are still to come, and one of them that has.
type Coming = (BoxStream<'static, Result<RecordBatch>>, Option<RecordBatch>);

/// Pieces that follow each other as one, while they have no more than [`SORTED_BYTES`] together. A sort keeps its batches
/// apart, and each batch that it makes is put together from all of them: many small ones would cost their square.
fn gathered(
    schema: SchemaRef,
    pieces: BoxStream<'static, Result<RecordBatch>>,
) -> impl Stream<Item = Result<RecordBatch>> + Send {
    futures::stream::try_unfold((pieces, None), move |coming| {
        next_gathered(Arc::clone(&schema), coming)
    })
}

async fn next_gathered(
    schema: SchemaRef,
    (mut pieces, mut come): Coming,
) -> Result<Option<(RecordBatch, Coming)>> {
    let (mut held, mut held_bytes) = (Vec::new(), 0);
    loop {
        let next = match come.take() {
            Some(piece) => Some(piece),
            None => pieces.try_next().await?,
        };
        let Some(piece) = next else { break };
        let more = get_record_batch_memory_size(&piece);
        if !held.is_empty() && held_bytes + more > SORTED_BYTES {
            come = Some(piece);
            break;
        }
        held_bytes += more;
        held.push(piece);
    }
    let batch = match held.len() {
        0 => return Ok(None),
        1 => held.swap_remove(0),
        _ => concat_batches(&schema, &held)?,
    };
    Ok(Some((batch, (pieces, come))))
}

/// The batch with nothing behind its views but what they show: rows that were sorted show parts of many batches.
fn compacted(batch: &RecordBatch) -> Result<RecordBatch> {
    let columns = batch.columns().iter().map(compact);
    let columns = columns.collect::<Result<_>>()?;
    let rows = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
    let batch = RecordBatch::try_new_with_options(batch.schema(), columns, &rows);
    batch.map_err(DataFusionError::from)
}

fn compact(column: &ArrayRef) -> Result<ArrayRef> {
    Ok(match column.data_type() {
        DataType::Utf8View => Arc::new(column.as_string_view().gc()),
        DataType::BinaryView => Arc::new(column.as_binary_view().gc()),
        DataType::Struct(fields) => {
            let column = column.as_struct();
            let members = column
                .columns()
                .iter()
                .map(compact)
                .collect::<Result<_>>()?;
            let (fields, nulls) = (fields.clone(), column.nulls().cloned());
            let length = column.len();
            Arc::new(StructArray::try_new_with_length(
                fields, members, nulls, length,
            )?)
        }
        _ => Arc::clone(column),
    })
}

/// The batch in pieces of about [`SORTED_BYTES`], which share nothing where it is larger. There is none without rows.
fn pieces(batch: &RecordBatch) -> Vec<Result<RecordBatch>> {
    if get_record_batch_memory_size(batch) <= SORTED_BYTES {
        return Some(Ok(batch.clone()))
            .filter(|_| batch.num_rows() > 0)
            .into_iter()
            .collect();
    }
    let (rows, each) = (batch.num_rows(), light_rows(batch));
    let starts = (0..rows).step_by(each);
    let piece = |start: usize| {
        let places = UInt32Array::from_iter_values(start as u32..(start + each).min(rows) as u32);
        compacted(&take_record_batch(batch, &places)?)
    };
    starts.map(piece).collect()
}

/// Rows that are read once.
struct Once {
    schema: SchemaRef,
    rows: Mutex<Option<SendableRecordBatchStream>>,
}

impl fmt::Debug for Once {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Once")
    }
}

impl PartitionStream for Once {
    fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    fn execute(&self, _: Arc<TaskContext>) -> SendableRecordBatchStream {
        let rows = locked(&self.rows).take();
        rows.unwrap_or_else(|| {
            let none = futures::stream::empty();
            Box::pin(RecordBatchStreamAdapter::new(
                Arc::clone(&self.schema),
                none,
            ))
        })
    }
}

#[cfg(test)]
mod tests;
