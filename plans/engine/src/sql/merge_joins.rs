//! Merge joins that DataFusion 55 cannot run as it plans them. They come where memory is too small to join by hashing.
//!
//! One that asks whether there is a match (`IN`, `EXISTS`, `INTERSECT`) compares keys of few types once a group of equal ones
//! may go on in the next batch, and instants with a time zone are none of them. So they are compared by their numbers, which
//! are in the same order. An outer one that has a further condition asks it of rows without a partner, too, whose values are
//! null, and refuses them in columns that are never null. So its condition's columns may be.

use std::sync::Arc;

use arrow::datatypes::{DataType, Schema};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::error::Result;
use datafusion::logical_expr::JoinType;
use datafusion::physical_expr::PhysicalExpr;
use datafusion::physical_expr::expressions::cast;
use datafusion::physical_optimizer::PhysicalOptimizerRule;
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_plan::joins::SortMergeJoinExec;
use datafusion::physical_plan::joins::utils::JoinFilter;

/// The rule that has merge joins run.
#[derive(Debug)]
pub struct MergeJoins;

impl PhysicalOptimizerRule for MergeJoins {
    fn optimize(
        &self,
        plan: Arc<dyn ExecutionPlan>,
        _: &ConfigOptions,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let sound = plan.transform_up(|plan| match sound(&plan)? {
            Some(sound) => Ok(Transformed::yes(sound)),
            None => Ok(Transformed::no(plan)),
        });
        Ok(sound?.data)
    }

    fn name(&self) -> &str {
        "merge_joins"
    }

    fn schema_check(&self) -> bool {
        true
    }
}

/// What stands in for a merge join that would not run; `None` for all other plans.
fn sound(plan: &Arc<dyn ExecutionPlan>) -> Result<Option<Arc<dyn ExecutionPlan>>> {
    let Some(join) = plan.downcast_ref::<SortMergeJoinExec>() else {
        return Ok(None);
    };
    let (left, right) = (join.left(), join.right());
    let schemas = [left.schema(), right.schema()];
    let on = join.on().iter();
    let on = on.map(|(a, b)| Ok((as_number(a, &schemas[0])?, as_number(b, &schemas[1])?)));
    let on = match join.join_type() {
        JoinType::Inner | JoinType::Left | JoinType::Right | JoinType::Full => join.on().to_vec(),
        _ => on.collect::<Result<_>>()?,
    };
    let filter = join.filter().as_ref().map(with_nulls);
    let sound = SortMergeJoinExec::try_new(
        Arc::clone(left),
        Arc::clone(right),
        on,
        filter,
        join.join_type(),
        join.sort_options().to_vec(),
        join.null_equality(),
    )?;
    Ok(Some(Arc::new(sound)))
}

/// An instant with a time zone, or a length of time, by its number.
fn as_number(key: &Arc<dyn PhysicalExpr>, of: &Schema) -> Result<Arc<dyn PhysicalExpr>> {
    match key.data_type(of)? {
        DataType::Timestamp(_, Some(_)) | DataType::Duration(_) => {
            cast(Arc::clone(key), of, DataType::Int64)
        }
        _ => Ok(Arc::clone(key)),
    }
}

/// The same condition, of columns that may be null.
fn with_nulls(filter: &JoinFilter) -> JoinFilter {
    let fields = filter.schema().fields().iter();
    let fields = fields.map(|field| field.as_ref().clone().with_nullable(true));
    JoinFilter::new(
        Arc::clone(filter.expression()),
        filter.column_indices().to_vec(),
        Arc::new(Schema::new(fields.collect::<Vec<_>>())),
    )
}
