//! Decimals beside floating point numbers, compared and chosen from as `DOUBLE`. DataFusion makes both `DECIMAL(30, 15)`,
//! which has no NaN, no infinity, nothing of 1e15 and more, and nothing below 1e-15.

use arrow::datatypes::DataType;
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::Transformed;
use datafusion::common::{DFSchema, Result};
use datafusion::logical_expr::expr::{Between, Case, Cast, InList};
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::{BinaryExpr, Expr, ExprSchemable};

use crate::sql::literals::is_comparison;

/// Functions whose arguments are made alike.
const ALIKE: [&str; 6] = [
    "coalesce",
    "greatest",
    "least",
    "nvl",
    "nullif",
    "make_array",
];

/// Casts decimals that are compared with floating point numbers, before DataFusion makes both alike.
#[derive(Debug)]
pub struct DoublesBesideDecimals;

impl FunctionRewrite for DoublesBesideDecimals {
    fn name(&self) -> &str {
        "doubles_beside_decimals"
    }

    fn rewrite(
        &self,
        mut expr: Expr,
        schema: &DFSchema,
        _: &ConfigOptions,
    ) -> Result<Transformed<Expr>> {
        let is_changed = match &mut expr {
            Expr::BinaryExpr(BinaryExpr { left, op, right }) if is_comparison(*op) => {
                alike(vec![left.as_mut(), right.as_mut()], schema)
            }
            Expr::Between(Between {
                expr, low, high, ..
            }) => alike(vec![expr.as_mut(), low.as_mut(), high.as_mut()], schema),
            Expr::InList(InList { expr, list, .. }) => {
                let values = std::iter::once(expr.as_mut()).chain(list);
                alike(values.collect(), schema)
            }
            Expr::Case(case) => of_case(case, schema),
            Expr::ScalarFunction(call) if ALIKE.contains(&call.func.name()) => {
                alike(call.args.iter_mut().collect(), schema)
            }
            _ => false,
        };
        Ok(match is_changed {
            true => Transformed::yes(expr),
            false => Transformed::no(expr),
        })
    }
}

/// Makes alike what a `CASE` compares, and what it chooses from.
fn of_case(case: &mut Case, schema: &DFSchema) -> bool {
    let Case {
        expr,
        when_then_expr,
        else_expr,
    } = case;
    let mut compared: Vec<&mut Expr> = expr.iter_mut().map(|expr| expr.as_mut()).collect();
    let is_compared = !compared.is_empty();
    let mut chosen: Vec<&mut Expr> = else_expr.iter_mut().map(|expr| expr.as_mut()).collect();
    for (when, then) in when_then_expr {
        if is_compared {
            compared.push(when.as_mut());
        }
        chosen.push(then.as_mut());
    }
    // Both are asked for, whatever the first says.
    let (compared, chosen) = (alike(compared, schema), alike(chosen, schema));
    compared || chosen
}

/// Casts the decimals among values if there are floating point numbers among them, too; whether there are both. What has no
/// type is told elsewhere.
fn alike(values: Vec<&mut Expr>, schema: &DFSchema) -> bool {
    let types = values.iter().map(|value| value.get_type(schema));
    let Ok(types) = types.collect::<Result<Vec<DataType>>>() else {
        return false;
    };
    if !types.iter().any(DataType::is_floating) || !types.iter().any(DataType::is_decimal) {
        return false;
    }
    for (value, kind) in values.into_iter().zip(types) {
        if kind.is_decimal() {
            let decimal = std::mem::take(value);
            *value = Expr::Cast(Cast::new(Box::new(decimal), DataType::Float64));
        }
    }
    true
}
