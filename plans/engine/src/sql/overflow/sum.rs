//! Sums of integers in 128 bits, which no number of rows fills, that fail where the answer does not fit 64.

use std::collections::HashMap;
use std::fmt::Debug;
use std::hash::Hash;
use std::marker::PhantomData;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, BooleanArray, PrimitiveArray};
use arrow::datatypes::{
    ArrowPrimitiveType, DECIMAL128_MAX_PRECISION, DataType, Decimal128Type, Field, FieldRef,
    Int64Type, UInt64Type,
};
use arrow::error::ArrowError;
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::function::{AccumulatorArgs, StateFieldsArgs};
use datafusion::logical_expr::utils::{AggregateOrderSensitivity, format_state_name};
use datafusion::logical_expr::{
    Accumulator, AggregateUDF, AggregateUDFImpl, Documentation, EmitTo, GroupsAccumulator,
    ReversedUDAF, SetMonotonicity, Signature,
};

/// What partial sums are kept and handed on as.
const WIDE: DataType = DataType::Decimal128(DECIMAL128_MAX_PRECISION, 0);

/// Values whose halves add up in 64 bits.
const AT_ONCE: usize = 1 << 30;

/// DataFusion's `sum`, but for integers. It does not become `sum(x) + 1 * count(x)` where `sum(x + 1)` is asked for: that
/// would be added without a check.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct CheckedSum {
    inner: Arc<AggregateUDF>,
}

impl CheckedSum {
    /// Of the function that adds up everything else.
    pub fn new(inner: Arc<AggregateUDF>) -> Self {
        Self { inner }
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
        self.inner.return_type(types)
    }

    fn accumulator(&self, args: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        match args.return_type() {
            DataType::Int64 => Ok(accumulator::<Int64Type>(args.is_distinct)),
            DataType::UInt64 => Ok(accumulator::<UInt64Type>(args.is_distinct)),
            _ => self.inner.accumulator(args),
        }
    }

    fn create_sliding_accumulator(&self, args: AccumulatorArgs) -> Result<Box<dyn Accumulator>> {
        match args.return_type() {
            DataType::Int64 | DataType::UInt64 => self.accumulator(args),
            _ => self.inner.create_sliding_accumulator(args),
        }
    }

    fn state_fields(&self, args: StateFieldsArgs) -> Result<Vec<FieldRef>> {
        let is_wide = matches!(args.return_type(), DataType::Int64 | DataType::UInt64);
        if args.is_distinct || !is_wide {
            return self.inner.state_fields(args);
        }
        let name = format_state_name(args.name, "sum");
        Ok(vec![Arc::new(Field::new(name, WIDE, true))])
    }

    fn groups_accumulator_supported(&self, args: AccumulatorArgs) -> bool {
        self.inner.groups_accumulator_supported(args)
    }

    fn create_groups_accumulator(
        &self,
        args: AccumulatorArgs,
    ) -> Result<Box<dyn GroupsAccumulator>> {
        let result = args.return_type().clone();
        if !matches!(result, DataType::Int64 | DataType::UInt64) {
            return self.inner.create_groups_accumulator(args);
        }
        let inner = self.inner.create_groups_accumulator(AccumulatorArgs {
            return_field: Arc::new(args.return_field.as_ref().clone().with_data_type(WIDE)),
            ..args
        })?;
        let groups: Box<dyn GroupsAccumulator> = match result {
            DataType::UInt64 => Box::new(Groups::<UInt64Type>::new(inner)),
            _ => Box::new(Groups::<Int64Type>::new(inner)),
        };
        Ok(groups)
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

/// Integers of 64 bits.
trait Whole:
    ArrowPrimitiveType<Native: Into<i128> + TryFrom<i128> + Eq + Hash> + Debug + Send + Sync
{
    /// The sum of at most [`AT_ONCE`] values. Halves are added in 64 bits: unlike numbers of 128, several at a time.
    fn total(values: &[Self::Native]) -> i128;
}

impl Whole for Int64Type {
    fn total(values: &[i64]) -> i128 {
        let high: i64 = values.iter().map(|value| value >> 32).sum();
        let low: i64 = values.iter().map(|value| value & 0xffff_ffff).sum();
        (i128::from(high) << 32) + i128::from(low)
    }
}

impl Whole for UInt64Type {
    fn total(values: &[u64]) -> i128 {
        let high: u64 = values.iter().map(|value| value >> 32).sum();
        let low: u64 = values.iter().map(|value| value & 0xffff_ffff).sum();
        (i128::from(high) << 32) + i128::from(low)
    }
}

/// The sum of what is not null.
fn total<T: Whole>(values: &PrimitiveArray<T>) -> i128 {
    let of = |from: usize, to: usize| -> i128 {
        let chunks = values.values()[from..to].chunks(AT_ONCE);
        chunks.map(T::total).sum()
    };
    match values.nulls() {
        Some(nulls) => nulls.valid_slices().map(|(from, to)| of(from, to)).sum(),
        None => of(0, values.len()),
    }
}

fn wide<T: Whole>(value: T::Native) -> i128 {
    value.into()
}

fn narrow<T: Whole>(total: i128) -> Result<T::Native, ArrowError> {
    T::Native::try_from(total).map_err(|_| {
        ArrowError::ArithmeticOverflow(format!(
            "expected a sum that fits {}, found {total}; add up CAST(… AS DECIMAL(38, 0)) or DOUBLE instead",
            T::DATA_TYPE
        ))
    })
}

fn widen<T: Whole>(values: &ArrayRef) -> ArrayRef {
    let wide = values
        .as_primitive::<T>()
        .unary::<_, Decimal128Type>(wide::<T>);
    Arc::new(wide.with_data_type(WIDE))
}

fn accumulator<T: Whole>(is_distinct: bool) -> Box<dyn Accumulator> {
    match is_distinct {
        true => Box::new(DistinctSum::<T>::default()),
        false => Box::new(Sum::<T>::default()),
    }
}

/// The sum of all rows, or of those in a window.
#[derive(Debug)]
struct Sum<T> {
    total: i128,
    /// Values in it: of none the sum is null.
    count: usize,
    of: PhantomData<T>,
}

impl<T> Default for Sum<T> {
    fn default() -> Self {
        Self {
            total: 0,
            count: 0,
            of: PhantomData,
        }
    }
}

impl<T: Whole> Accumulator for Sum<T> {
    fn update_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for values in values {
            let values = values.as_primitive::<T>();
            self.total += total(values);
            self.count += values.len() - values.null_count();
        }
        Ok(())
    }

    fn retract_batch(&mut self, values: &[ArrayRef]) -> Result<()> {
        for values in values {
            let values = values.as_primitive::<T>();
            self.total -= total(values);
            self.count -= values.len() - values.null_count();
        }
        Ok(())
    }

    fn supports_retract_batch(&self) -> bool {
        true
    }

    fn state(&mut self) -> Result<Vec<ScalarValue>> {
        let total = (self.count > 0).then_some(self.total);
        let total = ScalarValue::Decimal128(total, DECIMAL128_MAX_PRECISION, 0);
        Ok(vec![total])
    }

    fn merge_batch(&mut self, states: &[ArrayRef]) -> Result<()> {
        for totals in states {
            for total in totals.as_primitive::<Decimal128Type>().iter().flatten() {
                self.total += total;
                self.count += 1;
            }
        }
        Ok(())
    }

    fn evaluate(&mut self) -> Result<ScalarValue> {
        let total = (self.count > 0).then(|| narrow::<T>(self.total));
        ScalarValue::new_primitive::<T>(total.transpose()?, &T::DATA_TYPE)
    }

    fn size(&self) -> usize {
        size_of_val(self)
    }
}

/// The sum of values that are each counted once, of all rows or those in a window.
#[derive(Debug)]
struct DistinctSum<T: Whole> {
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
        let total = (!self.counts.is_empty()).then(|| narrow::<T>(self.total));
        ScalarValue::new_primitive::<T>(total.transpose()?, &T::DATA_TYPE)
    }

    fn size(&self) -> usize {
        size_of_val(self) + self.counts.capacity() * size_of::<(T::Native, usize)>()
    }
}

/// The sums of groups, by DataFusion's sums of decimals.
struct Groups<T> {
    inner: Box<dyn GroupsAccumulator>,
    of: PhantomData<T>,
}

impl<T> Groups<T> {
    fn new(inner: Box<dyn GroupsAccumulator>) -> Self {
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
