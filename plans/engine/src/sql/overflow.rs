//! Integers whose sum, difference, product or negation does not fit are an error, as quotients are. DataFusion wraps them
//! without a word: nine stamps in ns add up to a negative number.
//!
//! Operators become a function that no context knows, behind type coercion, where both sides are of one type. So they are
//! checked wherever a query has them, and where constants are folded: what fails there stays, and fails when it runs, if it
//! runs. Sums are another function of the same name, of durations and intervals too, and so are means of durations. Operators
//! on durations, intervals and instants are checked by Arrow.

mod arithmetic;
mod intervals;
mod sum;
mod totals;

use std::sync::Arc;

use arrow::datatypes::DataType;
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::Transformed;
use datafusion::common::{DFSchema, Result};
use datafusion::execution::FunctionRegistry;
use datafusion::logical_expr::expr::{BinaryExpr, Expr, ScalarFunction};
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::{AggregateUDF, ExprSchemable, Operator, ScalarUDF, ScalarUDFImpl};
use datafusion::optimizer::analyzer::function_rewrite::ApplyFunctionRewrites;
use datafusion::prelude::SessionContext;

use crate::sql::overflow::arithmetic::{Chain, Negated};
use crate::sql::overflow::sum::CheckedSum;
use crate::sql::overflow::totals::Adds;

/// Has a context refuse integers that do not fit.
///
/// # Errors
/// When the context has neither sums nor means.
pub fn check_overflow(context: &SessionContext) -> Result<()> {
    for (name, adds) in [("sum", Adds::Sum), ("avg", Adds::Mean)] {
        let inner = context.udaf(name)?;
        let sum = CheckedSum { inner, adds };
        context.register_udaf(AggregateUDF::new_from_impl(sum));
    }
    let rule = ApplyFunctionRewrites::new(vec![Arc::new(CheckedOperators)]);
    context.add_analyzer_rule(Arc::new(rule));
    Ok(())
}

/// Puts [`Chain`] and [`Negated`] in the place of operators on integers, whose sides are of one type.
#[derive(Debug)]
pub struct CheckedOperators;

impl FunctionRewrite for CheckedOperators {
    fn name(&self) -> &str {
        "checked_operators"
    }

    fn rewrite(
        &self,
        expr: Expr,
        schema: &DFSchema,
        _: &ConfigOptions,
    ) -> Result<Transformed<Expr>> {
        match expr {
            Expr::BinaryExpr(binary) => checked(binary, schema),
            Expr::Negative(value) => {
                let found = type_of(&value, schema);
                match found.filter(DataType::is_signed_integer) {
                    Some(result) => Ok(called(Negated::new(result), vec![*value])),
                    None => Ok(Transformed::no(Expr::Negative(value))),
                }
            }
            expr => Ok(Transformed::no(expr)),
        }
    }
}

/// `a + b - c` is one call: each name and type of nested ones is made of those within, and that of each.
fn checked(binary: BinaryExpr, schema: &DFSchema) -> Result<Transformed<Expr>> {
    let BinaryExpr { left, op, right } = binary;
    let longer = chain(&left).and_then(|chain| chain.then(op));
    let starts = matches!(op, Operator::Plus | Operator::Minus | Operator::Multiply);
    // Of `a + b + c` the right side is short, and the left one would be read anew by each operator.
    let right_type = (longer.is_some() || starts)
        .then(|| type_of(&right, schema))
        .flatten();
    let result = right_type
        .filter(|found| found.is_integer() && type_of(&left, schema).as_ref() == Some(found));
    let Some(result) = result else {
        let binary = BinaryExpr { left, op, right };
        return Ok(Transformed::no(Expr::BinaryExpr(binary)));
    };
    Ok(match (longer, *left) {
        (Some(longer), Expr::ScalarFunction(call)) => {
            let mut args = call.args;
            args.push(*right);
            called(longer, args)
        }
        // A chain of all that it may have is the first of the next.
        (_, left) => called(Chain::new(op, result), vec![left, *right]),
    })
}

fn called(function: impl ScalarUDFImpl + 'static, args: Vec<Expr>) -> Transformed<Expr> {
    let function = Arc::new(ScalarUDF::new_from_impl(function));
    Transformed::yes(Expr::ScalarFunction(ScalarFunction::new_udf(
        function, args,
    )))
}

fn chain(expr: &Expr) -> Option<&Chain> {
    match expr {
        Expr::ScalarFunction(call) => call.func.inner().downcast_ref::<Chain>(),
        _ => None,
    }
}

/// `None` where that is not known yet, as of a parameter. Chains know it themselves.
fn type_of(expr: &Expr, schema: &DFSchema) -> Option<DataType> {
    match chain(expr) {
        Some(chain) => Some(chain.result().clone()),
        None => expr.get_type(schema).ok(),
    }
}

#[cfg(test)]
mod tests;
