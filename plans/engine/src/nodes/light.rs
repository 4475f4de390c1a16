//! Batches that are light, whatever their rows are. DataFusion counts a batch in rows, and rows may have a megabyte.
//!
//! Its sort spills what does not fit, but a batch must fit into its share of the memory, and so must two batches of what
//! it has spilled, to be merged. So [`LightSortExec`] cuts what comes by bytes, looks how heavy the rows are, and then
//! has them sorted so many at a time that a batch has a megabyte. Files are read in batches of a few megabytes, as far
//! as they tell how large they are. What an expression makes of rows is made of few at a time (`spared`). How many rows
//! a batch has depends on the rows alone, never on the memory there is, as results may depend on it.

use std::fmt;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use arrow::array::{
    Array, ArrayRef, AsArray, RecordBatch, RecordBatchOptions, StructArray, UInt32Array,
};
use arrow::compute::take_record_batch;
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
use futures::{Stream, StreamExt, TryStreamExt};

use crate::locked::locked;
use crate::nodes::node::{Duty, Node, first};
use crate::nodes::spared::spared;
use crate::nodes::weight::bytes;

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
            let light = match light_sort(&plan)? {
                Some(sort) => Some(sort),
                None => light_scan(&plan, most),
            };
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
    let mut pieces = input
        .map(|batch| Ok::<_, DataFusionError>(futures::stream::iter(pieces(&batch?))))
        .try_flatten()
        .boxed();
    let first = pieces.try_next().await?;
    let rows = first.as_ref().map_or(usize::MAX, light_rows);
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

/// The context with batches of at most so many rows.
fn with_batch_rows(context: &TaskContext, rows: usize) -> Arc<TaskContext> {
    let config = context.session_config().clone();
    let rows = rows.min(config.batch_size());
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
    let bytes: usize = batch.columns().iter().map(|column| bytes(column)).sum();
    let row_bytes = bytes / batch.num_rows().max(1);
    (SORTED_BYTES / row_bytes.max(1)).max(1)
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
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::{BinaryArray, BinaryViewArray, UInt64Array};
    use arrow::datatypes::{Field, UInt64Type};
    use datafusion::datasource::memory::MemorySourceConfig;
    use datafusion::physical_plan::collect;
    use datafusion::prelude::SessionContext;
    use evermap_schemas::Kind;

    use super::*;
    use crate::error::fault_of;
    use crate::nodes::node::ordering;
    use crate::sql::{Limits, context};

    /// Numbers, each with so many bytes, in no order and batches of 64; views share what they show.
    fn heavy(rows: u64, bytes: usize, views: bool) -> Arc<dyn ExecutionPlan> {
        let numbers: Vec<u64> = (0..rows).map(|row| row * 7919 % rows).collect();
        let batch = |numbers: &[u64]| {
            let values = numbers.iter().map(|number| vec![*number as u8; bytes]);
            let values: ArrayRef = match views {
                true => Arc::new(BinaryViewArray::from_iter_values(values)),
                false => Arc::new(BinaryArray::from_iter_values(values)),
            };
            let numbers: ArrayRef = Arc::new(UInt64Array::from(numbers.to_vec()));
            let members = [("bytes", values)].map(|(name, column)| {
                let field = Field::new(name, column.data_type().clone(), false);
                (Arc::new(field), column)
            });
            let values: ArrayRef = Arc::new(StructArray::from(members.to_vec()));
            RecordBatch::try_from_iter([("number", numbers), ("values", values)]).unwrap()
        };
        let batches: Vec<_> = numbers.chunks(64).map(batch).collect();
        let schema = batches[0].schema();
        MemorySourceConfig::try_new_exec(&[batches], schema, None).unwrap()
    }

    fn small() -> SessionContext {
        let memory_bytes = 24 << 20;
        let partitions = 1;
        context(Limits {
            memory_bytes,
            partitions,
        })
        .unwrap()
    }

    /// The bytes in a row, and the first of them.
    fn value(batch: &RecordBatch, row: usize) -> (usize, u8) {
        let values = batch.column(1).as_struct().column(0);
        let bytes = match values.data_type() {
            DataType::BinaryView => values.as_binary_view().value(row),
            _ => values.as_binary::<i32>().value(row),
        };
        (bytes.len(), bytes[0])
    }

    #[tokio::test]
    async fn heavy_rows_are_sorted_where_a_batch_of_them_does_not_fit() {
        for views in [false, true] {
            let context = small();
            let rows = heavy(300, 150_000, views);
            let order = ordering(["number"], &rows.schema()).unwrap();
            let plain: Arc<dyn ExecutionPlan> = Arc::new(SortExec::new(order, rows));
            if !views {
                let refused = collect(Arc::clone(&plain), context.task_ctx()).await;
                assert_eq!(fault_of(&refused.unwrap_err()).kind, Kind::Resource);
            }

            let state = context.state();
            let light = LightBatches.optimize(plain, state.config_options());
            let light = light.unwrap();
            let batches = collect(Arc::clone(&light), context.task_ctx()).await;
            let mut number = 0;
            for batch in &batches.unwrap() {
                assert!(batch.num_rows() <= 7, "{} rows", batch.num_rows());
                let numbers = batch.column(0).as_primitive::<UInt64Type>();
                for (row, found) in numbers.values().iter().enumerate() {
                    assert_eq!(*found, number);
                    assert_eq!(value(batch, row), (150_000, number as u8));
                    number += 1;
                }
            }
            assert_eq!(number, 300);
            let metrics = light.metrics().unwrap();
            assert_eq!(metrics.output_rows(), Some(300));
            assert!(metrics.elapsed_compute() > Some(1_000));
        }
    }

    #[tokio::test]
    async fn light_rows_are_sorted_as_many_at_a_time_as_the_context_says() {
        let context = small();
        let order = ordering(["number"], &heavy(1, 1, false).schema()).unwrap();
        let sort = sorted(heavy(1000, 8, false), order).unwrap();
        let batches = collect(sort, context.task_ctx()).await.unwrap();
        let rows: Vec<_> = batches.iter().map(RecordBatch::num_rows).collect();
        let most = context.copied_config().batch_size();
        assert!(
            rows[0] == most && rows.iter().sum::<usize>() == 1000,
            "{rows:?}"
        );
    }
}
