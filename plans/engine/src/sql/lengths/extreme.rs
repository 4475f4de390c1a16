//! The shortest and the longest of some intervals.

use std::sync::{Arc, LazyLock};

use arrow::array::{ArrayRef, AsArray};
use arrow::datatypes::{DataType, IntervalMonthDayNano, IntervalMonthDayNanoType};
use datafusion::common::{DFSchema, Result, ScalarValue};
use datafusion::logical_expr::function::AccumulatorArgs;
use datafusion::logical_expr::{
    Accumulator, AggregateUDF, AggregateUDFImpl, Expr, ExprSchemable, Signature, Volatility,
};

use crate::sql::lengths::length::{WHOLE, length};

static SHORTEST: LazyLock<Arc<AggregateUDF>> = LazyLock::new(|| function(false));
static LONGEST: LazyLock<Arc<AggregateUDF>> = LazyLock::new(|| function(true));

fn function(is_longest: bool) -> Arc<AggregateUDF> {
    Arc::new(AggregateUDF::new_from_impl(Extreme {
        is_longest,
        signature: Signature::exact(vec![WHOLE], Volatility::Immutable),
    }))
}

/// What stands for `min` and `max` of intervals; `None` for all else.
///
/// It has names of its own: by theirs DataFusion knows functions that find what it finds least and greatest itself.
pub fn of_intervals(
    func: &AggregateUDF,
    args: &[Expr],
    schema: &DFSchema,
) -> Option<Arc<AggregateUDF>> {
    let function = match func.name() {
        "min" => &SHORTEST,
        "max" => &LONGEST,
        _ => return None,
    };
    let [interval] = args else {
        return None;
    };
    let found = interval.get_type(schema).ok();
    (found == Some(WHOLE)).then(|| Arc::clone(function))
}

#[derive(Debug, PartialEq, Eq, Hash)]
struct Extreme {
    is_longest: bool,
    signature: Signature,
}

impl AggregateUDFImpl for Extreme {
    fn name(&self) -> &str {
        match self.is_longest {
            true => "longest_interval",
            false => "shortest_interval",
        }
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(WHOLE)
    }

    fn accumulator(&self, _: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        Ok(Box::new(Found {
            is_longest: self.is_longest,
            best: None,
        }))
    }
}

/// The best so far, with its length; of those of one length by its parts, in whatever order they come.
#[derive(Debug)]
struct Found {
    is_longest: bool,
    best: Option<(i128, IntervalMonthDayNano)>,
}

impl Accumulator for Found {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for intervals in values {
            let intervals = intervals.as_primitive::<IntervalMonthDayNanoType>();
            let found = intervals.iter().flatten();
            let found = found.map(|interval| (length(interval), interval));
            let all = self.best.into_iter().chain(found);
            self.best = match self.is_longest {
                true => all.max(),
                false => all.min(),
            };
        }
        Ok(())
    }

    fn merge_batch(&mut self, states: &[ArrayRef]) -> Result<()> {
        self.update_batch(states)
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        Ok(vec![self.evaluate()?])
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        let best = self.best.map(|(_, interval)| interval);
        Ok(ScalarValue::IntervalMonthDayNano(best))
    }

    fn size(&self) -> usize {
        size_of_val(self)
    }
}
