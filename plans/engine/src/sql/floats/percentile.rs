//! Percentiles between two numbers, as far between them as they are. DataFusion cuts that to six digits.

use std::cmp::Ordering;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, Float64Array, ListArray, RecordBatch};
use arrow::buffer::OffsetBuffer;
use arrow::compute::cast;
use arrow::datatypes::{DataType, Field, Float64Type, Schema};
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::function::AccumulatorArgs;
use datafusion::logical_expr::{Accumulator, ColumnarValue};

use crate::sql::floats::order::order;

/// A percentile of all rows, or of those in a window.
#[derive(Debug)]
pub struct Percentile {
    /// The type of the numbers.
    kind: DataType,
    /// Where it is: 0 is the first number, 1 the last.
    at: f64,
    is_descending: bool,
    /// Whether each number is counted once.
    is_distinct: bool,
    values: Vec<f64>,
}

impl Percentile {
    /// Of no rows yet; `None` for what is no percentile of floating point numbers.
    pub fn new(args: &AccumulatorArgs) -> Option<Self> {
        let at = args.exprs.get(1)?;
        let nothing = RecordBatch::new_empty(Arc::new(Schema::empty()));
        let Ok(ColumnarValue::Scalar(at)) = at.evaluate(&nothing) else {
            return None;
        };
        let Ok(ScalarValue::Float64(Some(at))) = at.cast_to(&DataType::Float64) else {
            return None;
        };
        let kind = args.expr_fields.first()?.data_type().clone();
        let is_told = kind.is_floating() && (0.0..=1.0).contains(&at);
        let order = args.order_bys.first();
        is_told.then(|| Self {
            kind,
            at,
            is_descending: order.is_some_and(|order| order.options.descending),
            is_distinct: args.is_distinct,
            values: Vec::new(),
        })
    }

    fn found(&self) -> Option<f64> {
        let compare = |left: &f64, right: &f64| match self.is_descending {
            true => order(right, left),
            false => order(left, right),
        };
        let mut values = self.values.clone();
        if self.is_distinct {
            values.sort_unstable_by(compare);
            values.dedup_by(|left, right| order(left, right) == Ordering::Equal);
        }
        let last = values.len().checked_sub(1)?;
        let place = self.at * last as f64;
        let (_, lower, above) = values.select_nth_unstable_by(place.floor() as usize, compare);
        let lower = *lower;
        let share = place.fract();
        let upper = above.iter().copied().min_by(compare);
        Some(match upper {
            Some(upper) if share > 0.0 && upper != lower => between(lower, upper, share),
            _ => lower,
        })
    }
}

/// So far from one number to another.
pub fn between(lower: f64, upper: f64, share: f64) -> f64 {
    let apart = upper - lower;
    match apart.is_finite() {
        true => lower + apart * share,
        false => lower * (1.0 - share) + upper * share,
    }
}

/// Numbers of any size as the largest.
fn doubles(values: &ArrayRef) -> Result<Float64Array> {
    let values = cast(values, &DataType::Float64)?;
    Ok(values.as_primitive::<Float64Type>().clone())
}

impl Accumulator for Percentile {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        if let Some(values) = values.first() {
            self.values.extend(doubles(values)?.iter().flatten());
        }
        Ok(())
    }

    fn retract_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        if let Some(values) = values.first() {
            for gone in doubles(values)?.iter().flatten() {
                let mut values = self.values.iter();
                let place = values.position(|value| value.to_bits() == gone.to_bits());
                if let Some(place) = place {
                    self.values.swap_remove(place);
                }
            }
        }
        Ok(())
    }

    fn supports_retract_batch(&self) -> bool {
        true
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        let values = Float64Array::from(std::mem::take(&mut self.values));
        let values = cast(&values, &self.kind)?;
        let item = Arc::new(Field::new_list_field(self.kind.clone(), true));
        let offsets = OffsetBuffer::from_lengths([values.len()]);
        let list = ListArray::try_new(item, offsets, values, None)?;
        Ok(vec![ScalarValue::List(Arc::new(list))])
    }

    fn merge_batch(&mut self, states: &[ArrayRef]) -> Result<()> {
        let lists = states.iter().map(|lists| lists.as_list::<i32>());
        for values in lists.flat_map(|lists| lists.iter().flatten()) {
            self.update_batch(&[values])?;
        }
        Ok(())
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        ScalarValue::Float64(self.found()).cast_to(&self.kind)
    }

    fn size(&self) -> usize {
        size_of_val(self) + self.values.capacity() * size_of::<f64>()
    }
}
