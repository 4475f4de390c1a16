//! Functions whose answer is as large as an argument says: `repeat('a', 2000000000)`. DataFusion makes it at once and
//! beside the memory pool, so here it is told first what it would take.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, Int64Array};
use arrow::compute::cast;
use arrow::compute::kernels::length::length;
use arrow::datatypes::{
    DataType, FieldRef, Int64Type, IntervalMonthDayNano, IntervalMonthDayNanoType, IntervalUnit,
    TimeUnit,
};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::Transformed;
use datafusion::common::{DFSchema, Result, ScalarValue, plan_err};
use datafusion::error::DataFusionError;
use datafusion::execution::FunctionRegistry;
use datafusion::logical_expr::expr::Expr;
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::interval_arithmetic::Interval;
use datafusion::logical_expr::simplify::{ExprSimplifyResult, SimplifyContext};
use datafusion::logical_expr::sort_properties::{ExprProperties, SortProperties};
use datafusion::logical_expr::{
    ColumnarValue, Documentation, ReturnFieldArgs, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl,
    Signature,
};
use datafusion::prelude::SessionContext;

/// The part of the memory that one answer may take: it is counted nowhere, copied where it is written, and not alone.
const SHARE: usize = 8;

/// How an answer grows with its arguments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Growth {
    /// `repeat(text, count)`, `array_repeat(value, count)`.
    Copies,
    /// `lpad(text, letters, fill)`, `rpad`: letters of four bytes at most.
    Letters,
    /// `replace(text, from, to)`: every letter may become the third text.
    Replaced,
    /// `regexp_replace(text, pattern, to)`: every letter may become the third text, which may have the whole text for each
    /// two of its own letters (`\\1`).
    Rewritten,
    /// `range(from, to, step)`, `generate_series`: numbers, days or instants of eight bytes.
    Numbers,
    /// `array_resize(list, count, value)`.
    Resized,
    /// `array_to_string(list, between)`: values, numbers in some twenty letters, with a text between them.
    Joined,
    /// `concat_ws(between, texts…)`: all texts, with the first between them.
    Concatenated,
}

const BOUNDED: [(&str, Growth); 16] = [
    ("repeat", Growth::Copies),
    ("array_repeat", Growth::Copies),
    ("list_repeat", Growth::Copies),
    ("lpad", Growth::Letters),
    ("rpad", Growth::Letters),
    ("replace", Growth::Replaced),
    ("regexp_replace", Growth::Rewritten),
    ("range", Growth::Numbers),
    ("generate_series", Growth::Numbers),
    ("array_resize", Growth::Resized),
    ("list_resize", Growth::Resized),
    ("array_to_string", Growth::Joined),
    ("list_to_string", Growth::Joined),
    ("array_join", Growth::Joined),
    ("list_join", Growth::Joined),
    ("concat_ws", Growth::Concatenated),
];

/// Aggregates that keep as many centroids as an argument says, and which one says it. Where nothing is said, it is 100.
const DIGESTS: [(&str, usize); 2] = [
    ("approx_percentile_cont", 2),
    ("approx_percentile_cont_with_weight", 3),
];

/// Centroids of a digest at most: each is allocated before there is a value.
const CENTROIDS: i64 = 10_000;

/// Has the functions of a context that can grow beyond all bounds refuse what is larger than its memory.
///
/// # Errors
/// When a function cannot be registered.
pub fn bound_functions(context: &SessionContext, memory_bytes: usize) -> Result<()> {
    for (name, growth) in BOUNDED {
        // Aliases lead to the same function, which is bounded already.
        let Ok(inner) = context.udf(name) else {
            continue;
        };
        if inner.inner().is::<Bounded>() {
            continue;
        }
        context.register_udf(ScalarUDF::new_from_impl(Bounded {
            inner,
            growth,
            memory_bytes,
        }));
    }
    let state = context.state_ref();
    state
        .write()
        .register_function_rewrite(Arc::new(BoundDigests))
}

/// Refuses aggregates that would keep too many centroids.
#[derive(Debug)]
struct BoundDigests;

impl FunctionRewrite for BoundDigests {
    fn name(&self) -> &str {
        "bound_digests"
    }

    fn rewrite(&self, expr: Expr, _: &DFSchema, _: &ConfigOptions) -> Result<Transformed<Expr>> {
        if let Expr::AggregateFunction(call) = &expr
            && let Some((name, at)) = DIGESTS.iter().find(|(name, _)| *name == call.func.name())
            && let Some(Expr::Literal(centroids, _)) = call.params.args.get(*at)
            && let Ok(ScalarValue::Int64(Some(found))) = centroids.cast_to(&DataType::Int64)
            && !(1..=CENTROIDS).contains(&found)
        {
            return plan_err!("{name}: expected 1 to {CENTROIDS} centroids, found {found}");
        }
        Ok(Transformed::no(expr))
    }
}

/// A function that is asked what its answer takes before it makes it.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Bounded {
    inner: Arc<ScalarUDF>,
    growth: Growth,
    memory_bytes: usize,
}

impl Bounded {
    /// Bytes of the answer, at least about.
    fn bytes(&self, args: &ScalarFunctionArgs) -> Result<f64> {
        // Where nothing varies, there is one answer, however many rows there are.
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let numbers: Vec<_> = columns.iter().map(integers).collect();
        let sizes: Vec<_> = columns.iter().map(sizes).collect();
        let first = columns.first();
        let joined = first.filter(|_| self.growth == Growth::Joined);
        let elements = joined.and_then(|column| integers(&length(column).ok()?));
        let rows = first.map_or(0, |column| column.len());
        let bytes = (0..rows).map(|row| {
            let number = |index: usize| numbers.get(index).and_then(|column| at(column, row));
            let size = |index: usize| sizes.get(index).and_then(|column| at(column, row));
            let text = |index: usize| size(index).unwrap_or(0.0);
            let count = number(1).unwrap_or(0.0).max(0.0);
            match self.growth {
                Growth::Copies => size(0).unwrap_or(8.0) * count,
                Growth::Letters => 4.0 * count,
                Growth::Replaced => text(0) * (1.0 + text(2)) / text(1).max(1.0),
                Growth::Rewritten => text(0) * (1.0 + 1.5 * text(2)) + text(2),
                Growth::Numbers => {
                    let (from, to) = match (number(0), number(1)) {
                        (Some(from), Some(to)) => (from, to),
                        (to, _) => (0.0, to.unwrap_or(0.0)),
                    };
                    8.0 * ((to - from) / number(2).unwrap_or(1.0)).max(0.0)
                }
                Growth::Resized => size(2).unwrap_or(8.0) * count,
                Growth::Joined => {
                    let values = at(&elements, row).unwrap_or(0.0);
                    2.5 * text(0) + values * text(1)
                }
                Growth::Concatenated => {
                    let texts = (1..columns.len()).map(|index| text(0) + text(index));
                    texts.sum()
                }
            }
        });
        Ok(bytes.sum())
    }
}

/// A column of integers; of instants, days and intervals in nanoseconds; `None` for another.
fn integers(column: &ArrayRef) -> Option<Int64Array> {
    let kind = match column.data_type() {
        kind if kind.is_integer() => DataType::Int64,
        DataType::Timestamp(..) | DataType::Date32 | DataType::Date64 => {
            DataType::Timestamp(TimeUnit::Nanosecond, None)
        }
        DataType::Interval(_) => return intervals(column),
        _ => return None,
    };
    // Days too far for nanoseconds are null, and bounded by nothing: they are a few million.
    let column = cast(&cast(column, &kind).ok()?, &DataType::Int64).ok()?;
    Some(column.as_primitive::<Int64Type>().clone())
}

fn intervals(column: &ArrayRef) -> Option<Int64Array> {
    const DAY_NS: i64 = 86_400_000_000_000;
    let whole = DataType::Interval(IntervalUnit::MonthDayNano);
    let column = cast(column, &whole).ok()?;
    let spans = column.as_primitive::<IntervalMonthDayNanoType>().iter();
    let span = |span: Option<IntervalMonthDayNano>| {
        let span = span?;
        let days = i64::from(span.months) * 28 + i64::from(span.days);
        Some(days.saturating_mul(DAY_NS).saturating_add(span.nanoseconds))
    };
    Some(spans.map(span).collect())
}

/// How long the texts of a column are, bytes; of lists how many bytes their values take; `None` for a column of others.
fn sizes(column: &ArrayRef) -> Option<Int64Array> {
    match column.data_type() {
        DataType::Utf8View => sizes(&cast(column, &DataType::LargeUtf8).ok()?),
        DataType::List(_) | DataType::LargeList(_) | DataType::FixedSizeList(..) => {
            let size = |row| {
                let bytes = column.slice(row, 1).to_data().get_slice_memory_size();
                bytes.ok().map(|bytes| bytes as i64)
            };
            Some((0..column.len()).map(size).collect())
        }
        _ => integers(&length(column).ok()?),
    }
}

fn at(column: &Option<Int64Array>, row: usize) -> Option<f64> {
    let column = column.as_ref().filter(|column| column.is_valid(row))?;
    Some(column.value(row) as f64)
}

impl ScalarUDFImpl for Bounded {
    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let bytes = self.bytes(&args)?;
        let most = self.memory_bytes / SHARE;
        if bytes > most as f64 {
            return Err(DataFusionError::ResourcesExhausted(format!(
                "{} would make {bytes:.0} bytes at once; the limit is {most}, an eighth of the memory",
                self.name(),
            )));
        }
        self.inner.invoke_with_args(args)
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

    fn simplify(&self, args: Vec<Expr>, info: &SimplifyContext) -> Result<ExprSimplifyResult> {
        match self.growth {
            // It would put texts together while the query is planned.
            Growth::Concatenated => Ok(ExprSimplifyResult::Original(args)),
            _ => self.inner.simplify(args, info),
        }
    }

    fn evaluate_bounds(&self, input: &[&Interval]) -> Result<Interval> {
        self.inner.evaluate_bounds(input)
    }

    fn output_ordering(&self, inputs: &[ExprProperties]) -> Result<SortProperties> {
        self.inner.output_ordering(inputs)
    }

    fn coerce_types(&self, types: &[DataType]) -> Result<Vec<DataType>> {
        self.inner.coerce_types(types)
    }

    fn documentation(&self) -> Option<&Documentation> {
        self.inner.documentation()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::error::OrFault;
    use crate::sql::{Limits, context};

    #[tokio::test]
    async fn what_an_argument_makes_larger_than_memory_is_refused_and_the_rest_is_as_it_was() {
        let limits = Limits {
            memory_bytes: 1 << 20,
            ..Limits::one_partition()
        };
        let context = context(limits).unwrap();
        let run = async |query: &str| {
            let frame = context.sql(query).await.or_fault()?;
            frame.collect().await.or_fault()
        };
        for query in [
            "SELECT repeat('a', 2000000000)",
            "SELECT length(repeat('ab', n * 1000000)) FROM (VALUES (1), (2)) t (n)",
            "SELECT lpad('a', 2000000000)",
            "SELECT rpad('a', 2000000000, 'b')",
            "SELECT array_repeat(1, 2000000000)",
            "SELECT list_repeat(1, 2000000000)",
            "SELECT range(0, 2000000000)",
            "SELECT range(2000000000)",
            "SELECT generate_series(2000000000, 0, -1)",
            "SELECT replace(repeat('a', 10000), 'a', repeat('b', 10000))",
            "SELECT regexp_replace(repeat('a', 10000), 'a', repeat('b', 10000), 'g')",
            "SELECT array_repeat(array_repeat(array_repeat(1, 100), 100), 100)",
            "SELECT range(TIMESTAMP '1970-01-01', TIMESTAMP '1970-01-02', INTERVAL '1 microsecond')",
            "SELECT array_resize([1], 2000000000, 0)",
            "SELECT array_to_string(range(0, 1000), repeat('x', 10000))",
            "SELECT concat_ws(repeat('x', 50000), 'a', 'b', 'c', 'd')",
        ] {
            let fault = run(query).await.unwrap_err().to_string();
            assert!(fault.contains("the limit is 131072"), "{query}: {fault}");
        }
        for query in [
            "SELECT approx_percentile_cont(n, 0.5, 9000000000) FROM (VALUES (1), (2)) t (n)",
            "SELECT approx_percentile_cont(0.5, 2000000000) WITHIN GROUP (ORDER BY n) FROM (VALUES (1)) t (n)",
            "SELECT approx_percentile_cont_with_weight(n, n, 0.5, 0) FROM (VALUES (1)) t (n)",
        ] {
            let fault = run(query).await.unwrap_err().to_string();
            assert!(
                fault.contains("expected 1 to 10000 centroids"),
                "{query}: {fault}"
            );
        }
        run("SELECT approx_percentile_cont(n, 0.5, 200) FROM (VALUES (1), (2)) t (n)")
            .await
            .unwrap();
        let answers = run(
            "SELECT repeat('a', 3), lpad('a', 3, '-'), array_repeat(1, 2), range(3), \
             generate_series(1, 2), replace('aba', 'a', 'cc'), repeat(NULL, 3), repeat('a', -1), \
             regexp_replace('ab', '(b)', '\\1\\1'), array_length(range(DATE '2026-01-01', DATE '2026-02-01', INTERVAL '1 day')), \
             array_resize([1], 2, 7), array_to_string([1, 2], '-'), concat_ws('-', 'a', NULL, 'b')",
        );
        let answers = answers.await.unwrap();
        let answers: Vec<String> = answers[0]
            .columns()
            .iter()
            .map(|column| arrow::util::display::array_value_to_string(column, 0).unwrap())
            .collect();
        let expected = [
            "aaa",
            "--a",
            "[1, 1]",
            "[0, 1, 2]",
            "[1, 2]",
            "ccbcc",
            "",
            "",
            "abb",
            "31",
            "[1, 7]",
            "1-2",
            "a-b",
        ];
        assert_eq!(answers, expected);
    }
}
