//! Structs, maps and lists of lists, which clients of Postgres read as JSON. Lists of plain values are arrays. Both are so
//! where they are cast to text, too. Numbers of 8 bits, which Postgres has not, are of 16.

use std::sync::Arc;

use arrow::datatypes::{DataType, FieldRef};
use datafusion::common::tree_node::Transformed;
use datafusion::common::{DFSchema, Result};
use datafusion::error::DataFusionError;
use datafusion::logical_expr::{Expr, ExprSchemable, LogicalPlan, cast};
use evermap_functions::to_json;

use crate::serve::postgres::expression::each_expression;
use crate::serve::postgres::functions::ARRAY_OUT;
use crate::serve::postgres::geometry::{calling, replaced};

/// The plan with what is nested and cast to text as JSON, and lists of plain values as arrays are written.
///
/// # Errors
/// What planning says.
pub fn as_texts(plan: LogicalPlan) -> Result<LogicalPlan, DataFusionError> {
    each_expression(plan, as_text)
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
    replaced(plan, calling(&to_json(), &nested))
}

fn is_nested(found: &DataType) -> bool {
    match found {
        DataType::List(item) | DataType::LargeList(item) => item.data_type().is_nested(),
        other => other.is_nested(),
    }
}

/// The plan with numbers of 8 bits as those of 16, in lists too: the library tells clients that they are, and would write
/// one byte of each.
///
/// # Errors
/// What planning says.
pub fn without_bytes(plan: LogicalPlan) -> Result<LogicalPlan, DataFusionError> {
    let fields = plan.schema().fields().iter();
    let wider = fields.map(|field| wider(field.data_type()));
    let wider: Vec<Option<DataType>> = wider.collect();
    replaced(plan, |place, column| {
        Some(cast(column, wider[place].clone()?))
    })
}

/// A type that has numbers of 8 bits, with such of 16; `None` for any other.
fn wider(found: &DataType) -> Option<DataType> {
    let of_items = |item: &FieldRef| {
        let wider = wider(item.data_type())?;
        Some(Arc::new(item.as_ref().clone().with_data_type(wider)))
    };
    Some(match found {
        DataType::Int8 => DataType::Int16,
        DataType::List(item) => DataType::List(of_items(item)?),
        DataType::LargeList(item) => DataType::LargeList(of_items(item)?),
        DataType::Dictionary(_, value) => wider(value)?,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::datatypes::Field;
    use datafusion::common::ScalarValue;
    use datafusion::logical_expr::{LogicalPlanBuilder, lit};

    use super::*;

    #[test]
    fn numbers_of_eight_bits_are_those_of_sixteen_and_all_else_stays() {
        let item = |kind: DataType| Arc::new(Field::new_list_field(kind, true));
        let words = |kind: DataType| DataType::Dictionary(DataType::Int32.into(), kind.into());
        let kinds = [
            (DataType::Int8, DataType::Int16),
            (
                DataType::List(item(DataType::Int8)),
                DataType::List(item(DataType::Int16)),
            ),
            (
                DataType::LargeList(item(DataType::Int8)),
                DataType::LargeList(item(DataType::Int16)),
            ),
            (words(DataType::Int8), DataType::Int16),
            (DataType::UInt8, DataType::UInt8),
            (words(DataType::Utf8), words(DataType::Utf8)),
        ];
        let values = kinds.iter().enumerate().map(|(place, (kind, _))| {
            cast(lit(ScalarValue::Null), kind.clone()).alias(format!("c{place}"))
        });
        let values: Vec<Expr> = values.collect();
        let plan = LogicalPlanBuilder::empty(true).project(values).unwrap();
        let plan = without_bytes(plan.build().unwrap()).unwrap();
        let fields = plan.schema().fields().iter().zip(&kinds).enumerate();
        for (place, (field, (_, expected))) in fields {
            assert_eq!(field.data_type(), expected, "column {place}");
            assert_eq!(field.name(), &format!("c{place}"));
        }
    }
}
