//! Rows on their way to what would make much of a batch: fewer at a time, or refused. DataFusion counts rows, and neither
//! what an expression makes of each, nor how often a row is repeated, nor what a window holds.

use std::fmt;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, GenericListArray, OffsetSizeTrait, RecordBatch};
use arrow::buffer::OffsetBuffer;
use arrow::datatypes::DataType;
use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::datasource::physical_plan::{FileScanConfig, FileScanConfigBuilder};
use datafusion::datasource::source::DataSourceExec;
use datafusion::error::{DataFusionError, Result};
use datafusion::execution::memory_pool::MemoryConsumer;
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::expressions::{InListExpr, Literal};
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::unnest::UnnestExec;
use datafusion::physical_plan::windows::WindowAggExec;
use datafusion::physical_plan::{ExecutionPlan, replace_children_if_necessary};
use datafusion::scalar::ScalarValue;
use futures::{StreamExt, TryStreamExt, stream};

use crate::nodes::node::{Duty, Node, first};
use crate::nodes::weight::bytes;

/// Bytes that are made of a batch, unless it is of a single row.
const MADE_BYTES: usize = 8 << 20;

/// A plan whose rows come so that what it makes of them is light; `None` where it is as it is.
///
/// # Errors
/// When a plan does not take its inputs.
pub fn spared(
    plan: &Arc<dyn ExecutionPlan>,
    batch_rows: usize,
) -> Result<Option<Arc<dyn ExecutionPlan>>> {
    let duty = if let Some(unnest) = plan.downcast_ref::<UnnestExec>() {
        short_lists(unnest).map(Sparing::Lists)
    } else if plan.is::<WindowAggExec>() {
        Some(Sparing::Held)
    } else {
        let rows = MADE_BYTES / literals(plan)?.max(1);
        (rows < batch_rows).then(|| Sparing::Rows(rows.max(1)))
    };
    let Some(duty) = duty else {
        return Ok(None);
    };
    if let (Sparing::Rows(rows), Some(scan)) = (&duty, plan.downcast_ref::<DataSourceExec>()) {
        let config = scan.data_source().downcast_ref::<FileScanConfig>();
        return Ok(config.map(|config| {
            let fewer = FileScanConfigBuilder::from(config.clone()).with_batch_size(Some(*rows));
            DataSourceExec::from_data_source(fewer.build()) as Arc<dyn ExecutionPlan>
        }));
    }
    let duty = Arc::new(duty);
    let spare = |input: &Arc<dyn ExecutionPlan>| {
        let spared = Node::try_new(Arc::clone(&duty), vec![Arc::clone(input)])?;
        Ok(Arc::new(spared) as Arc<dyn ExecutionPlan>)
    };
    let inputs = plan.children().into_iter().map(spare);
    let inputs: Vec<_> = inputs.collect::<Result<_>>()?;
    match inputs.is_empty() {
        true => Ok(None),
        false => replace_children_if_necessary(Arc::clone(plan), inputs).map(Some),
    }
}

/// The columns of lists that are unnested level by level no further than once; `None` where there are others.
fn short_lists(unnest: &UnnestExec) -> Option<Vec<usize>> {
    let (lists, schema) = (unnest.list_column_indices(), unnest.input().schema());
    let is_plain = |index: usize| {
        let kind = schema.field(index).data_type();
        matches!(kind, DataType::List(_) | DataType::LargeList(_))
    };
    let mut columns = lists.iter();
    let are_plain = columns.all(|list| list.depth == 1 && is_plain(list.index_in_input_schema));
    let columns = lists.iter().map(|list| list.index_in_input_schema);
    (are_plain && !lists.is_empty()).then(|| columns.collect())
}

/// Bytes of the texts and lists that stand in the expressions of a plan: each may be repeated for every row. Those that a
/// value is looked for among are not.
fn literals(plan: &Arc<dyn ExecutionPlan>) -> Result<usize> {
    let mut found = 0_usize;
    plan.apply_expressions(&mut |expr| {
        expr.apply(|part| {
            if part.is::<InListExpr>() {
                return Ok(TreeNodeRecursion::Jump);
            }
            if let Some(literal) = part.downcast_ref::<Literal>() {
                let beside = literal
                    .value()
                    .size()
                    .saturating_sub(size_of::<ScalarValue>());
                found = found.saturating_add(beside);
            }
            Ok(TreeNodeRecursion::Continue)
        })?;
        Ok(TreeNodeRecursion::Continue)
    })?;
    Ok(found)
}

/// How rows are handed on.
pub enum Sparing {
    /// So many at a time.
    Rows(usize),
    /// As few at a time as stay light when these lists become rows, long lists in pieces.
    Lists(Vec<usize>),
    /// As they come, each twice in memory until there are no more: a window holds them all, and copies them once.
    Held,
}

impl fmt::Display for Sparing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rows(rows) => write!(f, "rows={rows}"),
            Self::Lists(columns) => write!(f, "lists={columns:?}"),
            Self::Held => f.write_str("held"),
        }
    }
}

impl Duty for Sparing {
    const NAME: &'static str = "SpareExec";
    type Shared = ();

    fn keeps_order(&self) -> bool {
        true
    }

    fn execute(
        node: &Node<Self>,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        let most = context.session_config().batch_size();
        let held = MemoryConsumer::new("window").register(context.memory_pool());
        let input = first(&node.children)?.execute(partition, context)?;
        let (schema, duty) = (input.schema(), Arc::clone(&node.duty));
        let handed_on = move |batch: RecordBatch| -> Result<Vec<RecordBatch>> {
            match &*duty {
                Sparing::Rows(rows) => Ok(cut(&batch, *rows)),
                Sparing::Lists(columns) => in_pieces(&batch, columns, most),
                Sparing::Held => {
                    let columns = batch.columns().iter();
                    held.try_grow(2 * columns.map(|column| bytes(column)).sum::<usize>())?;
                    Ok(vec![batch])
                }
            }
        };
        let batches = input
            .map(move |batch| {
                let batches = handed_on(batch?)?.into_iter();
                Ok::<_, DataFusionError>(stream::iter(batches.map(Ok)))
            })
            .try_flatten();
        Ok(Box::pin(RecordBatchStreamAdapter::new(schema, batches)))
    }
}

/// A batch as several of so many rows.
fn cut(batch: &RecordBatch, rows: usize) -> Vec<RecordBatch> {
    let all = batch.num_rows();
    let starts = (0..all).step_by(rows.max(1));
    starts
        .map(|start| batch.slice(start, rows.min(all - start)))
        .collect()
}

/// A batch as several whose lists become at most so many rows, and no more bytes than [`MADE_BYTES`], unless of one value.
fn in_pieces(batch: &RecordBatch, lists: &[usize], most: usize) -> Result<Vec<RecordBatch>> {
    let all = batch.num_rows();
    let lengths: Vec<usize> = (0..all).map(|row| longest(batch, lists, row)).collect();
    let beside = |batch: &RecordBatch| -> usize {
        let columns = batch.columns().iter().enumerate();
        let beside = columns.filter(|(at, _)| !lists.contains(at));
        beside.map(|(_, column)| bytes(column)).sum()
    };
    let longest_of_all = lengths.iter().copied().max().unwrap_or(0);
    if longest_of_all <= most && beside(batch).saturating_mul(longest_of_all) <= MADE_BYTES {
        return Ok(vec![batch.clone()]);
    }
    let (mut pieces, mut start, mut made) = (Vec::new(), 0, 0_usize);
    for (row, length) in lengths.into_iter().enumerate() {
        let one = batch.slice(row, 1);
        let each = beside(&one).max(1);
        let values = (MADE_BYTES / each).clamp(1, most);
        let more = each.saturating_mul(length);
        if length > values || made.saturating_add(more) > MADE_BYTES {
            if start < row {
                pieces.push(batch.slice(start, row - start));
            }
            (start, made) = (row, 0);
        }
        if length > values {
            let starts = (0..length).step_by(values);
            for from in starts {
                pieces.push(piece(&one, lists, from, values)?);
            }
            start = row + 1;
        } else {
            made += more;
        }
    }
    if start < all {
        pieces.push(batch.slice(start, all - start));
    }
    Ok(pieces)
}

/// How many rows a row becomes.
fn longest(batch: &RecordBatch, lists: &[usize], row: usize) -> usize {
    let length = |column: &usize| {
        let column = batch.column(*column);
        match column.data_type() {
            _ if column.is_null(row) => 0,
            DataType::List(_) => column.as_list::<i32>().value_length(row) as usize,
            DataType::LargeList(_) => column.as_list::<i64>().value_length(row) as usize,
            _ => 0,
        }
    };
    lists.iter().map(length).max().unwrap_or(0)
}

/// A row with so many values of its lists.
fn piece(row: &RecordBatch, lists: &[usize], from: usize, values: usize) -> Result<RecordBatch> {
    let columns = row
        .columns()
        .iter()
        .enumerate()
        .map(|(at, column)| match column.data_type() {
            _ if !lists.contains(&at) => Ok(Arc::clone(column)),
            DataType::List(_) => part(column.as_list::<i32>(), from, values),
            DataType::LargeList(_) => part(column.as_list::<i64>(), from, values),
            _ => Ok(Arc::clone(column)),
        });
    let columns = columns.collect::<Result<Vec<ArrayRef>>>()?;
    Ok(RecordBatch::try_new(row.schema(), columns)?)
}

/// So many values of a list that is alone; a null stays one.
fn part<O: OffsetSizeTrait>(
    list: &GenericListArray<O>,
    from: usize,
    values: usize,
) -> Result<ArrayRef> {
    if list.is_null(0) {
        return Ok(Arc::new(list.clone()));
    }
    let all = list.value(0);
    let from = from.min(all.len());
    let some = all.slice(from, values.min(all.len() - from));
    let offsets = OffsetBuffer::from_lengths([some.len()]);
    let (DataType::List(field) | DataType::LargeList(field)) = list.data_type() else {
        return Ok(Arc::new(list.clone()));
    };
    let field = Arc::clone(field);
    Ok(Arc::new(GenericListArray::<O>::try_new(
        field, offsets, some, None,
    )?))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::util::display::array_value_to_string;
    use evermap_schemas::Kind;

    use super::*;
    use crate::error::fault_of;
    use crate::sql::{Limits, context, read_only};

    /// The batches of a query with so much memory.
    async fn asked(query: &str, memory_bytes: usize) -> Result<Vec<RecordBatch>> {
        let limits = Limits {
            memory_bytes,
            ..Limits::one_partition()
        };
        let context = context(limits).unwrap();
        read_only(&context, query).await.unwrap().collect().await
    }

    fn rows(batches: &[RecordBatch]) -> usize {
        batches.iter().map(RecordBatch::num_rows).sum()
    }

    #[tokio::test]
    async fn what_is_made_of_each_row_is_made_of_few_rows_at_a_time() {
        let memory = 128 << 20;
        for query in [
            "SELECT repeat('a', 1000000) AS t, value FROM generate_series(1, 60)",
            "SELECT repeat('a', 100000) || value AS t FROM generate_series(1, 600)",
            "SELECT t, unnest(l) AS n FROM (SELECT repeat('b', 100000) || value AS t, range(0, 300) AS l \
             FROM generate_series(1, 2))",
        ] {
            let batches = asked(query, memory).await.unwrap();
            assert!(
                rows(&batches).is_multiple_of(60),
                "{query}: {}",
                rows(&batches)
            );
            for batch in &batches {
                let bytes: usize = batch.columns().iter().map(|column| bytes(column)).sum();
                assert!(bytes < 16 << 20, "{query}: {bytes} in {}", batch.num_rows());
            }
        }
        // A list that is looked through is there once.
        let many = (0..20_000).map(|n| format!("'a text that is long enough {n}'"));
        let many = many.collect::<Vec<_>>().join(", ");
        let found = format!(
            "SELECT count(*) AS n FROM generate_series(1, 9) WHERE CAST(value AS TEXT) IN ({many})"
        );
        assert_eq!(rows(&asked(&found, memory).await.unwrap()), 1);
    }

    #[tokio::test]
    async fn lists_in_pieces_become_the_rows_that_they_were() {
        let query = "SELECT k, t, unnest(a) AS a, unnest(b) AS b FROM (VALUES \
            (1, repeat('x', 3000000), [1, 2, 3], [10, 20]), (2, 'y', NULL, [30]), (3, 'z', NULL, NULL), \
            (4, repeat('w', 3000000), [4, NULL, 5], NULL)) AS v (k, t, a, b)";
        let batches = asked(query, 256 << 20).await.unwrap();
        let mut found = Vec::new();
        for batch in &batches {
            let text = |column: usize, row: usize| {
                array_value_to_string(batch.column(column), row).unwrap()
            };
            let line = |row: usize| [0, 2, 3].map(|column| text(column, row)).join(" ");
            found.extend((0..batch.num_rows()).map(line));
        }
        let expected = ["1 1 10", "1 2 20", "1 3 ", "2  30", "4 4 ", "4  ", "4 5 "];
        assert_eq!(found, expected);
        let long = "SELECT count(*) AS n, sum(v) AS s FROM (SELECT unnest(range(0, 100000)) AS v)";
        let batches = asked(long, 256 << 20).await.unwrap();
        let shown = [0, 1].map(|at| array_value_to_string(batches[0].column(at), 0).unwrap());
        assert_eq!(shown, ["100000", "4999950000"]);
    }

    #[tokio::test]
    async fn a_window_over_more_than_the_memory_is_refused() {
        let window = |rows: usize| {
            format!(
                "SELECT max(w) FROM (SELECT max(t) OVER () AS w FROM \
                 (SELECT repeat('a', 1000) || value AS t FROM generate_series(1, {rows})))"
            )
        };
        let memory = 16 << 20;
        assert_eq!(rows(&asked(&window(500), memory).await.unwrap()), 1);
        let refused = asked(&window(50_000), memory).await.unwrap_err();
        assert_eq!(fault_of(&refused).kind, Kind::Resource, "{refused}");
    }
}
