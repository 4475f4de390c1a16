#![allow(clippy::unwrap_used)]

use arrow::array::{BinaryViewArray, StringArray, UInt64Array};
use arrow::datatypes::UInt64Type;
use datafusion::datasource::memory::MemorySourceConfig;
use datafusion::logical_expr::Operator;
use datafusion::physical_expr::expressions::{binary, col, lit};
use datafusion::physical_optimizer::PhysicalOptimizerRule;
use datafusion::physical_plan::collect;

use super::*;
use crate::nodes::light::LightBatches;
use crate::sql::{Limits, context};

fn session() -> datafusion::prelude::SessionContext {
    context(Limits {
        memory_bytes: 64 << 20,
        partitions: 2,
    })
    .unwrap()
}

/// Numbers and texts in batches of so many rows.
fn texts(rows: u64, bytes: usize, batch_rows: usize) -> Arc<dyn ExecutionPlan> {
    let numbers: Vec<u64> = (0..rows).collect();
    let batch = |numbers: &[u64]| {
        let texts = numbers.iter().map(|number| {
            char::from(b'a' + (number % 26) as u8)
                .to_string()
                .repeat(bytes)
        });
        let texts: Arc<dyn arrow::array::Array> = Arc::new(StringArray::from_iter_values(texts));
        let numbers = Arc::new(UInt64Array::from(numbers.to_vec()));
        RecordBatch::try_from_iter([("number", numbers as _), ("text", texts)]).unwrap()
    };
    let mut batches: Vec<_> = numbers.chunks(batch_rows.max(1)).map(batch).collect();
    if batches.is_empty() {
        batches.push(batch(&[]));
    }
    let schema = batches[0].schema();
    MemorySourceConfig::try_new_exec(&[batches], schema, None).unwrap()
}

/// Rows whose number is not below another.
fn filtered(rows: Arc<dyn ExecutionPlan>, least: u64) -> FilterExecBuilder {
    let schema = rows.schema();
    let number = col("number", &schema).unwrap();
    let predicate = binary(number, Operator::GtEq, lit(least), &schema);
    FilterExecBuilder::new(predicate.unwrap(), rows)
}

fn light(plan: Arc<dyn ExecutionPlan>) -> Arc<dyn ExecutionPlan> {
    let state = session().state();
    LightBatches.optimize(plan, state.config_options()).unwrap()
}

async fn batches(plan: &Arc<dyn ExecutionPlan>) -> Vec<RecordBatch> {
    collect(Arc::clone(plan), session().task_ctx())
        .await
        .unwrap()
}

fn numbers(batches: &[RecordBatch]) -> Vec<u64> {
    let column = |batch: &RecordBatch| batch.column_by_name("number").unwrap().clone();
    let columns: Vec<_> = batches.iter().map(column).collect();
    let values =
        |column: &arrow::array::ArrayRef| column.as_primitive::<UInt64Type>().values().to_vec();
    columns.iter().flat_map(values).collect()
}

#[tokio::test]
async fn heavy_rows_stay_in_light_batches_however_they_are_filtered_and_dealt_out() {
    let heavy = || texts(300, 150_000, 16);
    let filter: Arc<dyn ExecutionPlan> = Arc::new(filtered(heavy(), 5).build().unwrap());
    let by_text = Partitioning::Hash(vec![col("text", &heavy().schema()).unwrap()], 2);
    let plans = [
        (filter, 295),
        (
            Arc::new(RepartitionExec::try_new(heavy(), by_text).unwrap()) as _,
            300,
        ),
        (
            Arc::new(RepartitionExec::try_new(heavy(), Partitioning::RoundRobinBatch(2)).unwrap())
                as _,
            300,
        ),
    ];
    for (plan, rows) in plans {
        let most = |batches: &[RecordBatch]| batches.iter().map(RecordBatch::num_rows).max();
        let theirs = batches(&plan).await;
        assert!(most(&theirs) > Some(100), "{:?}", most(&theirs));
        let found = batches(&light(plan)).await;
        assert!(most(&found) <= Some(16), "{:?}", most(&found));
        let mut found = numbers(&found);
        found.sort_unstable();
        assert_eq!(found, Vec::from_iter(300 - rows..300));
    }
}

/// What few rows show of large buffers does not keep these.
#[tokio::test]
async fn rows_that_wait_for_others_let_go_of_what_they_were_cut_from() {
    let value = vec![7_u8; 1000];
    let batch = |number: u64| {
        let views = BinaryViewArray::from_iter_values(vec![&value[..]; 1000]);
        let numbers = UInt64Array::from_iter_values((0..1000).map(|row| number + row));
        RecordBatch::try_from_iter([
            ("number", Arc::new(numbers) as _),
            ("view", Arc::new(views) as _),
        ])
        .unwrap()
    };
    let all: Vec<_> = (0..50).map(batch).collect();
    let rows = MemorySourceConfig::try_new_exec(std::slice::from_ref(&all), all[0].schema(), None)
        .unwrap();
    let filter = light(Arc::new(filtered(rows, 1047).build().unwrap()));
    let found = batches(&filter).await;
    assert_eq!(numbers(&found), [1047, 1047, 1048]);
    let held: usize = found.iter().map(RecordBatch::get_array_memory_size).sum();
    assert!(held < 100_000, "{held}");
}

#[tokio::test]
async fn the_same_rows_come_in_the_same_order() {
    let sizes = [(0, 1), (1, 7), (90, 1), (400, 7), (400, 90)];
    let fetches = [None, Some(1), Some(49), Some(1000)];
    let least = [0, 3, 200, 399, 400];
    for (rows, batch_rows) in sizes {
        for (fetch, least) in fetches
            .iter()
            .flat_map(|fetch| least.map(|least| (*fetch, least)))
        {
            let projection = (least % 2 == 1).then(|| vec![1, 0]);
            let filter = filtered(texts(rows, least as usize / 10, batch_rows), least);
            let filter = filter
                .apply_projection(projection)
                .unwrap()
                .with_fetch(fetch);
            let plain: Arc<dyn ExecutionPlan> = Arc::new(filter.build().unwrap());
            let light = light(Arc::clone(&plain));
            assert_eq!(light.name(), "LightFilterExec");
            assert_eq!(light.schema(), plain.schema());
            let [expected, found] = [batches(&plain).await, batches(&light).await];
            assert_eq!(
                numbers(&found),
                numbers(&expected),
                "{rows} {fetch:?} {least}"
            );
            let texts = |found: &[RecordBatch]| -> Vec<String> {
                let column = |batch: &RecordBatch| batch.column_by_name("text").unwrap().clone();
                let columns: Vec<_> = found.iter().map(column).collect();
                let of = |column: &arrow::array::ArrayRef| {
                    let texts = column.as_string::<i32>();
                    texts
                        .iter()
                        .flatten()
                        .map(str::to_owned)
                        .collect::<Vec<_>>()
                };
                columns.iter().flat_map(of).collect()
            };
            assert_eq!(texts(&found), texts(&expected));
        }
    }
}
