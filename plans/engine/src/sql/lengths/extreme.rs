//! The shortest and the longest of some intervals.

use std::sync::{Arc, LazyLock};

use arrow::datatypes::{DataType, IntervalMonthDayNanoType};
use datafusion::common::{DFSchema, Result};
use datafusion::logical_expr::expr::AggregateFunction;
use datafusion::logical_expr::function::AccumulatorArgs;
use datafusion::logical_expr::{
    Accumulator, AggregateUDF, AggregateUDFImpl, Expr, ExprSchemable, GroupsAccumulator, Signature,
    Volatility,
};

use crate::sql::lengths::length::{WHOLE, order};
use crate::sql::measures::{Extreme, Moving, OfAll, OfGroups, Side};

static SHORTEST: LazyLock<Arc<AggregateUDF>> = LazyLock::new(|| function(Side::Least));
static LONGEST: LazyLock<Arc<AggregateUDF>> = LazyLock::new(|| function(Side::Greatest));

fn function(side: Side) -> Arc<AggregateUDF> {
    Arc::new(AggregateUDF::new_from_impl(ExtremeInterval {
        side,
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

/// The shortest interval of a group, and of those of one length the first by its parts.
pub fn shortest(interval: Expr) -> Expr {
    let function = Arc::clone(&SHORTEST);
    let args = vec![interval];
    Expr::AggregateFunction(AggregateFunction::new_udf(
        function,
        args,
        false,
        None,
        Vec::new(),
        None,
    ))
}

#[derive(Debug, PartialEq, Eq, Hash)]
struct ExtremeInterval {
    side: Side,
    signature: Signature,
}

impl AggregateUDFImpl for ExtremeInterval {
    fn name(&self) -> &str {
        match self.side {
            Side::Greatest => "longest_interval",
            Side::Least => "shortest_interval",
        }
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(WHOLE)
    }

    fn accumulator(&self, _: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        Ok(Box::new(OfAll::new(of(self.side))))
    }

    fn create_sliding_accumulator(&self, _: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        Ok(Box::new(Moving::new(of(self.side))))
    }

    fn groups_accumulator_supported(&self, _: AccumulatorArgs) -> bool {
        true
    }

    fn create_groups_accumulator(&self, _: AccumulatorArgs) -> Result<Box<dyn GroupsAccumulator>> {
        Ok(Box::new(OfGroups::new(of(self.side))))
    }
}

fn of(side: Side) -> Extreme<IntervalMonthDayNanoType> {
    Extreme::new(side, order)
}
