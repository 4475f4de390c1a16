//! The plan node of an as-of join.

use std::fmt;
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use datafusion::common::{Result, internal_err};
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::{
    Distribution, EquivalenceProperties, LexOrdering, OrderingRequirements, PhysicalSortExpr,
};
use datafusion::physical_plan::metrics::{BaselineMetrics, RecordOutput};
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::{
    ExecutionPlan, ExecutionPlanProperties, InputDistributionRequirements, Partitioning,
};
use futures::StreamExt;

use crate::nodes::node::{Duty, Need, Node, first};
use crate::sql::as_of::condition::{Condition, KEY_ORDER, Pair, Value};
use crate::sql::as_of::merge::Merge;

/// Merges two tables that are ordered by keys and time.
pub struct AsOf {
    /// When rows match.
    pub condition: Arc<Condition<Value>>,
    /// The columns of both tables; those of the right may be null.
    pub schema: SchemaRef,
}

/// One side of a pair.
type Side = fn(&Pair) -> &Value;

const SIDES: [Side; 2] = [|pair| &pair.0, |pair| &pair.1];

impl AsOf {
    fn keys(&self, side: Side) -> Vec<Value> {
        self.condition.keys.iter().map(side).cloned().collect()
    }

    fn order(&self, side: Side) -> Option<OrderingRequirements> {
        let keys = self.keys(side).into_iter();
        let keys = keys.map(|expr| PhysicalSortExpr::new(expr, KEY_ORDER));
        let time = Arc::clone(side(&self.condition.times));
        let time = PhysicalSortExpr::new(time, self.condition.time_order());
        LexOrdering::new(keys.chain([time])).map(OrderingRequirements::from)
    }
}

impl fmt::Display for AsOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.condition.fmt(f)
    }
}

impl Duty for AsOf {
    const NAME: &'static str = "AsOfJoinExec";
    type Shared = ();

    fn needs(&self) -> Vec<Need> {
        let parallel = !self.condition.keys.is_empty();
        let need = Need {
            parallel,
            ..Need::any()
        };
        vec![need.clone(), need]
    }

    fn distribution(&self, _: &[Arc<dyn ExecutionPlan>]) -> InputDistributionRequirements {
        if self.condition.keys.is_empty() {
            return InputDistributionRequirements::new(vec![Distribution::SinglePartition; 2]);
        }
        let by_keys = SIDES.map(|side| Distribution::KeyPartitioned(self.keys(side)));
        InputDistributionRequirements::co_partitioned(by_keys.to_vec())
    }

    fn ordering(&self, _: &[Arc<dyn ExecutionPlan>]) -> Vec<Option<OrderingRequirements>> {
        SIDES.map(|side| self.order(side)).to_vec()
    }

    fn expressions(&self) -> Vec<&Value> {
        self.condition.values().collect()
    }

    fn output(
        &self,
        children: &[Arc<dyn ExecutionPlan>],
    ) -> Result<(EquivalenceProperties, Partitioning)> {
        let partitions = first(children)?.output_partitioning().partition_count();
        Ok((
            EquivalenceProperties::new(Arc::clone(&self.schema)),
            Partitioning::UnknownPartitioning(partitions),
        ))
    }

    fn keeps_order(&self) -> bool {
        true
    }

    fn execute(
        node: &Node<Self>,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        let [left, right] = node.children.as_slice() else {
            return internal_err!("an as-of join has two children");
        };
        let left = left.execute(partition, Arc::clone(&context))?;
        let right = right.execute(partition, context)?;
        let (condition, schema) = (&node.duty.condition, &node.duty.schema);
        let merge = Merge::new(left, right, Arc::clone(condition), Arc::clone(schema))?;
        let metrics = BaselineMetrics::new(&node.metrics, partition);
        let rows = merge.rows().map(move |batch| batch.record_output(&metrics));
        let schema = Arc::clone(schema);
        Ok(Box::pin(RecordBatchStreamAdapter::new(schema, rows)))
    }
}
