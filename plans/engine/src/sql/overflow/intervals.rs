//! Sums of intervals: of their months, their days and their nanoseconds, each by itself.

use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray};
use arrow::compute::cast;
use arrow::datatypes::{Int64Type, IntervalMonthDayNano, IntervalMonthDayNanoType};
use arrow::error::ArrowError;
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::Accumulator;

use crate::sql::lengths::WHOLE;
use crate::sql::overflow::totals::Sum;

/// The sum of all rows, or of those in a window.
#[derive(Debug, Default)]
pub struct IntervalSum {
    parts: [Sum<Int64Type>; 3],
}

/// Months, days and nanoseconds of a column of intervals.
fn parts(spans: &ArrayRef) -> Result<[ArrayRef; 3]> {
    let spans = cast(spans, &WHOLE)?;
    let spans = spans.as_primitive::<IntervalMonthDayNanoType>();
    let part = |of: fn(IntervalMonthDayNano) -> i64| -> ArrayRef {
        Arc::new(spans.unary::<_, Int64Type>(of))
    };
    Ok([
        part(|span| i64::from(span.months)),
        part(|span| i64::from(span.days)),
        part(|span| span.nanoseconds),
    ])
}

fn fits<T: TryFrom<i128>>(total: i128, part: &str) -> Result<T, ArrowError> {
    T::try_from(total).map_err(|_| {
        let bits = 8 * size_of::<T>();
        ArrowError::ArithmeticOverflow(format!(
            "expected {part} of a sum of intervals that fit {bits} bits, found {total}"
        ))
    })
}

impl Accumulator for IntervalSum {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for spans in values {
            for (sum, part) in self.parts.iter_mut().zip(parts(spans)?) {
                sum.update_batch(&[part])?;
            }
        }
        Ok(())
    }

    fn retract_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for spans in values {
            for (sum, part) in self.parts.iter_mut().zip(parts(spans)?) {
                sum.retract_batch(&[part])?;
            }
        }
        Ok(())
    }

    fn supports_retract_batch(&self) -> bool {
        true
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        let states = self.parts.iter_mut().map(|sum| sum.state());
        let states: Vec<Vec<ScalarValue>> = states.collect::<Result<_>>()?;
        Ok(states.concat())
    }

    fn merge_batch(&mut self, states: &[ArrayRef]) -> Result<()> {
        for (sum, totals) in self.parts.iter_mut().zip(states) {
            sum.merge_batch(&[Arc::clone(totals)])?;
        }
        Ok(())
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        let totals = self.parts.each_ref().map(Sum::total);
        let [Some(months), Some(days), Some(nanoseconds)] = totals else {
            return Ok(ScalarValue::IntervalMonthDayNano(None));
        };
        let sum = IntervalMonthDayNano::new(
            fits(months, "months")?,
            fits(days, "days")?,
            fits(nanoseconds, "nanoseconds")?,
        );
        Ok(ScalarValue::IntervalMonthDayNano(Some(sum)))
    }

    fn size(&self) -> usize {
        size_of_val(self)
    }
}
