//! Structs, maps and lists of lists, which clients of Postgres read as JSON. Lists of plain values are arrays.

use arrow::datatypes::DataType;
use datafusion::common::{Column, Result};
use datafusion::error::DataFusionError;
use datafusion::logical_expr::{Expr, LogicalPlan, LogicalPlanBuilder};
use evermap_functions::to_json;

/// The plan with nested columns as JSON, under their names.
///
/// # Errors
/// What planning says.
pub fn as_json(plan: LogicalPlan) -> Result<LogicalPlan, DataFusionError> {
    let schema = plan.schema();
    if !schema
        .fields()
        .iter()
        .any(|field| is_nested(field.data_type()))
    {
        return Ok(plan);
    }
    let columns = schema.iter().map(|(qualifier, field)| {
        let column = Expr::Column(Column::new(qualifier.cloned(), field.name()));
        match is_nested(field.data_type()) {
            true => to_json().call(vec![column]).alias(field.name()),
            false => column,
        }
    });
    let columns: Vec<Expr> = columns.collect();
    LogicalPlanBuilder::from(plan).project(columns)?.build()
}

fn is_nested(found: &DataType) -> bool {
    match found {
        DataType::List(item) | DataType::LargeList(item) => item.data_type().is_nested(),
        other => other.is_nested(),
    }
}
