//! Intervals are as long as Postgres and DuckDB have them: a month has 30 days, a day 24 hours. DataFusion compares months,
//! then days, then nanoseconds: a month is longer than 40 days, 25 hours are shorter than a day, and so is any duration.
//!
//! Behind type coercion, where both sides of a comparison are intervals, their lengths are compared; rows are ordered by
//! them, and the shortest and the longest interval found.

mod extreme;
mod length;

use std::sync::{Arc, LazyLock};

use arrow::array::AsArray;
use arrow::compute::cast;
use arrow::datatypes::{
    DECIMAL128_MAX_PRECISION, DataType, Decimal128Type, IntervalMonthDayNanoType,
};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::Transformed;
use datafusion::common::{DFSchema, Result, exec_err};
use datafusion::logical_expr::expr::{Between, BinaryExpr, InList, ScalarFunction, Sort};
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::{
    ColumnarValue, Expr, ExprSchemable, LogicalPlan, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl,
    Signature, Volatility, WindowFrameUnits, WindowFunctionDefinition,
};
use datafusion::optimizer::AnalyzerRule;
use datafusion::optimizer::analyzer::function_rewrite::ApplyFunctionRewrites;
use datafusion::prelude::SessionContext;

use crate::sql::lengths::extreme::of_intervals;
use crate::sql::lengths::length::length;

pub use length::WHOLE;

/// Has a context compare intervals by their lengths.
pub fn compare_lengths(context: &SessionContext) {
    let rule = ApplyFunctionRewrites::new(vec![Arc::new(ByLength)]);
    context.add_analyzer_rule(Arc::new(rule));
    context.add_analyzer_rule(Arc::new(ByLength));
}

/// Puts lengths in the place of intervals that are compared, or that something is ordered by.
#[derive(Debug)]
struct ByLength;

impl FunctionRewrite for ByLength {
    fn name(&self) -> &str {
        "lengths_of_intervals"
    }

    fn rewrite(
        &self,
        expr: Expr,
        schema: &DFSchema,
        _: &ConfigOptions,
    ) -> Result<Transformed<Expr>> {
        Ok(match expr {
            Expr::BinaryExpr(binary) => compared(binary, schema),
            Expr::Between(between) if is_interval(&between.expr, schema) => {
                let Between {
                    expr,
                    negated,
                    low,
                    high,
                } = between;
                let [expr, low, high] = [expr, low, high].map(|value| Box::new(length_of(*value)));
                Transformed::yes(Expr::Between(Between {
                    expr,
                    negated,
                    low,
                    high,
                }))
            }
            Expr::InList(found) if is_interval(&found.expr, schema) => {
                let list = found.list.into_iter().map(length_of).collect();
                let expr = Box::new(length_of(*found.expr));
                let negated = found.negated;
                Transformed::yes(Expr::InList(InList {
                    expr,
                    list,
                    negated,
                }))
            }
            Expr::Case(mut case) => {
                let base = case.expr.take_if(|base| is_interval(base, schema));
                let is_compared = base.is_some();
                if let Some(base) = base {
                    case.expr = Some(Box::new(length_of(*base)));
                    let pairs = std::mem::take(&mut case.when_then_expr).into_iter();
                    let pairs = pairs.map(|(when, then)| (Box::new(length_of(*when)), then));
                    case.when_then_expr = pairs.collect();
                }
                Transformed::new_transformed(Expr::Case(case), is_compared)
            }
            Expr::AggregateFunction(mut call) => {
                let mut is_other = order(&mut call.params.order_by, schema);
                if let Some(func) = of_intervals(&call.func, &call.params.args, schema) {
                    (call.func, is_other) = (func, true);
                    call.params.distinct = false;
                }
                Transformed::new_transformed(Expr::AggregateFunction(call), is_other)
            }
            Expr::WindowFunction(mut call) => {
                // DataFusion has no ranges of intervals.
                let is_range = call.params.window_frame.units == WindowFrameUnits::Range;
                let mut is_other = !is_range && order(&mut call.params.order_by, schema);
                if let WindowFunctionDefinition::AggregateUDF(func) = &call.fun
                    && let Some(func) = of_intervals(func, &call.params.args, schema)
                {
                    (call.fun, is_other) = (WindowFunctionDefinition::AggregateUDF(func), true);
                    call.params.distinct = false;
                }
                Transformed::new_transformed(Expr::WindowFunction(call), is_other)
            }
            other => Transformed::no(other),
        })
    }
}

impl AnalyzerRule for ByLength {
    fn name(&self) -> &str {
        "order_by_lengths_of_intervals"
    }

    fn analyze(&self, plan: LogicalPlan, _: &ConfigOptions) -> Result<LogicalPlan> {
        let ordered = plan.transform_up_with_subqueries(|node| {
            Ok(match node {
                LogicalPlan::Sort(mut sort) => {
                    let is_other = order(&mut sort.expr, sort.input.schema());
                    Transformed::new_transformed(LogicalPlan::Sort(sort), is_other)
                }
                other => Transformed::no(other),
            })
        });
        ordered.map(|ordered| ordered.data)
    }
}

fn is_interval(expr: &Expr, schema: &DFSchema) -> bool {
    matches!(expr.get_type(schema), Ok(DataType::Interval(_)))
}

/// A comparison of two intervals as one of their lengths.
fn compared(binary: BinaryExpr, schema: &DFSchema) -> Transformed<Expr> {
    let BinaryExpr { left, op, right } = binary;
    let are_intervals =
        op.supports_propagation() && is_interval(&left, schema) && is_interval(&right, schema);
    let [left, right] = match are_intervals {
        true => [left, right].map(|side| Box::new(length_of(*side))),
        false => [left, right],
    };
    let binary = Expr::BinaryExpr(BinaryExpr { left, op, right });
    Transformed::new_transformed(binary, are_intervals)
}

/// Orders by the lengths of intervals; whether there are any.
fn order(by: &mut [Sort], schema: &DFSchema) -> bool {
    let mut is_other = false;
    for sort in by {
        if is_interval(&sort.expr, schema) {
            let interval = std::mem::take(&mut sort.expr);
            (sort.expr, is_other) = (length_of(interval), true);
        }
    }
    is_other
}

fn length_of(interval: Expr) -> Expr {
    static LENGTH: LazyLock<Arc<ScalarUDF>> = LazyLock::new(|| {
        Arc::new(ScalarUDF::new_from_impl(Length {
            signature: Signature::any(1, Volatility::Immutable),
        }))
    });
    let length = Arc::clone(&LENGTH);
    Expr::ScalarFunction(ScalarFunction::new_udf(length, vec![interval]))
}

/// [`length`] of each, as a number that has room for all of them.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Length {
    signature: Signature,
}

impl ScalarUDFImpl for Length {
    fn name(&self) -> &str {
        "length_of_interval"
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(DataType::Decimal128(DECIMAL128_MAX_PRECISION, 0))
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let [intervals] = columns.as_slice() else {
            return exec_err!("expected one interval, found {}", columns.len());
        };
        let intervals = cast(intervals, &WHOLE)?;
        let intervals = intervals.as_primitive::<IntervalMonthDayNanoType>();
        let lengths = intervals.unary::<_, Decimal128Type>(length);
        let lengths = lengths.with_precision_and_scale(DECIMAL128_MAX_PRECISION, 0)?;
        Ok(ColumnarValue::Array(Arc::new(lengths)))
    }
}

#[cfg(test)]
mod tests;
