//! Functions whose answer may be larger than the memory: as an argument says, `repeat('a', 2000000000)`, or as each takes the
//! answer of another, `x || x` thirty times. DataFusion makes it at once and beside the memory pool, so here every function
//! is asked first what it is given, and what it would make of it.
//!
//! And functions that take longer than anybody waits: `levenshtein` of two texts of a megabyte. DataFusion computes a batch
//! in one piece, and nobody takes the thread away from it. So what one row would take is asked first, too, and a batch is
//! computed in slices that take a moment, between which it is asked whether the query has ended; of one long text, that is
//! asked between the places that an expression has in it.

mod effort;
mod growth;
mod joined;
mod places;

use std::ops::Range;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef};
use arrow::compute::concat;
use arrow::datatypes::{DataType, FieldRef};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::Transformed;
use datafusion::common::{DFSchema, Result, ScalarValue, plan_err};
use datafusion::error::DataFusionError;
use datafusion::execution::FunctionRegistry;
use datafusion::logical_expr::expr::{AggregateFunction, BinaryExpr, Expr, ScalarFunction};
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::interval_arithmetic::Interval;
use datafusion::logical_expr::preimage::PreimageResult;
use datafusion::logical_expr::simplify::{ExprSimplifyResult, SimplifyContext};
use datafusion::logical_expr::sort_properties::{ExprProperties, SortProperties};
use datafusion::logical_expr::{
    ColumnarValue, Documentation, ExpressionPlacement, Operator, ReturnFieldArgs,
    ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature, StructFieldMapping,
};
use datafusion::prelude::SessionContext;

use crate::nodes::weight::bytes;
use crate::sql::bounded::effort::Effort;
use crate::sql::bounded::growth::{GROWING, Growth, given};
use crate::sql::bounded::joined::TextsJoined;
use crate::sql::term::go_on;

/// Memory for each row of a batch: operators hold many batches, and a sort merges dozens of them, so that rows of a few
/// kilobytes fit.
pub const BYTES_PER_BATCH_ROW: usize = 256 << 10;

/// The part of the memory that one answer may take: it is counted nowhere, copied where it is written, and not alone.
pub const SHARE: usize = 8;

/// The part of the memory that the arguments of a call may take: an answer is a few times as large at most.
const GIVEN_SHARE: usize = 2;

/// Aggregates that keep as many centroids as an argument says, and which one says it. Where nothing is said, it is 100.
const DIGESTS: [(&str, usize); 2] = [
    ("approx_percentile_cont", 2),
    ("approx_percentile_cont_with_weight", 3),
];

/// Functions that give parts of what is there, or numbers, and that DataFusion's rules know by their types.
const PASSED: [&str; 7] = [
    "get_field",
    "member",
    "struct",
    "named_struct",
    "power",
    "log",
    "input_file_name",
];

/// Centroids of a digest at most: each is allocated before there is a value.
const CENTROIDS: i64 = 10_000;

/// Has the functions of a context refuse what is larger than its memory or takes too long, and end with their query.
///
/// # Errors
/// When a function cannot be registered.
pub fn bound_functions(context: &SessionContext, memory_bytes: usize) -> Result<()> {
    // What is computed while a query is planned, as the arguments of a table function are, takes them as they are here.
    for (name, _) in GROWING {
        // Aliases lead to the same function, which is bounded already.
        if let Ok(function) = context.udf(name)
            && let Some(bounded) = bounded(&function, memory_bytes)
        {
            context.register_udf(bounded);
        }
    }
    let state = context.state_ref();
    state
        .write()
        .register_function_rewrite(Arc::new(BoundFunctions { memory_bytes }))
}

/// Whether it is the operator `||`.
fn is_joined(function: &ScalarUDF) -> bool {
    let bounded = function.inner().downcast_ref::<Bounded>();
    bounded.is_some_and(|bounded| bounded.inner.inner().is::<TextsJoined>())
}

/// A function that is asked first; `None` where it is already, or need not be.
fn bounded(inner: &Arc<ScalarUDF>, memory_bytes: usize) -> Option<ScalarUDF> {
    let is_bounded = inner.inner().is::<Bounded>() || inner.as_async().is_some();
    let is_passed = is_bounded || PASSED.contains(&inner.name());
    (!is_passed).then(|| {
        ScalarUDF::new_from_impl(Bounded {
            inner: Arc::clone(inner),
            growth: Growth::of(inner.name()),
            effort: Effort::of(inner.name()),
            memory_bytes,
        })
    })
}

/// Puts functions that are asked first in the place of others, wherever a query has them from: operators and brackets
/// become functions that no context knows. Refuses aggregates that would keep too many centroids.
#[derive(Debug)]
struct BoundFunctions {
    memory_bytes: usize,
}

impl FunctionRewrite for BoundFunctions {
    fn name(&self) -> &str {
        "bound_functions"
    }

    fn rewrite(&self, expr: Expr, _: &DFSchema, _: &ConfigOptions) -> Result<Transformed<Expr>> {
        let (function, args) = match expr {
            Expr::BinaryExpr(BinaryExpr {
                left,
                op: Operator::StringConcat,
                right,
            }) => {
                // `a || b || c` is one call: each for itself would copy what the one before has made.
                let mut args = match *left {
                    Expr::ScalarFunction(call) if is_joined(&call.func) => call.args,
                    left => vec![left],
                };
                args.push(*right);
                let joined = ScalarUDF::new_from_impl(TextsJoined::default());
                (Arc::new(joined), args)
            }
            Expr::ScalarFunction(call) => (call.func, call.args),
            Expr::AggregateFunction(call) => {
                check_digest(&call)?;
                return Ok(Transformed::no(Expr::AggregateFunction(call)));
            }
            expr => return Ok(Transformed::no(expr)),
        };
        let call = |function| Expr::ScalarFunction(ScalarFunction::new_udf(function, args));
        Ok(match bounded(&function, self.memory_bytes) {
            Some(bounded) => Transformed::yes(call(Arc::new(bounded))),
            None => Transformed::no(call(function)),
        })
    }
}

fn check_digest(call: &AggregateFunction) -> Result<()> {
    if let Some((name, at)) = DIGESTS.iter().find(|(name, _)| *name == call.func.name())
        && let Some(Expr::Literal(centroids, _)) = call.params.args.get(*at)
        && let Ok(ScalarValue::Int64(Some(found))) = centroids.cast_to(&DataType::Int64)
        && !(1..=CENTROIDS).contains(&found)
    {
        return plan_err!("{name}: expected 1 to {CENTROIDS} centroids, found {found}");
    }
    Ok(())
}

/// A function that is asked what its answer takes before it makes it, and makes it as long as somebody waits.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Bounded {
    inner: Arc<ScalarUDF>,
    growth: Growth,
    effort: Effort,
    memory_bytes: usize,
}

impl Bounded {
    /// Refuses a call that is given too much.
    fn check(&self, args: &ScalarFunctionArgs) -> Result<()> {
        let (name, most) = (self.name(), self.memory_bytes / GIVEN_SHARE);
        let found = given(&args.args)?;
        if found > most as f64 {
            return Err(DataFusionError::ResourcesExhausted(format!(
                "{name} is given {found:.0} bytes at once; the limit is {most}, half of the memory"
            )));
        }
        Ok(())
    }

    /// The answer, if it is not too large. One that may be far smaller than its bound is made of few rows at a time.
    fn answer(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let bytes = self.growth.answer(&args.args, args.number_rows)?;
        match bytes.filter(|bytes| *bytes > self.most() as f64) {
            None => self.in_time(args),
            Some(_) if self.growth.is_vague() && has_rows(&args) => self.in_halves(args),
            Some(bytes) => Err(self.too_large(bytes)),
        }
    }

    /// The answer, of a moment's rows at a time, unless the query ends meanwhile.
    fn in_time(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let rows = if varies(&args) { args.number_rows } else { 1 };
        let slices = self.effort.slices(self.name(), &args.args, rows)?;
        if slices.len() > 1 {
            let parts = parts(&args, slices, |part| self.computed(part))?;
            return whole(&parts);
        }
        go_on()?;
        self.computed(args)
    }

    /// The answer, in one go, unless it is one that the query may end within.
    fn computed(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let is_row = args.number_rows == 1 || !varies(&args);
        if self.effort == Effort::Places
            && is_row
            && let Some(found) = places::answer(self.name(), &args)?
        {
            return Ok(ColumnarValue::Scalar(found));
        }
        self.inner.invoke_with_args(args)
    }

    /// The answer of the first half of rows, and that of the second behind it.
    fn in_halves(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let half = args.number_rows / 2;
        let halves = [0..half, half..args.number_rows];
        let parts = parts(&args, halves, |part| self.answer(part))?;
        let found: f64 = parts.iter().map(|part| bytes(part) as f64).sum();
        if found > self.most() as f64 {
            return Err(self.too_large(found));
        }
        whole(&parts)
    }

    /// Bytes of an answer at most.
    fn most(&self) -> usize {
        self.memory_bytes / SHARE
    }

    fn too_large(&self, bytes: f64) -> DataFusionError {
        let (name, most) = (self.name(), self.most());
        DataFusionError::ResourcesExhausted(format!(
            "{name} would make {bytes:.0} bytes at once; the limit is {most}, an eighth of the memory"
        ))
    }
}

/// Whether an argument of a call has a value for each row.
fn varies(args: &ScalarFunctionArgs) -> bool {
    let varies = |arg: &ColumnarValue| matches!(arg, ColumnarValue::Array(_));
    args.args.iter().any(varies)
}

/// Whether the rows of a call can be taken apart.
fn has_rows(args: &ScalarFunctionArgs) -> bool {
    args.number_rows > 1 && varies(args)
}

/// The answers to parts of a call, until the query ends.
fn parts(
    args: &ScalarFunctionArgs,
    parts: impl IntoIterator<Item = Range<usize>>,
    answer: impl Fn(ScalarFunctionArgs) -> Result<ColumnarValue>,
) -> Result<Vec<ArrayRef>> {
    let part = |part: Range<usize>| {
        go_on()?;
        let rows = part.len();
        answer(rows_of(args, part.start, rows))?.into_array(rows)
    };
    parts.into_iter().map(part).collect()
}

/// The parts of an answer one behind the other.
fn whole(parts: &[ArrayRef]) -> Result<ColumnarValue> {
    let parts: Vec<&dyn Array> = parts.iter().map(|part| &**part).collect();
    Ok(ColumnarValue::Array(concat(&parts)?))
}

/// Some rows of a call.
fn rows_of(args: &ScalarFunctionArgs, from: usize, rows: usize) -> ScalarFunctionArgs {
    let some = args.args.iter().map(|arg| match arg {
        ColumnarValue::Array(column) => ColumnarValue::Array(column.slice(from, rows)),
        ColumnarValue::Scalar(value) => ColumnarValue::Scalar(value.clone()),
    });
    ScalarFunctionArgs {
        args: some.collect(),
        arg_fields: args.arg_fields.clone(),
        number_rows: rows,
        return_field: Arc::clone(&args.return_field),
        config_options: Arc::clone(&args.config_options),
    }
}

/// All but the names that DataFusion has given up is the function's own.
impl ScalarUDFImpl for Bounded {
    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        self.check(&args)?;
        self.answer(args)
    }

    fn simplify(&self, args: Vec<Expr>, info: &SimplifyContext) -> Result<ExprSimplifyResult> {
        match self.growth {
            // It would put texts together while the query is planned.
            Growth::Separated | Growth::Together => Ok(ExprSimplifyResult::Original(args)),
            _ => self.inner.simplify(args, info),
        }
    }

    fn with_updated_config(&self, config: &ConfigOptions) -> Option<ScalarUDF> {
        let inner = self.inner.inner().with_updated_config(config)?;
        bounded(&Arc::new(inner), self.memory_bytes)
    }

    fn name(&self) -> &str {
        self.inner.name()
    }

    fn aliases(&self) -> &[String] {
        self.inner.aliases()
    }

    fn schema_name(&self, args: &[Expr]) -> Result<String> {
        self.inner.inner().schema_name(args)
    }

    fn signature(&self) -> &Signature {
        self.inner.signature()
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        self.inner.return_type(types)
    }

    fn return_field_from_args(&self, args: ReturnFieldArgs) -> Result<FieldRef> {
        self.inner.return_field_from_args(args)
    }

    fn is_strict(&self) -> bool {
        self.inner.is_strict()
    }

    fn preimage(
        &self,
        args: &[Expr],
        literal: &Expr,
        info: &SimplifyContext,
    ) -> Result<PreimageResult> {
        self.inner.preimage(args, literal, info)
    }

    fn short_circuits(&self) -> bool {
        self.inner.short_circuits()
    }

    fn conditional_arguments<'a>(
        &self,
        args: &'a [Expr],
    ) -> Option<(Vec<&'a Expr>, Vec<&'a Expr>)> {
        self.inner.conditional_arguments(args)
    }

    fn evaluate_bounds(&self, input: &[&Interval]) -> Result<Interval> {
        self.inner.evaluate_bounds(input)
    }

    fn propagate_constraints(
        &self,
        interval: &Interval,
        inputs: &[&Interval],
    ) -> Result<Option<Vec<Interval>>> {
        self.inner.propagate_constraints(interval, inputs)
    }

    fn output_ordering(&self, inputs: &[ExprProperties]) -> Result<SortProperties> {
        self.inner.output_ordering(inputs)
    }

    fn preserves_lex_ordering(&self, inputs: &[ExprProperties]) -> Result<bool> {
        self.inner.preserves_lex_ordering(inputs)
    }

    fn strictly_order_preserving(&self, inputs: &[ExprProperties]) -> Result<bool> {
        self.inner.strictly_order_preserving(inputs)
    }

    fn coerce_types(&self, types: &[DataType]) -> Result<Vec<DataType>> {
        self.inner.coerce_types(types)
    }

    fn struct_field_mapping(&self, args: &[Option<ScalarValue>]) -> Option<StructFieldMapping> {
        self.inner.struct_field_mapping(args)
    }

    fn documentation(&self) -> Option<&Documentation> {
        self.inner.documentation()
    }

    fn placement(&self, args: &[ExpressionPlacement]) -> ExpressionPlacement {
        self.inner.placement(args)
    }
}

#[cfg(test)]
mod tests;
