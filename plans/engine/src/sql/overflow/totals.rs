//! Numbers of 64 bits added up in 128, which no number of rows fills. What does not fit 64 at the end is an error.

use std::collections::HashMap;
use std::fmt::Debug;
use std::hash::Hash;
use std::marker::PhantomData;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, BooleanArray, PrimitiveArray};
use arrow::datatypes::{
    ArrowPrimitiveType, DECIMAL128_MAX_PRECISION, DataType, Decimal128Type, UInt64Type,
};
use arrow::error::ArrowError;
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::{Accumulator, EmitTo, GroupsAccumulator};
use evermap_schemas::{Fault, type_name};

use crate::sql::overflow::arithmetic::OVERFLOW;

/// What partial sums are kept and handed on as.
pub const WIDE: DataType = DataType::Decimal128(DECIMAL128_MAX_PRECISION, 0);

/// Values whose halves add up in 64 bits.
const AT_ONCE: usize = 1 << 30;

/// A number that is added up.
pub trait Word: Into<i128> + TryFrom<i128> + Eq + Hash + Sized {
    /// The sum of at most [`AT_ONCE`] values. Halves are added in 64 bits: unlike numbers of 128, several at a time.
    fn total(values: &[Self]) -> i128;
}

impl Word for i64 {
    fn total(values: &[Self]) -> i128 {
        let high: i64 = values.iter().map(|value| value >> 32).sum();
        let low: i64 = values.iter().map(|value| value & 0xffff_ffff).sum();
        (i128::from(high) << 32) + i128::from(low)
    }
}

impl Word for u64 {
    fn total(values: &[Self]) -> i128 {
        let high: u64 = values.iter().map(|value| value >> 32).sum();
        let low: u64 = values.iter().map(|value| value & 0xffff_ffff).sum();
        (i128::from(high) << 32) + i128::from(low)
    }
}

/// Values that are such numbers: integers, durations.
pub trait Whole: ArrowPrimitiveType<Native: Word> + Debug + Send + Sync {}

impl<T: ArrowPrimitiveType<Native: Word> + Debug + Send + Sync> Whole for T {}

/// The sum of what is not null.
fn total<T: Whole>(values: &PrimitiveArray<T>) -> i128 {
    let of = |from: usize, to: usize| -> i128 {
        let chunks = values.values()[from..to].chunks(AT_ONCE);
        chunks.map(<T::Native as Word>::total).sum()
    };
    match values.nulls() {
        Some(nulls) => nulls.valid_slices().map(|(from, to)| of(from, to)).sum(),
        None => of(0, values.len()),
    }
}

/// How many are not null.
fn known(values: &dyn Array) -> u64 {
    (values.len() - values.null_count()) as u64
}

fn wide<T: Whole>(value: T::Native) -> i128 {
    value.into()
}

fn narrow<T: Whole>(total: i128) -> Result<T::Native, ArrowError> {
    T::Native::try_from(total).map_err(|_| {
        let of = match T::DATA_TYPE.is_integer() {
            true => "…",
            false => "CAST(… AS BIGINT)",
        };
        let name = type_name(&T::DATA_TYPE);
        let fault = Fault::user(format!(
            "{OVERFLOW}expected a sum that fits {name}, found {total}"
        ));
        let fault = fault.next(format!(
            "add up CAST({of} AS DECIMAL(38, 0)) or DOUBLE instead"
        ));
        ArrowError::ExternalError(Box::new(fault))
    })
}

fn widen<T: Whole>(values: &ArrayRef) -> ArrayRef {
    let wide = values
        .as_primitive::<T>()
        .unary::<_, Decimal128Type>(wide::<T>);
    Arc::new(wide.with_data_type(WIDE))
}

/// A partial sum.
fn as_wide(total: Option<i128>) -> ScalarValue {
    ScalarValue::Decimal128(total, DECIMAL128_MAX_PRECISION, 0)
}

/// An answer.
fn scalar<T: Whole>(total: Option<i128>) -> Result<ScalarValue> {
    let value = total.map(narrow::<T>).transpose()?;
    ScalarValue::new_primitive::<T>(value, &T::DATA_TYPE)
}

/// What is made of the values that are added up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum Adds {
    /// Their sum.
    #[default]
    Sum,
    /// Their sum by their number.
    Mean,
}

/// The sum or the mean of all rows, or of those in a window.
#[derive(Debug)]
pub struct Sum<T> {
    adds: Adds,
    total: i128,
    /// Values in it: of none the answer is null.
    count: u64,
    of: PhantomData<T>,
}

impl<T> Default for Sum<T> {
    fn default() -> Self {
        Self::new(Adds::default())
    }
}

impl<T> Sum<T> {
    /// Of nothing yet.
    pub fn new(adds: Adds) -> Self {
        Self {
            adds,
            total: 0,
            count: 0,
            of: PhantomData,
        }
    }

    /// The sum; `None` where there is nothing to add up.
    pub fn total(&self) -> Option<i128> {
        (self.count > 0).then_some(self.total)
    }
}

impl<T: Whole> Accumulator for Sum<T> {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for values in values {
            let values = values.as_primitive::<T>();
            self.total += total(values);
            self.count += known(values);
        }
        Ok(())
    }

    fn retract_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for values in values {
            let values = values.as_primitive::<T>();
            self.total -= total(values);
            self.count -= known(values);
        }
        Ok(())
    }

    fn supports_retract_batch(&self) -> bool {
        true
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        let sum = as_wide(self.total());
        Ok(match self.adds {
            Adds::Sum => vec![sum],
            Adds::Mean => vec![ScalarValue::UInt64(Some(self.count)), sum],
        })
    }

    fn merge_batch(&mut self, states: &[ArrayRef]) -> Result<()> {
        let Some((totals, counts)) = states.split_last() else {
            return Ok(());
        };
        let totals = totals.as_primitive::<Decimal128Type>();
        self.total += totals.iter().flatten().sum::<i128>();
        self.count += match counts.first() {
            Some(counts) => counts
                .as_primitive::<UInt64Type>()
                .iter()
                .flatten()
                .sum::<u64>(),
            None => known(totals),
        };
        Ok(())
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        scalar::<T>(match self.adds {
            Adds::Sum => self.total(),
            Adds::Mean => self.total.checked_div(i128::from(self.count)),
        })
    }

    fn size(&self) -> usize {
        size_of_val(self)
    }
}

/// The sum of values that are each counted once, of all rows or those in a window.
#[derive(Debug)]
pub struct DistinctSum<T: Whole> {
    total: i128,
    /// How often each is there.
    counts: HashMap<T::Native, usize>,
}

impl<T: Whole> Default for DistinctSum<T> {
    fn default() -> Self {
        Self {
            total: 0,
            counts: HashMap::new(),
        }
    }
}

impl<T: Whole> DistinctSum<T> {
    fn add(&mut self, values: &ArrayRef) {
        for value in values.as_primitive::<T>().iter().flatten() {
            let count = self.counts.entry(value).or_default();
            if *count == 0 {
                self.total += wide::<T>(value);
            }
            *count += 1;
        }
    }
}

impl<T: Whole> Accumulator for DistinctSum<T> {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        values.iter().for_each(|values| self.add(values));
        Ok(())
    }

    fn retract_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        let values = values.iter().map(|values| values.as_primitive::<T>());
        for value in values.flat_map(|values| values.iter().flatten()) {
            if let Some(count) = self.counts.get_mut(&value) {
                *count -= 1;
                if *count == 0 {
                    self.counts.remove(&value);
                    self.total -= wide::<T>(value);
                }
            }
        }
        Ok(())
    }

    fn supports_retract_batch(&self) -> bool {
        true
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        let value =
            |value: &T::Native| ScalarValue::new_primitive::<T>(Some(*value), &T::DATA_TYPE);
        let values = self.counts.keys().map(value).collect::<Result<Vec<_>>>()?;
        let values = ScalarValue::new_list_nullable(&values, &T::DATA_TYPE);
        Ok(vec![ScalarValue::List(values)])
    }

    fn merge_batch(&mut self, states: &[ArrayRef]) -> Result<()> {
        let lists = states.iter().map(|lists| lists.as_list::<i32>());
        for values in lists.flat_map(|lists| lists.iter().flatten()) {
            self.add(&values);
        }
        Ok(())
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        scalar::<T>((!self.counts.is_empty()).then_some(self.total))
    }

    fn size(&self) -> usize {
        size_of_val(self) + self.counts.capacity() * size_of::<(T::Native, usize)>()
    }
}

/// The sums of groups, by DataFusion's sums of decimals.
pub struct Groups<T> {
    inner: Box<dyn GroupsAccumulator>,
    of: PhantomData<T>,
}

impl<T> Groups<T> {
    /// By sums of [`WIDE`] numbers.
    pub fn new(inner: Box<dyn GroupsAccumulator>) -> Self {
        let of = PhantomData;
        Self { inner, of }
    }
}

impl<T: Whole> GroupsAccumulator for Groups<T> {
    fn update_batch(
        &mut self,
        values: &[ArrayRef],
        group_indices: &[usize],
        opt_filter: Option<&BooleanArray>,
        total_num_groups: usize,
    ) -> Result<()> {
        let values: Vec<ArrayRef> = values.iter().map(widen::<T>).collect();
        self.inner
            .update_batch(&values, group_indices, opt_filter, total_num_groups)
    }

    fn evaluate(&mut self, emit_to: EmitTo) -> Result<ArrayRef> {
        let totals = self.inner.evaluate(emit_to)?;
        let totals = totals.as_primitive::<Decimal128Type>();
        let sums: PrimitiveArray<T> = totals.try_unary(narrow::<T>)?;
        Ok(Arc::new(sums))
    }

    fn state(&mut self, emit_to: EmitTo) -> Result<Vec<ArrayRef>> {
        self.inner.state(emit_to)
    }

    fn merge_batch(
        &mut self,
        values: &[ArrayRef],
        group_indices: &[usize],
        total_num_groups: usize,
    ) -> Result<()> {
        self.inner
            .merge_batch(values, group_indices, total_num_groups)
    }

    fn convert_to_state(
        &self,
        values: &[ArrayRef],
        opt_filter: Option<&BooleanArray>,
    ) -> Result<Vec<ArrayRef>> {
        let values: Vec<ArrayRef> = values.iter().map(widen::<T>).collect();
        self.inner.convert_to_state(&values, opt_filter)
    }

    fn size(&self) -> usize {
        self.inner.size()
    }
}
