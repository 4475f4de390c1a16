//! Sums of integers, durations and intervals, and means of durations, that are right or an error.

use std::sync::Arc;

use arrow::datatypes::{
    DataType, DurationMicrosecondType, DurationMillisecondType, DurationNanosecondType,
    DurationSecondType, Field, FieldRef, Int64Type, TimeUnit, UInt64Type,
};
use datafusion::common::{Result, not_impl_err};
use datafusion::logical_expr::function::{AccumulatorArgs, StateFieldsArgs};
use datafusion::logical_expr::utils::{AggregateOrderSensitivity, format_state_name};
use datafusion::logical_expr::{
    Accumulator, AggregateUDF, AggregateUDFImpl, Documentation, GroupsAccumulator, ReversedUDAF,
    SetMonotonicity, Signature,
};

use crate::sql::floats::FloatSum;
use crate::sql::lengths::WHOLE;
use crate::sql::measures::Moving;
use crate::sql::overflow::intervals::IntervalSum;
use crate::sql::overflow::totals::{Adds, DistinctSum, Groups, Sum, WIDE, Whole};

/// DataFusion's `sum` or `avg`, but for what would wrap in 64 bits, and for floating point numbers of a window that moves.
/// `sum` does not become `sum(x) + 1 * count(x)` where `sum(x + 1)` is asked for: that would be added without a check.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct CheckedSum {
    /// The function that adds up everything else.
    pub inner: Arc<AggregateUDF>,
    /// What is made of values.
    pub adds: Adds,
}

impl CheckedSum {
    /// How it is added up here what gives this; `None` where DataFusion does it.
    fn way(&self, result: &DataType) -> Option<Way> {
        match (result, self.adds) {
            (DataType::Int64, Adds::Sum) => Some(Way::of::<Int64Type>(self.adds)),
            (DataType::UInt64, Adds::Sum) => Some(Way::of::<UInt64Type>(self.adds)),
            (DataType::Interval(_), Adds::Sum) => Some(Way {
                states: INTERVALS,
                accumulator: of_intervals,
                groups: None,
            }),
            (DataType::Duration(unit), adds) => Some(match unit {
                TimeUnit::Second => Way::of::<DurationSecondType>(adds),
                TimeUnit::Millisecond => Way::of::<DurationMillisecondType>(adds),
                TimeUnit::Microsecond => Way::of::<DurationMicrosecondType>(adds),
                TimeUnit::Nanosecond => Way::of::<DurationNanosecondType>(adds),
            }),
            _ => None,
        }
    }
}

/// What adds up all groups, around what adds [`WIDE`] numbers.
type Grouped = fn(Box<dyn GroupsAccumulator>) -> Box<dyn GroupsAccumulator>;

/// The columns of a partial answer.
type States = &'static [(&'static str, DataType)];

const SUM: States = &[("sum", WIDE)];
const MEAN: States = &[("count", DataType::UInt64), ("sum", WIDE)];
const INTERVALS: States = &[("months", WIDE), ("days", WIDE), ("nanoseconds", WIDE)];

/// How values of a type are added up.
struct Way {
    states: States,
    /// All values, or each once.
    accumulator: fn(Adds, is_distinct: bool) -> Result<Box<dyn Accumulator>>,
    /// All groups at once, by sums of [`WIDE`] numbers; `None` where each group is added up by itself.
    groups: Option<Grouped>,
}

impl Way {
    fn of<T: Whole>(adds: Adds) -> Self {
        let (states, groups): (_, Option<Grouped>) = match adds {
            Adds::Sum => (SUM, Some(groups::<T>)),
            Adds::Mean => (MEAN, None),
        };
        Self {
            states,
            accumulator: of_numbers::<T>,
            groups,
        }
    }
}

fn of_numbers<T: Whole>(adds: Adds, is_distinct: bool) -> Result<Box<dyn Accumulator>> {
    match (adds, is_distinct) {
        (Adds::Sum, true) => Ok(Box::new(DistinctSum::<T>::default())),
        (Adds::Mean, true) => {
            not_impl_err!("avg(DISTINCT …) of durations; take that of SELECT DISTINCT")
        }
        (_, false) => Ok(Box::new(Sum::<T>::new(adds))),
    }
}

fn groups<T: Whole>(inner: Box<dyn GroupsAccumulator>) -> Box<dyn GroupsAccumulator> {
    Box::new(Groups::<T>::new(inner))
}

fn of_intervals(_: Adds, is_distinct: bool) -> Result<Box<dyn Accumulator>> {
    match is_distinct {
        true => not_impl_err!("sum(DISTINCT …) of intervals; add up those of SELECT DISTINCT"),
        false => Ok(Box::new(IntervalSum::default())),
    }
}

impl AggregateUDFImpl for CheckedSum {
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
        Ok(match self.inner.return_type(types)? {
            DataType::Interval(_) => WHOLE,
            result => result,
        })
    }

    fn accumulator(&self, args: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        match self.way(args.return_type()) {
            Some(way) => (way.accumulator)(self.adds, args.is_distinct),
            None => self.inner.accumulator(args),
        }
    }

    fn create_sliding_accumulator(&self, args: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        let is_float = *args.return_type() == DataType::Float64;
        match self.way(args.return_type()) {
            Some(_) => self.accumulator(args),
            None if is_float && !args.is_distinct => {
                let is_mean = self.adds == Adds::Mean;
                Ok(Box::new(Moving::new(FloatSum { is_mean })))
            }
            None => self.inner.create_sliding_accumulator(args),
        }
    }

    fn state_fields(&self, args: StateFieldsArgs) -> Result<Vec<FieldRef>> {
        match self.way(args.return_type()) {
            Some(way) if !args.is_distinct => {
                let states = way.states.iter().map(|(name, kind)| {
                    let name = format_state_name(args.name, name);
                    Arc::new(Field::new(name, kind.clone(), true))
                });
                Ok(states.collect())
            }
            _ => self.inner.state_fields(args),
        }
    }

    fn groups_accumulator_supported(&self, args: AccumulatorArgs) -> bool {
        let way = self.way(args.return_type());
        way.is_none_or(|way| way.groups.is_some()) && self.inner.groups_accumulator_supported(args)
    }

    fn create_groups_accumulator(
        &self,
        args: AccumulatorArgs,
    ) -> Result<Box<dyn GroupsAccumulator>> {
        let groups = self.way(args.return_type()).and_then(|way| way.groups);
        let Some(groups) = groups else {
            return self.inner.create_groups_accumulator(args);
        };
        let inner = self.inner.create_groups_accumulator(AccumulatorArgs {
            return_field: Arc::new(args.return_field.as_ref().clone().with_data_type(WIDE)),
            ..args
        })?;
        Ok(groups(inner))
    }

    fn reverse_expr(&self) -> ReversedUDAF {
        ReversedUDAF::Identical
    }

    fn order_sensitivity(&self) -> AggregateOrderSensitivity {
        self.inner.order_sensitivity()
    }

    fn documentation(&self) -> Option<&Documentation> {
        self.inner.documentation()
    }

    fn set_monotonicity(&self, result: &DataType) -> SetMonotonicity {
        self.inner.inner().set_monotonicity(result)
    }
}
