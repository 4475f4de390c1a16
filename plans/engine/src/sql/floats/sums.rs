//! Sums and means of floating point numbers in a window that moves.

use arrow::array::{ArrayRef, AsArray};
use arrow::datatypes::Float64Type;
use datafusion::common::{Result, ScalarValue};

use crate::sql::measures::Measure;

/// What is made of a window: its sum, or its mean.
#[derive(Debug)]
pub struct FloatSum {
    /// Whether the sum is divided by the number of values.
    pub is_mean: bool,
}

/// A sum with what rounding took from it.
#[derive(Debug, Clone, Copy)]
pub struct Total {
    count: u64,
    sum: f64,
    lost: f64,
}

impl Total {
    fn value(self) -> f64 {
        match self.sum.is_finite() {
            true => self.sum + self.lost,
            // What is lost to infinity is no number.
            false => self.sum,
        }
    }
}

impl Measure for FloatSum {
    type Aggregate = Total;

    fn parts(&self, values: &[ArrayRef]) -> Vec<Option<Total>> {
        let values = values
            .iter()
            .map(|values| values.as_primitive::<Float64Type>());
        let values = values.flat_map(|values| values.iter());
        let total = |sum| Total {
            count: 1,
            sum,
            lost: 0.0,
        };
        values.map(|value| value.map(total)).collect()
    }

    /// By Knuth's sum of two numbers, which tells what is lost.
    fn joined(&self, before: Total, after: Total) -> Total {
        let sum = before.sum + after.sum;
        let of_after = sum - before.sum;
        let lost = (before.sum - (sum - of_after)) + (after.sum - of_after);
        Total {
            count: before.count + after.count,
            sum,
            lost: before.lost + after.lost + lost,
        }
    }

    fn answer(&self, all: Option<Total>) -> Result<ScalarValue> {
        let answer = all.map(|all| match self.is_mean {
            true => all.value() / all.count as f64,
            false => all.value(),
        });
        Ok(ScalarValue::Float64(answer))
    }
}
