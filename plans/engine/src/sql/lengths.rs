//! Intervals are as long as Postgres and DuckDB have them: a month has 30 days, a day 24 hours. DataFusion compares months,
//! then days, then nanoseconds: a month is longer than 40 days, 25 hours are shorter than a day, and so is any duration.
//!
//! Behind type coercion the shortest and the longest interval are found by their lengths. Before it, windows that range over
//! intervals or durations range over lengths: DataFusion knows no ranges of them.

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
use datafusion::common::{DFSchema, Result, ScalarValue, exec_err};
use datafusion::execution::FunctionRegistry;
use datafusion::logical_expr::expr::{ScalarFunction, WindowFunction};
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::{
    ColumnarValue, Expr, ExprSchemable, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature,
    Volatility, WindowFrameBound, WindowFrameUnits, WindowFunctionDefinition,
};
use datafusion::optimizer::analyzer::function_rewrite::ApplyFunctionRewrites;
use datafusion::prelude::SessionContext;
use evermap_schemas::Fault;

use crate::error::external;
use crate::sql::lengths::extreme::of_intervals;
use crate::sql::lengths::length::length;

pub use extreme::shortest;
pub use length::{WHOLE, order, plain};

/// Has a context find the shortest and the longest interval, and range over intervals.
///
/// # Errors
/// When the context takes no rules.
pub fn measure_intervals(context: &SessionContext) -> Result<()> {
    let rule = ApplyFunctionRewrites::new(vec![Arc::new(Extremes)]);
    context.add_analyzer_rule(Arc::new(rule));
    let state = context.state_ref();
    let mut state = state.write();
    state.register_function_rewrite(Arc::new(Ranges))
}

/// Puts functions of our own in the place of `min` and `max` of intervals.
#[derive(Debug)]
struct Extremes;

impl FunctionRewrite for Extremes {
    fn name(&self) -> &str {
        "extremes_of_intervals"
    }

    fn rewrite(
        &self,
        mut expr: Expr,
        schema: &DFSchema,
        _: &ConfigOptions,
    ) -> Result<Transformed<Expr>> {
        let is_other = match &mut expr {
            Expr::AggregateFunction(call) => {
                let found = of_intervals(&call.func, &call.params.args, schema);
                let is_other = found.is_some();
                if let Some(func) = found {
                    (call.func, call.params.distinct) = (func, false);
                }
                is_other
            }
            Expr::WindowFunction(call) => {
                let found = match &call.fun {
                    WindowFunctionDefinition::AggregateUDF(func) => {
                        of_intervals(func, &call.params.args, schema)
                    }
                    _ => None,
                };
                let is_other = found.is_some();
                if let Some(func) = found {
                    call.fun = WindowFunctionDefinition::AggregateUDF(func);
                    call.params.distinct = false;
                }
                is_other
            }
            _ => false,
        };
        Ok(Transformed::new_transformed(expr, is_other))
    }
}

/// Puts lengths in the place of intervals and durations that windows range over.
#[derive(Debug)]
struct Ranges;

impl FunctionRewrite for Ranges {
    fn name(&self) -> &str {
        "ranges_of_intervals"
    }

    fn rewrite(
        &self,
        mut expr: Expr,
        schema: &DFSchema,
        _: &ConfigOptions,
    ) -> Result<Transformed<Expr>> {
        let is_other = match &mut expr {
            Expr::WindowFunction(call) => ranged(call, schema)?,
            _ => false,
        };
        Ok(Transformed::new_transformed(expr, is_other))
    }
}

/// Whether a window is one of lengths now.
fn ranged(call: &mut WindowFunction, schema: &DFSchema) -> Result<bool> {
    let params = &mut call.params;
    let mut is_other = false;
    if params.window_frame.units == WindowFrameUnits::Range {
        for sort in &mut params.order_by {
            let kind = sort.expr.get_type(schema);
            if matches!(kind, Ok(DataType::Interval(_) | DataType::Duration(_))) {
                let interval = std::mem::take(&mut sort.expr);
                (sort.expr, is_other) = (length_of(interval), true);
            }
        }
    }
    if is_other {
        let frame = &mut params.window_frame;
        for bound in [&mut frame.start_bound, &mut frame.end_bound] {
            if let WindowFrameBound::Preceding(value) | WindowFrameBound::Following(value) = bound {
                as_length(value)?;
            }
        }
    }
    Ok(is_other)
}

/// The text of an interval as that of its length; what has no bound has none.
fn as_length(value: &mut ScalarValue) -> Result<()> {
    let ScalarValue::Utf8(Some(text)) = value else {
        return Ok(());
    };
    match ScalarValue::try_from_string(text.clone(), &WHOLE) {
        Ok(ScalarValue::IntervalMonthDayNano(Some(interval))) => {
            *text = length(interval).to_string();
            Ok(())
        }
        _ => Err(external(
            Fault::user(format!(
                "expected an interval as a bound of RANGE, found {text}"
            ))
            .next("write INTERVAL '1 day' PRECEDING"),
        )),
    }
}

/// Whether a term is the length of an interval.
pub fn is_length(expr: &Expr) -> bool {
    matches!(expr, Expr::ScalarFunction(call) if call.func.name() == LENGTH)
}

/// What [`Length`] is called.
const LENGTH: &str = "length_of_interval";

fn length_of(interval: Expr) -> Expr {
    static FUNCTION: LazyLock<Arc<ScalarUDF>> = LazyLock::new(|| {
        Arc::new(ScalarUDF::new_from_impl(Length {
            signature: Signature::any(1, Volatility::Immutable),
        }))
    });
    let length = Arc::clone(&FUNCTION);
    Expr::ScalarFunction(ScalarFunction::new_udf(length, vec![interval]))
}

/// The length of each, as a number that has room for all of them.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Length {
    signature: Signature,
}

impl ScalarUDFImpl for Length {
    fn name(&self) -> &str {
        LENGTH
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
