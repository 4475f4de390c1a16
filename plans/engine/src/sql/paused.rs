//! Pauses of what makes much of one batch. DataFusion pauses where rows are read, so that a query which nobody waits for ends
//! and a thread sees to others; of a batch that is read a join may make as many as the other side has rows.

use std::fmt::{self, Display, Formatter};
use std::hash::{Hash, Hasher};
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, FieldRef, Schema};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::error::Result;
use datafusion::logical_expr::ColumnarValue;
use datafusion::physical_expr::PhysicalExpr;
use datafusion::physical_optimizer::PhysicalOptimizerRule;
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_plan::coop::CooperativeExec;
use datafusion::physical_plan::joins::utils::JoinFilter;
use datafusion::physical_plan::joins::{NestedLoopJoinExec, NestedLoopJoinExecBuilder};
use datafusion::physical_plan::unnest::UnnestExec;

use crate::sql::term::go_on;

/// The rule that has joins and lists pause between the batches that they make, and joins that meet all pairs of rows ask
/// between those whether somebody still waits.
#[derive(Debug)]
pub struct Pauses;

impl PhysicalOptimizerRule for Pauses {
    fn optimize(
        &self,
        plan: Arc<dyn ExecutionPlan>,
        _options: &ConfigOptions,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        go_on()?;
        let paused = plan.transform_up(|plan| {
            let makes_many = plan.children().len() > 1 || plan.is::<UnnestExec>();
            if !makes_many {
                return Ok(Transformed::no(plan));
            }
            let asks = asking(&plan)?.unwrap_or(plan);
            Ok(Transformed::yes(Arc::new(CooperativeExec::new(asks)) as _))
        });
        Ok(paused?.data)
    }

    fn name(&self) -> &str {
        "pauses"
    }

    fn schema_check(&self) -> bool {
        true
    }
}

/// A join that meets all pairs of rows, so that its filter asks; `None` for another plan.
fn asking(plan: &Arc<dyn ExecutionPlan>) -> Result<Option<Arc<dyn ExecutionPlan>>> {
    let Some(join) = plan.downcast_ref::<NestedLoopJoinExec>() else {
        return Ok(None);
    };
    let Some(filter) = join.filter() else {
        return Ok(None);
    };
    let asking = JoinFilter::new(
        Arc::new(Asking(Arc::clone(filter.expression()))),
        filter.column_indices().to_vec(),
        Arc::clone(filter.schema()),
    );
    let join = NestedLoopJoinExecBuilder::from(join).with_filter(Some(asking));
    Ok(Some(Arc::new(join.build()?)))
}

/// An expression that asks whether somebody still waits before it is evaluated.
#[derive(Debug, Eq)]
struct Asking(Arc<dyn PhysicalExpr>);

impl Hash for Asking {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.hash(state);
    }
}

// A derived one moves what the pointer points to (rust-lang/rust#78808).
impl PartialEq for Asking {
    fn eq(&self, other: &Self) -> bool {
        self.0.eq(&other.0)
    }
}

impl Display for Asking {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl PhysicalExpr for Asking {
    fn data_type(&self, rows: &Schema) -> Result<DataType> {
        self.0.data_type(rows)
    }

    fn nullable(&self, rows: &Schema) -> Result<bool> {
        self.0.nullable(rows)
    }

    fn return_field(&self, rows: &Schema) -> Result<FieldRef> {
        self.0.return_field(rows)
    }

    fn evaluate(&self, rows: &RecordBatch) -> Result<ColumnarValue> {
        go_on()?;
        self.0.evaluate(rows)
    }

    fn children(&self) -> Vec<&Arc<dyn PhysicalExpr>> {
        vec![&self.0]
    }

    fn with_new_children(
        self: Arc<Self>,
        children: Vec<Arc<dyn PhysicalExpr>>,
    ) -> Result<Arc<dyn PhysicalExpr>> {
        let inner = children.into_iter().next();
        Ok(Arc::new(Self(inner.unwrap_or_else(|| Arc::clone(&self.0)))))
    }

    fn fmt_sql(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.0.fmt_sql(f)
    }
}
