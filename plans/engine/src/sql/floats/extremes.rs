//! The least and the greatest floating point number: NaN is greater than any other, whatever its sign.

use std::cmp::Ordering;
use std::fmt::Debug;
use std::marker::PhantomData;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, BooleanArray, PrimitiveArray};
use arrow::datatypes::ArrowPrimitiveType;
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::{Accumulator, EmitTo, GroupsAccumulator};

use crate::sql::floats::moving::Measure;

/// Which number is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// The least.
    Least,
    /// The greatest.
    Greatest,
}

impl Side {
    /// That of two numbers that is looked for; of equal ones the first.
    fn of<N: PartialOrd>(self, first: N, second: N) -> N {
        let wanted = match self {
            Self::Least => Ordering::Greater,
            Self::Greatest => Ordering::Less,
        };
        match order(&first, &second) == wanted {
            true => second,
            false => first,
        }
    }
}

/// How two numbers are ordered.
pub fn order<N: PartialOrd>(left: &N, right: &N) -> Ordering {
    let is_nan = |value: &N| value.partial_cmp(value).is_none();
    let order = left.partial_cmp(right);
    order.unwrap_or_else(|| is_nan(left).cmp(&is_nan(right)))
}

/// The extreme of numbers of a type.
#[derive(Debug)]
pub struct Extreme<T> {
    side: Side,
    of: PhantomData<T>,
}

impl<T> Extreme<T> {
    /// On that side.
    pub fn new(side: Side) -> Self {
        let of = PhantomData;
        Self { side, of }
    }
}

impl<T: ArrowPrimitiveType + Debug + Send + Sync> Measure for Extreme<T> {
    type Part = T::Native;

    fn parts(&self, values: &[ArrayRef]) -> Vec<T::Native> {
        let values = values.iter().map(|values| values.as_primitive::<T>());
        values.flat_map(|values| values.iter().flatten()).collect()
    }

    fn joined(&self, before: T::Native, after: T::Native) -> T::Native {
        self.side.of(before, after)
    }

    fn answer(&self, all: Option<T::Native>) -> Result<ScalarValue> {
        ScalarValue::new_primitive::<T>(all, &T::DATA_TYPE)
    }
}

/// The extreme of all rows.
#[derive(Debug)]
pub struct ExtremeOfAll<T: ArrowPrimitiveType> {
    extreme: Extreme<T>,
    found: Option<T::Native>,
}

impl<T: ArrowPrimitiveType> ExtremeOfAll<T> {
    /// Of no rows yet.
    pub fn new(side: Side) -> Self {
        Self {
            extreme: Extreme::new(side),
            found: None,
        }
    }
}

impl<T: ArrowPrimitiveType + Debug + Send + Sync> Accumulator for ExtremeOfAll<T> {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        let side = self.extreme.side;
        let values = values.iter().map(|values| values.as_primitive::<T>());
        let values = values.flat_map(|values| values.iter().flatten());
        let found = self.found.into_iter().chain(values);
        self.found = found.reduce(|first, second| side.of(first, second));
        Ok(())
    }

    fn merge_batch(&mut self, states: &[ArrayRef]) -> Result<()> {
        self.update_batch(states)
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        Ok(vec![self.evaluate()?])
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        self.extreme.answer(self.found)
    }

    fn size(&self) -> usize {
        size_of_val(self)
    }
}

/// The extremes of groups.
#[derive(Debug)]
pub struct ExtremesOfGroups<T: ArrowPrimitiveType> {
    side: Side,
    found: Vec<Option<T::Native>>,
}

impl<T: ArrowPrimitiveType> ExtremesOfGroups<T> {
    /// Of no groups yet.
    pub fn new(side: Side) -> Self {
        let found = Vec::new();
        Self { side, found }
    }
}

/// Whether a filter lets a row through.
fn passes(filter: Option<&BooleanArray>, row: usize) -> bool {
    filter.is_none_or(|filter| filter.is_valid(row) && filter.value(row))
}

impl<T: ArrowPrimitiveType + Debug + Send + Sync> GroupsAccumulator for ExtremesOfGroups<T> {
    fn update_batch(
        &mut self,
        values: &[ArrayRef],
        group_indices: &[usize],
        opt_filter: Option<&BooleanArray>,
        total_num_groups: usize,
    ) -> Result<()> {
        let side = self.side;
        self.found.resize(total_num_groups, None);
        for values in values {
            let values = values.as_primitive::<T>().iter().zip(group_indices);
            for (row, (value, group)) in values.enumerate() {
                if let Some(value) = value
                    && passes(opt_filter, row)
                    && let Some(found) = self.found.get_mut(*group)
                {
                    *found = Some(found.map_or(value, |found| side.of(found, value)));
                }
            }
        }
        Ok(())
    }

    fn merge_batch(
        &mut self,
        values: &[ArrayRef],
        group_indices: &[usize],
        total_num_groups: usize,
    ) -> Result<()> {
        self.update_batch(values, group_indices, None, total_num_groups)
    }

    fn evaluate(&mut self, emit_to: EmitTo) -> Result<ArrayRef> {
        let found = emit_to.take_needed(&mut self.found);
        let found: PrimitiveArray<T> = found.into_iter().collect();
        Ok(Arc::new(found))
    }

    fn state(&mut self, emit_to: EmitTo) -> Result<Vec<ArrayRef>> {
        Ok(vec![self.evaluate(emit_to)?])
    }

    fn convert_to_state(
        &self,
        values: &[ArrayRef],
        opt_filter: Option<&BooleanArray>,
    ) -> Result<Vec<ArrayRef>> {
        let state = |values: &ArrayRef| -> ArrayRef {
            let rows = values.as_primitive::<T>().iter().enumerate();
            let rows = rows.map(|(row, value)| value.filter(|_| passes(opt_filter, row)));
            Arc::new(rows.collect::<PrimitiveArray<T>>())
        };
        Ok(values.iter().map(state).collect())
    }

    fn size(&self) -> usize {
        self.found.capacity() * size_of::<Option<T::Native>>()
    }
}
