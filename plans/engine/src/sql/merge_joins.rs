//! Merge joins that DataFusion 55 cannot run as it plans them. They come where memory is too small to join by hashing.
//!
//! One that asks whether there is a match (`IN`, `EXISTS`, `INTERSECT`) compares keys of few types once a group of equal ones
//! may go on in the next batch, and panics at NaN. So other keys are compared by bytes that are equal where they are. An outer
//! one that has a further condition asks it of rows without a partner, too, whose values are null, and refuses them in columns
//! that are never null. So its condition's columns may be.

use std::sync::Arc;

use arrow::array::{Array, BinaryArray};
use arrow::datatypes::{DataType, Schema};
use arrow::row::{RowConverter, SortField};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::common::{DFSchema, JoinConstraint, exec_err};
use datafusion::error::Result;
use datafusion::logical_expr::expr::ScalarFunction;
use datafusion::logical_expr::{
    ColumnarValue, Expr, ExprSchemable, JoinType, LogicalPlan, ScalarFunctionArgs, ScalarUDF,
    ScalarUDFImpl, Signature, Volatility,
};
use datafusion::optimizer::{ApplyOrder, OptimizerConfig, OptimizerRule};
use datafusion::physical_optimizer::PhysicalOptimizerRule;
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_plan::joins::SortMergeJoinExec;
use datafusion::physical_plan::joins::utils::JoinFilter;

/// The rule that has keys compared which a merge join knows.
#[derive(Debug)]
pub struct MergeKeys;

impl OptimizerRule for MergeKeys {
    fn name(&self) -> &str {
        "merge_keys"
    }

    fn apply_order(&self) -> Option<ApplyOrder> {
        Some(ApplyOrder::BottomUp)
    }

    fn rewrite(
        &self,
        plan: LogicalPlan,
        config: &dyn OptimizerConfig,
    ) -> Result<Transformed<LogicalPlan>> {
        let LogicalPlan::Join(mut join) = plan else {
            return Ok(Transformed::no(plan));
        };
        let has_partners = matches!(
            join.join_type,
            JoinType::Inner | JoinType::Left | JoinType::Right | JoinType::Full
        );
        if config.options().optimizer.prefer_hash_join || has_partners {
            return Ok(Transformed::no(LogicalPlan::Join(join)));
        }
        let mut is_changed = false;
        for (left, right) in &mut join.on {
            is_changed |= by_bytes(left, join.left.schema())?;
            is_changed |= by_bytes(right, join.right.schema())?;
        }
        if is_changed {
            // Keys that are no columns are none that USING names.
            join.join_constraint = JoinConstraint::On;
        }
        let join = LogicalPlan::Join(join);
        Ok(Transformed::new_transformed(join, is_changed))
    }
}

/// Has a key go by its bytes where a merge join does not compare its type; whether it does not.
fn by_bytes(key: &mut Expr, of: &DFSchema) -> Result<bool> {
    let is_compared = match key.get_type(of)? {
        DataType::Null | DataType::Boolean | DataType::Timestamp(_, None) => true,
        DataType::Decimal128(..) | DataType::Date32 | DataType::Date64 => true,
        kind => kind.is_integer() || kind.is_string() || kind.is_binary(),
    };
    if !is_compared {
        let args = vec![std::mem::take(key)];
        let bytes = Arc::new(ScalarUDF::new_from_impl(KeyBytes::default()));
        *key = Expr::ScalarFunction(ScalarFunction::new_udf(bytes, args));
    }
    Ok(!is_compared)
}

/// Bytes that are equal where values are; null where these are.
#[derive(Debug, PartialEq, Eq, Hash)]
struct KeyBytes {
    signature: Signature,
}

impl Default for KeyBytes {
    fn default() -> Self {
        Self {
            signature: Signature::any(1, Volatility::Immutable),
        }
    }
}

impl ScalarUDFImpl for KeyBytes {
    fn name(&self) -> &str {
        "key_bytes"
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(DataType::Binary)
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let values = ColumnarValue::values_to_arrays(&args.args)?;
        let [values] = values.as_slice() else {
            return exec_err!("expected one value, found {}", values.len());
        };
        let converter = RowConverter::new(vec![SortField::new(values.data_type().clone())])?;
        let rows = converter.convert_columns(&[Arc::clone(values)])?;
        let (offsets, bytes, _) = rows.try_into_binary()?.into_parts();
        let bytes = BinaryArray::try_new(offsets, bytes, values.logical_nulls())?;
        Ok(ColumnarValue::Array(Arc::new(bytes)))
    }
}

/// The rule that has outer joins ask their condition of rows without a partner.
#[derive(Debug)]
pub struct OuterConditions;

impl PhysicalOptimizerRule for OuterConditions {
    fn optimize(
        &self,
        plan: Arc<dyn ExecutionPlan>,
        _: &ConfigOptions,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let asking = plan.transform_up(|plan| match with_nulls(&plan)? {
            Some(join) => Ok(Transformed::yes(join)),
            None => Ok(Transformed::no(plan)),
        });
        Ok(asking?.data)
    }

    fn name(&self) -> &str {
        "outer_conditions"
    }

    fn schema_check(&self) -> bool {
        true
    }
}

/// A merge join whose condition is of columns that may be null; `None` for all other plans.
fn with_nulls(plan: &Arc<dyn ExecutionPlan>) -> Result<Option<Arc<dyn ExecutionPlan>>> {
    let join = plan.downcast_ref::<SortMergeJoinExec>();
    let Some((join, filter)) = join.and_then(|join| Some((join, join.filter().as_ref()?))) else {
        return Ok(None);
    };
    let fields = filter.schema().fields().iter();
    let fields = fields.map(|field| field.as_ref().clone().with_nullable(true));
    let filter = JoinFilter::new(
        Arc::clone(filter.expression()),
        filter.column_indices().to_vec(),
        Arc::new(Schema::new(fields.collect::<Vec<_>>())),
    );
    let join = SortMergeJoinExec::try_new(
        Arc::clone(join.left()),
        Arc::clone(join.right()),
        join.on().to_vec(),
        Some(filter),
        join.join_type(),
        join.sort_options().to_vec(),
        join.null_equality(),
    )?;
    Ok(Some(Arc::new(join)))
}
