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
async fn small_batches_are_sorted_as_one_and_large_ones_apart() {
    for (rows, bytes, expected) in [(10_000, 8, 1), (300, 150_000, 5), (0, 8, 0)] {
        let plan = heavy(rows.max(1), bytes, false);
        let (schema, context) = (plan.schema(), small());
        let batches = plan.execute(0, context.task_ctx()).unwrap();
        let batches = batches.take(if rows == 0 { 0 } else { usize::MAX });
        let found: Vec<_> = gathered(schema, batches.boxed())
            .try_collect()
            .await
            .unwrap();
        let counted: usize = found.iter().map(RecordBatch::num_rows).sum();
        assert_eq!((found.len(), counted as u64), (expected, rows));
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
