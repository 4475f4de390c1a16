//! Functions whose answer is as large as an argument says: `repeat('a', 2000000000)`. DataFusion makes it at once and
//! beside the memory pool, so here it is told first what it would take.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, Int64Array};
use arrow::compute::cast;
use arrow::compute::kernels::length::length;
use arrow::datatypes::{DataType, FieldRef, Int64Type};
use datafusion::common::Result;
use datafusion::error::DataFusionError;
use datafusion::execution::FunctionRegistry;
use datafusion::logical_expr::expr::Expr;
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
    /// `range(from, to, step)`, `generate_series`: numbers of eight bytes.
    Numbers,
}

const BOUNDED: [(&str, Growth); 8] = [
    ("repeat", Growth::Copies),
    ("array_repeat", Growth::Copies),
    ("list_repeat", Growth::Copies),
    ("lpad", Growth::Letters),
    ("rpad", Growth::Letters),
    ("replace", Growth::Replaced),
    ("range", Growth::Numbers),
    ("generate_series", Growth::Numbers),
];

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
    Ok(())
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
        let rows = columns.first().map_or(0, |column| column.len());
        let bytes = (0..rows).map(|row| {
            let number = |index: usize| numbers.get(index).and_then(|column| at(column, row));
            let size = |index: usize| sizes.get(index).and_then(|column| at(column, row));
            let count = number(1).unwrap_or(0.0).max(0.0);
            match self.growth {
                Growth::Copies => size(0).unwrap_or(8.0) * count,
                Growth::Letters => 4.0 * count,
                Growth::Replaced => {
                    let (text, from, to) = (size(0), size(1), size(2));
                    text.unwrap_or(0.0) * (1.0 + to.unwrap_or(0.0)) / from.unwrap_or(1.0).max(1.0)
                }
                Growth::Numbers => {
                    let (from, to) = match (number(0), number(1)) {
                        (Some(from), Some(to)) => (from, to),
                        (to, _) => (0.0, to.unwrap_or(0.0)),
                    };
                    8.0 * ((to - from) / number(2).unwrap_or(1.0)).max(0.0)
                }
            }
        });
        Ok(bytes.sum())
    }
}

/// A column of integers; `None` for another.
fn integers(column: &ArrayRef) -> Option<Int64Array> {
    let column = Some(column).filter(|column| column.data_type().is_integer())?;
    let column = cast(column, &DataType::Int64).ok()?;
    Some(column.as_primitive::<Int64Type>().clone())
}

/// How long the texts or lists of a column are; `None` for a column of others.
fn sizes(column: &ArrayRef) -> Option<Int64Array> {
    let column = match column.data_type() {
        DataType::Utf8View => cast(column, &DataType::LargeUtf8).ok()?,
        _ => Arc::clone(column),
    };
    integers(&length(&column).ok()?)
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
        self.inner.simplify(args, info)
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
        ] {
            let fault = run(query).await.unwrap_err().to_string();
            assert!(fault.contains("the limit is 131072"), "{query}: {fault}");
        }
        let answers = run(
            "SELECT repeat('a', 3), lpad('a', 3, '-'), array_repeat(1, 2), range(3), \
             generate_series(1, 2), replace('aba', 'a', 'cc'), repeat(NULL, 3), repeat('a', -1)",
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
        ];
        assert_eq!(answers, expected);
    }
}
