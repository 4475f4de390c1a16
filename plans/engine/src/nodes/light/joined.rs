//! Joins that read logs, few rows at a time. DataFusion's joins make batches of so many rows, whatever they weigh, and a row of a log may be an image; of files of a map it is known how heavy their rows are, and batches are as few
//! rows as that asks for.

use std::fmt;
use std::sync::Arc;

use arrow::datatypes::DataType;
use datafusion::datasource::source::DataSourceExec;
use datafusion::error::Result;
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_plan::joins::{
    CrossJoinExec, HashJoinExec, NestedLoopJoinExec, PiecewiseMergeJoinExec, SortMergeJoinExec,
};
use datafusion::physical_plan::{ExecutionPlan, replace_children_if_necessary};
use evermap_datasets::scan::scanned;

use super::filtered::{all_gathered, node};
use super::with_batch_rows;
use crate::nodes::node::{Duty, Node, first};

/// Rows of a batch that a join makes: 100 MB of raw images of 1920 by 1080 pixels.
const JOINED_ROWS: usize = 16;

/// What stands in for a join that has bytes or lists of a log; `None` for other plans.
///
/// # Errors
/// When a plan does not take its inputs.
pub fn light_join(
    plan: &Arc<dyn ExecutionPlan>,
    most: usize,
) -> Result<Option<Arc<dyn ExecutionPlan>>> {
    let joins = plan.is::<HashJoinExec>()
        || plan.is::<SortMergeJoinExec>()
        || plan.is::<NestedLoopJoinExec>()
        || plan.is::<PiecewiseMergeJoinExec>()
        || plan.is::<CrossJoinExec>();
    let schema = plan.schema();
    let mut columns = schema.fields().iter();
    if !joins || !columns.any(|column| is_of_bytes(column.data_type())) || !reads_log(plan) {
        return Ok(None);
    }
    let as_before = |input: &Arc<dyn ExecutionPlan>| node(Batches { rows: most }, input);
    let inputs = plan.children().into_iter().map(as_before);
    let join = replace_children_if_necessary(Arc::clone(plan), inputs.collect::<Result<_>>()?)?;
    all_gathered(&node(Batches { rows: JOINED_ROWS }, &join)?).map(Some)
}

fn is_of_bytes(kind: &DataType) -> bool {
    match kind {
        DataType::Struct(members) => members.iter().any(|member| is_of_bytes(member.data_type())),
        DataType::FixedSizeList(value, _) => is_of_bytes(value.data_type()),
        DataType::Binary | DataType::LargeBinary | DataType::BinaryView => true,
        other => other.is_list() || matches!(other, DataType::Map(..)),
    }
}

fn reads_log(plan: &Arc<dyn ExecutionPlan>) -> bool {
    let scan = plan.downcast_ref::<DataSourceExec>();
    scan.is_some_and(|scan| scanned(scan).is_some()) || plan.children().into_iter().any(reads_log)
}

/// So many rows in a batch of what is below, as far as that makes batches.
struct Batches {
    rows: usize,
}

impl fmt::Display for Batches {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "rows={}", self.rows)
    }
}

impl Duty for Batches {
    const NAME: &'static str = "BatchesExec";
    type Shared = ();

    fn keeps_order(&self) -> bool {
        true
    }

    fn execute(
        node: &Node<Self>,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        first(&node.children)?.execute(partition, with_batch_rows(&context, node.duty.rows))
    }
}
