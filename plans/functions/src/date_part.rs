//! `date_part(part, value)`, which `extract(part FROM value)` is too. DataFusion counts the nanoseconds of a duration in 32
//! bits, and passes over the fraction of an interval's seconds; of all else its answers are given.

use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, PrimitiveArray};
use arrow::compute::cast;
use arrow::compute::kernels::cast_utils::IntervalUnit;
use arrow::datatypes::{
    DataType, Field, FieldRef, Float64Type, Int32Type, Int64Type, IntervalMonthDayNano,
    IntervalMonthDayNanoType, IntervalUnit as Unit, TimeUnit,
};
use arrow::error::ArrowError;
use datafusion::common::{Result, ScalarValue, exec_err, plan_err};
use datafusion::functions::datetime;
use datafusion::logical_expr::expr::{Expr, ScalarFunction};
use datafusion::logical_expr::planner::{ExprPlanner, PlannerResult};
use datafusion::logical_expr::preimage::PreimageResult;
use datafusion::logical_expr::simplify::SimplifyContext;
use datafusion::logical_expr::{
    ColumnarValue, DocSection, Documentation, ReturnFieldArgs, ScalarFunctionArgs, ScalarUDF,
    ScalarUDFImpl, Signature,
};

const MINUTE_NS: i64 = 60_000_000_000;

/// What plans `extract(part FROM value)`.
///
/// Of planners the first that has a plan is heard: it stands in front of DataFusion's own.
pub fn extracts() -> Arc<dyn ExprPlanner> {
    Arc::new(Extracts)
}

#[derive(Debug)]
struct Extracts;

impl ExprPlanner for Extracts {
    fn plan_extract(&self, args: Vec<Expr>) -> Result<PlannerResult<Vec<Expr>>> {
        let function = Arc::new(ScalarUDF::from(DatePart::default()));
        let call = ScalarFunction::new_udf(function, args);
        Ok(PlannerResult::Planned(Expr::ScalarFunction(call)))
    }
}

/// A part of an instant, an interval or a duration.
#[derive(Debug, PartialEq, Eq, Hash)]
pub(crate) struct DatePart {
    inner: Arc<ScalarUDF>,
    documentation: Documentation,
}

impl Default for DatePart {
    fn default() -> Self {
        Self {
            inner: datetime::date_part(),
            documentation: documentation(),
        }
    }
}

/// What a duration is counted in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum DurationUnit {
    /// Seconds, with their fraction.
    Epoch,
    /// Whole units of so many nanoseconds.
    Whole(i64),
}

impl DurationUnit {
    /// `None` for a name that no part of a duration has.
    fn of(name: &str) -> Option<Self> {
        let name = name.trim_matches(['\'', '"']);
        if name.eq_ignore_ascii_case("epoch") {
            return Some(Self::Epoch);
        }
        Some(Self::Whole(match name.parse::<IntervalUnit>().ok()? {
            IntervalUnit::Week => 7 * 24 * 60 * MINUTE_NS,
            IntervalUnit::Day => 24 * 60 * MINUTE_NS,
            IntervalUnit::Hour => 60 * MINUTE_NS,
            IntervalUnit::Minute => MINUTE_NS,
            IntervalUnit::Second => 1_000_000_000,
            IntervalUnit::Millisecond => 1_000_000,
            IntervalUnit::Microsecond => 1_000,
            IntervalUnit::Nanosecond => 1,
            _ => return None,
        }))
    }

    fn result(self) -> DataType {
        match self {
            Self::Epoch => DataType::Float64,
            Self::Whole(_) => DataType::Int64,
        }
    }

    /// The whole of each duration.
    fn of_durations(self, column: &ArrayRef, unit: TimeUnit) -> Result<ArrayRef> {
        let unit_ns: i64 = match unit {
            TimeUnit::Second => 1_000_000_000,
            TimeUnit::Millisecond => 1_000_000,
            TimeUnit::Microsecond => 1_000,
            TimeUnit::Nanosecond => 1,
        };
        let column = cast(column, &DataType::Int64)?;
        let column = column.as_primitive::<Int64Type>();
        let found: ArrayRef = match self {
            Self::Epoch => {
                let per_second = (1_000_000_000 / unit_ns) as f64;
                Arc::new(column.unary::<_, Float64Type>(|value| value as f64 / per_second))
            }
            Self::Whole(part_ns) => {
                let whole = |value: i64| {
                    let whole = i128::from(value) * i128::from(unit_ns) / i128::from(part_ns);
                    i64::try_from(whole).map_err(|_| {
                        ArrowError::ArithmeticOverflow(format!(
                            "expected a duration that fits i64 in units of {part_ns} ns, found {whole}"
                        ))
                    })
                };
                Arc::new(column.try_unary::<_, Int64Type, ArrowError>(whole)?)
            }
        };
        Ok(found)
    }

    /// The seconds of each interval's minute in a part of them, with the fraction; `None` where DataFusion is right.
    fn of_intervals(self, column: &ArrayRef) -> Result<Option<ArrayRef>> {
        let part_ns = match self {
            Self::Whole(part_ns) if part_ns < 1_000_000_000 => part_ns,
            _ => return Ok(None),
        };
        let whole = DataType::Interval(Unit::MonthDayNano);
        let column = cast(column, &whole)?;
        let column = column.as_primitive::<IntervalMonthDayNanoType>();
        let seconds = |value: IntervalMonthDayNano| value.nanoseconds % MINUTE_NS / part_ns;
        let found: PrimitiveArray<Int64Type> = column.unary(seconds);
        let found: ArrayRef = match part_ns {
            1 => Arc::new(found),
            // A minute has 60 million microseconds.
            _ => Arc::new(found.unary::<_, Int32Type>(|value| value as i32)),
        };
        Ok(Some(found))
    }
}

/// The part that is asked for, where it is a constant.
fn part(given: Option<&ScalarValue>) -> Option<&str> {
    given?.try_as_str().flatten()
}

/// The part of a duration.
fn of_duration(name: &str) -> Result<DurationUnit> {
    match DurationUnit::of(name) {
        Some(part) => Ok(part),
        None => plan_err!(
            "date_part: expected week, day, hour, minute, second, millisecond, microsecond, nanosecond or epoch of a duration, found {}",
            name.to_lowercase()
        ),
    }
}

impl ScalarUDFImpl for DatePart {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn aliases(&self) -> &[String] {
        self.inner.aliases()
    }

    fn signature(&self) -> &Signature {
        self.inner.signature()
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        self.inner.return_type(types)
    }

    fn return_field_from_args(&self, args: ReturnFieldArgs) -> Result<FieldRef> {
        let name = part(args.scalar_arguments.first().copied().flatten());
        match (name, args.arg_fields.get(1)) {
            (Some(name), Some(value)) if matches!(value.data_type(), DataType::Duration(_)) => {
                let result = of_duration(name)?.result();
                Ok(Arc::new(Field::new(
                    self.name(),
                    result,
                    value.is_nullable(),
                )))
            }
            _ => self.inner.return_field_from_args(args),
        }
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let [ColumnarValue::Scalar(name), value] = args.args.as_slice() else {
            return self.inner.invoke_with_args(args);
        };
        let Some(name) = part(Some(name)) else {
            return exec_err!("date_part: expected the name of a part, found none");
        };
        let rows = match value {
            ColumnarValue::Array(_) => args.number_rows,
            ColumnarValue::Scalar(_) => 1,
        };
        let column = || value.to_array(rows);
        let found = match value.data_type() {
            DataType::Duration(unit) => Some(of_duration(name)?.of_durations(&column()?, unit)?),
            DataType::Interval(_) => match DurationUnit::of(name) {
                Some(part) => part.of_intervals(&column()?)?,
                None => None,
            },
            _ => None,
        };
        let Some(found) = found else {
            return self.inner.invoke_with_args(args);
        };
        match value {
            ColumnarValue::Array(_) => Ok(ColumnarValue::Array(found)),
            ColumnarValue::Scalar(_) => {
                let one = ScalarValue::try_from_array(&found, 0)?;
                Ok(ColumnarValue::Scalar(one))
            }
        }
    }

    fn preimage(
        &self,
        args: &[Expr],
        literal: &Expr,
        info: &SimplifyContext,
    ) -> Result<PreimageResult> {
        self.inner.preimage(args, literal, info)
    }

    fn documentation(&self) -> Option<&Documentation> {
        Some(&self.documentation)
    }
}

fn documentation() -> Documentation {
    let about = "A part of an instant or an interval, as Postgres has it; of a duration, as `a - b` of two instants is one, \
        the whole in such units: epoch in seconds with their fraction, all others rounded towards 0 → number";
    Documentation::builder(DocSection::default(), about, "date_part(part, value)")
        .with_alternative_syntax("extract(part FROM value)")
        .with_argument(
            "part",
            "epoch, week, day, hour, minute, second, millisecond, microsecond or nanosecond; \
            year, quarter, month, doy, dow and isodow of an instant",
        )
        .with_argument("value", "an instant, a day, an interval or a duration")
        .with_sql_example(
            "SELECT date_part('epoch', TIMESTAMP '2026-01-01T00:00:36.75' - TIMESTAMP '2026-01-01') -- 36.75",
        )
        .build()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::util::display::array_value_to_string;
    use datafusion::execution::SessionStateBuilder;
    use datafusion::prelude::SessionContext;

    use super::*;

    #[tokio::test]
    async fn a_duration_is_counted_whole_and_no_bits_are_lost() {
        let state = SessionStateBuilder::new()
            .with_expr_planners(vec![extracts()])
            .with_default_features()
            .build();
        let context = SessionContext::new_with_state(state);
        crate::register(&context);
        let long = "(TIMESTAMP '2026-01-03T01:30:33.280000001' - TIMESTAMP '2026-01-01')";
        let back = "(TIMESTAMP '2026-01-01' - TIMESTAMP '2026-01-01T00:00:36.75988')";
        let span = "INTERVAL '1 day 33.28 seconds'";
        for (part, of, expected) in [
            ("epoch", long, "178233.280000001"),
            ("epoch", back, "-36.75988"),
            ("epoch", span, "86433.28"),
            ("day", long, "2"),
            ("hour", long, "49"),
            ("minute", long, "2970"),
            ("second", long, "178233"),
            ("millisecond", long, "178233280"),
            ("microseconds", long, "178233280000"),
            ("nanosecond", long, "178233280000001"),
            ("milliseconds", back, "-36759"),
            ("second", span, "33"),
            ("millisecond", span, "33280"),
            ("microsecond", span, "33280000"),
            ("nanosecond", span, "33280000000"),
            ("epoch", "arrow_cast(-1500, 'Duration(ms)')", "-1.5"),
            ("hour", "arrow_cast(7200, 'Duration(s)')", "2"),
            ("second", "arrow_cast(NULL, 'Duration(s)')", ""),
            ("year", "TIMESTAMP '2026-01-01'", "2026"),
            ("millisecond", "TIMESTAMP '2026-01-01T00:00:01.25'", "1250"),
        ] {
            let calls = [
                format!("SELECT extract({part} FROM {of})"),
                format!("SELECT date_part('{part}', {of})"),
                format!(
                    "SELECT date_part('{part}', v) FROM (SELECT {of} AS v UNION ALL SELECT {of})"
                ),
            ];
            for call in calls {
                let batches = context.sql(&call).await.unwrap().collect().await.unwrap();
                let found = array_value_to_string(batches[0].column(0), 0).unwrap();
                assert_eq!(found, expected, "{call}");
            }
        }
        let months = format!("SELECT extract(month FROM {long})");
        let said = context.sql(&months).await.unwrap_err().to_string();
        assert!(said.contains("of a duration, found month"), "{said}");
        let most = "SELECT extract(nanosecond FROM arrow_cast(9223372036854775807, 'Duration(s)'))";
        let said = context.sql(most).await.unwrap().collect().await;
        let said = said.unwrap_err().to_string();
        assert!(said.contains("fits i64"), "{said}");
    }
}
