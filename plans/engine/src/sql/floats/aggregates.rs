//! DataFusion's `min`, `max`, percentiles, variances and regressions, but for what it tells wrongly of floating point numbers.

use std::sync::Arc;

use arrow::datatypes::{
    ArrowPrimitiveType, DataType, FieldRef, Float16Type, Float32Type, Float64Type,
};
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::function::{AccumulatorArgs, StateFieldsArgs};
use datafusion::logical_expr::utils::AggregateOrderSensitivity;
use datafusion::logical_expr::{
    Accumulator, AggregateUDF, AggregateUDFImpl, Documentation, GroupsAccumulator, ReversedUDAF,
    SetMonotonicity, Signature, StatisticsArgs,
};

use crate::sql::floats::order::order;
use crate::sql::floats::percentile::Percentile;
use crate::sql::floats::statistics::{Statistic, state_fields};
use crate::sql::measures::{Extreme, Moving, OfAll, OfGroups, Side};

/// A function of DataFusion, and what is told here in its place. A percentile at 0 or 1 does not become DataFusion's own
/// `min` or `max`, as it would by `simplify`.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct FloatAggregate {
    /// The function that tells everything else.
    pub inner: Arc<AggregateUDF>,
    /// What it tells.
    pub of: Of,
}

/// What is told of floating point numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Of {
    /// The least or the greatest, of all rows, of groups and of windows.
    Extreme(Side),
    /// A statistic of all rows, of groups and of windows.
    Statistic(Statistic),
    /// A percentile, between two numbers where it is.
    Percentile,
}

/// How extremes of a type are found.
struct Way {
    all: fn(Side) -> Box<dyn Accumulator>,
    moving: fn(Side) -> Box<dyn Accumulator>,
    groups: fn(Side) -> Box<dyn GroupsAccumulator>,
}

impl Way {
    fn of<T: ArrowPrimitiveType>() -> Self {
        Self {
            all: all::<T>,
            moving: moving::<T>,
            groups: groups::<T>,
        }
    }
}

fn all<T: ArrowPrimitiveType>(side: Side) -> Box<dyn Accumulator> {
    Box::new(OfAll::new(Extreme::<T>::new(side, order)))
}

fn moving<T: ArrowPrimitiveType>(side: Side) -> Box<dyn Accumulator> {
    Box::new(Moving::new(Extreme::<T>::new(side, order)))
}

fn groups<T: ArrowPrimitiveType>(side: Side) -> Box<dyn GroupsAccumulator> {
    Box::new(OfGroups::new(Extreme::<T>::new(side, order)))
}

impl FloatAggregate {
    /// On which side an extreme of this type is looked for, and how; `None` where DataFusion does it.
    fn extreme(&self, kind: &DataType) -> Option<(Side, Way)> {
        let Of::Extreme(side) = self.of else {
            return None;
        };
        let way = match kind {
            DataType::Float16 => Way::of::<Float16Type>(),
            DataType::Float32 => Way::of::<Float32Type>(),
            DataType::Float64 => Way::of::<Float64Type>(),
            _ => return None,
        };
        Some((side, way))
    }

    /// A statistic that is told here; where each number is counted once, DataFusion does it.
    fn statistic(&self, is_distinct: bool) -> Option<Statistic> {
        match self.of {
            Of::Statistic(statistic) if !is_distinct => Some(statistic),
            _ => None,
        }
    }
}

impl AggregateUDFImpl for FloatAggregate {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn aliases(&self) -> &[String] {
        self.inner.aliases()
    }

    fn signature(&self) -> &Signature {
        self.inner.signature()
    }

    fn coerce_types(&self, types: &[DataType]) -> Result<Vec<DataType>> {
        self.inner.coerce_types(types)
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        self.inner.return_type(types)
    }

    fn is_nullable(&self) -> bool {
        self.inner.is_nullable()
    }

    fn default_value(&self, kind: &DataType) -> Result<ScalarValue> {
        self.inner.default_value(kind)
    }

    fn accumulator(&self, args: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        if let Some(statistic) = self.statistic(args.is_distinct) {
            return Ok(Box::new(OfAll::new(statistic)));
        }
        if let Some((side, way)) = self.extreme(args.return_type()) {
            return Ok((way.all)(side));
        }
        let percentile = match self.of {
            Of::Percentile => Percentile::new(&args),
            _ => None,
        };
        // What is no percentile is told by DataFusion.
        match percentile {
            Some(percentile) => Ok(Box::new(percentile)),
            None => self.inner.accumulator(args),
        }
    }

    fn create_sliding_accumulator(&self, args: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        if let Some(statistic) = self.statistic(args.is_distinct) {
            return Ok(Box::new(Moving::new(statistic)));
        }
        match (self.of, self.extreme(args.return_type())) {
            (_, Some((side, way))) => Ok((way.moving)(side)),
            (Of::Percentile, _) => self.accumulator(args),
            _ => self.inner.create_sliding_accumulator(args),
        }
    }

    fn state_fields(&self, args: StateFieldsArgs) -> Result<Vec<FieldRef>> {
        match self.statistic(args.is_distinct) {
            Some(_) => Ok(state_fields(args.name)),
            None => self.inner.state_fields(args),
        }
    }

    /// Percentiles of groups are told one by one.
    fn groups_accumulator_supported(&self, args: AccumulatorArgs) -> bool {
        match self.of {
            Of::Percentile => false,
            Of::Statistic(_) => !args.is_distinct,
            Of::Extreme(_) => self.inner.groups_accumulator_supported(args),
        }
    }

    fn create_groups_accumulator(
        &self,
        args: AccumulatorArgs,
    ) -> Result<Box<dyn GroupsAccumulator>> {
        if let Some(statistic) = self.statistic(args.is_distinct) {
            return Ok(Box::new(OfGroups::new(statistic)));
        }
        match self.extreme(args.return_type()) {
            Some((side, way)) => Ok((way.groups)(side)),
            None => self.inner.create_groups_accumulator(args),
        }
    }

    fn reverse_expr(&self) -> ReversedUDAF {
        self.inner.reverse_udf()
    }

    fn order_sensitivity(&self) -> AggregateOrderSensitivity {
        self.inner.order_sensitivity()
    }

    fn is_descending(&self) -> Option<bool> {
        self.inner.is_descending()
    }

    fn value_from_stats(&self, args: &StatisticsArgs) -> Option<ScalarValue> {
        self.inner.value_from_stats(args)
    }

    fn supports_null_handling_clause(&self) -> bool {
        self.inner.supports_null_handling_clause()
    }

    fn supports_within_group_clause(&self) -> bool {
        self.inner.supports_within_group_clause()
    }

    fn documentation(&self) -> Option<&Documentation> {
        self.inner.documentation()
    }

    /// Where bits are sorted, NaN with a sign comes first.
    fn set_monotonicity(&self, kind: &DataType) -> SetMonotonicity {
        match self.extreme(kind) {
            Some(_) => SetMonotonicity::NotMonotonic,
            None => self.inner.inner().set_monotonicity(kind),
        }
    }
}
