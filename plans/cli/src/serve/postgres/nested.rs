//! Structs, maps and lists of lists, which clients of Postgres read as JSON. Lists of plain values are arrays. Both are so
//! where they are cast to text, too.

use arrow::datatypes::DataType;
use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::common::{DFSchema, Result};
use datafusion::error::DataFusionError;
use datafusion::logical_expr::expr_rewriter::NamePreserver;
use datafusion::logical_expr::utils::merge_schema;
use datafusion::logical_expr::{Expr, ExprSchemable, LogicalPlan};
use evermap_functions::to_json;

use crate::serve::postgres::functions::ARRAY_OUT;
use crate::serve::postgres::geometry::replaced;

/// The plan with what is nested and cast to text as JSON, and lists of plain values as arrays are written.
///
/// # Errors
/// What planning says.
pub fn as_texts(plan: LogicalPlan) -> Result<LogicalPlan, DataFusionError> {
    let texts = plan.transform_up_with_subqueries(|node| {
        let schema = merge_schema(&node.inputs());
        let names = NamePreserver::new(&node);
        let text = |found: Expr| {
            let name = names.save(&found);
            let made = found.transform_up(|found| as_text(found, &schema))?;
            Ok(made.update_data(|made| name.restore(made)))
        };
        let node = node.map_expressions(text)?;
        match node.transformed {
            true => node.map_data(LogicalPlan::recompute_schema),
            false => Ok(node),
        }
    });
    texts.map(|texts| texts.data)
}

fn as_text(found: Expr, schema: &DFSchema) -> Result<Transformed<Expr>, DataFusionError> {
    let Expr::Cast(cast) = &found else {
        return Ok(Transformed::no(found));
    };
    if !cast.field.data_type().is_string() {
        return Ok(Transformed::no(found));
    }
    let value = cast.expr.as_ref().clone();
    Ok(match cast.expr.get_type(schema) {
        Ok(nested) if is_nested(&nested) => Transformed::yes(to_json().call(vec![value])),
        Ok(DataType::List(_)) => Transformed::yes(ARRAY_OUT.call(vec![value])),
        _ => Transformed::no(found),
    })
}

/// The plan with nested columns as JSON, under their names.
///
/// # Errors
/// What planning says.
pub fn as_json(plan: LogicalPlan) -> Result<LogicalPlan, DataFusionError> {
    let fields = plan.schema().fields().iter();
    let nested = fields.map(|field| is_nested(field.data_type()));
    let nested: Vec<bool> = nested.collect();
    replaced(plan, &nested, &to_json())
}

fn is_nested(found: &DataType) -> bool {
    match found {
        DataType::List(item) | DataType::LargeList(item) => item.data_type().is_nested(),
        other => other.is_nested(),
    }
}
