//! Values of which those that are equal have the same bits.

use std::sync::Arc;

use arrow::array::{
    Array, ArrayRef, AsArray, FixedSizeListArray, GenericListArray, OffsetSizeTrait, StructArray,
};
use arrow::datatypes::{
    ArrowPrimitiveType, DataType, FieldRef, Float16Type, Float32Type, Float64Type,
    IntervalMonthDayNanoType, IntervalUnit,
};
use datafusion::common::{Column, DFSchema, Result, ScalarValue, exec_err};
use datafusion::logical_expr::expr::{Cast, ScalarFunction};
use datafusion::logical_expr::{
    ColumnarValue, Expr, ExprSchemable, LogicalPlan, Projection, ReturnFieldArgs,
    ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature, Volatility,
};

use crate::sql::lengths;

/// What [`Compared`] is called.
const COMPARED: &str = "compared";

/// Puts [`Compared`] around a term, if it is one of values that have twins; whether it is.
pub fn compare(value: &mut Expr, schema: &DFSchema) -> bool {
    let is_compared = matches!(&*value, Expr::ScalarFunction(call) if call.func.name() == COMPARED);
    if is_compared || !value.get_type(schema).is_ok_and(|kind| has_twins(&kind)) {
        return false;
    }
    let args = vec![std::mem::take(value)];
    let function = Arc::new(ScalarUDF::new_from_impl(Compared::default()));
    *value = Expr::ScalarFunction(ScalarFunction::new_udf(function, args));
    true
}

/// As [`compare`], of each.
pub fn compare_all<'a>(values: impl IntoIterator<Item = &'a mut Expr>, schema: &DFSchema) -> bool {
    let values = values.into_iter().map(|value| compare(value, schema));
    values.fold(false, |before, value| before | value)
}

/// A number that is written; `None` for what is none, and within for null.
pub fn number(value: &Expr) -> Option<Option<f64>> {
    let value = match value {
        Expr::Cast(Cast { expr, .. }) => expr.as_ref(),
        value => value,
    };
    match value.as_literal()?.cast_to(&DataType::Float64) {
        Ok(ScalarValue::Float64(number)) => Some(number),
        _ => None,
    }
}

/// Whether there are values of a type that are equal and have other bits.
pub fn has_twins(kind: &DataType) -> bool {
    match innermost(kind) {
        DataType::Struct(members) => members.iter().any(|member| has_twins(member.data_type())),
        item => item.is_floating() || *item == lengths::WHOLE,
    }
}

/// What lists have, and lists of lists.
pub fn innermost(kind: &DataType) -> &DataType {
    match kind {
        DataType::List(item) | DataType::LargeList(item) | DataType::FixedSizeList(item, _) => {
            innermost(item.data_type())
        }
        kind => kind,
    }
}

/// Values that something goes by, as columns below it.
pub struct Keys {
    /// How many columns there are beside them: each node has more of them than the one below it, so names are not met again.
    others: usize,
    values: Vec<Expr>,
}

impl Keys {
    /// None yet.
    pub fn beside(schema: &DFSchema) -> Self {
        Self {
            others: schema.fields().len(),
            values: Vec::new(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    fn name(&self, at: usize) -> String {
        format!("__{COMPARED}_{}", self.others + at)
    }

    /// The column of a value.
    pub fn column(&mut self, value: Expr) -> Expr {
        let at = self.values.iter().position(|known| *known == value);
        let at = at.unwrap_or_else(|| {
            self.values.push(value);
            self.values.len() - 1
        });
        Expr::Column(Column::new_unqualified(self.name(at)))
    }

    /// Rows with these columns, too.
    pub fn added(self, rows: Arc<LogicalPlan>) -> Result<Arc<LogicalPlan>> {
        if self.is_empty() {
            return Ok(rows);
        }
        let keys = self.values.iter().enumerate();
        let keys = keys.map(|(at, value)| value.clone().alias(self.name(at)));
        let columns = rows.schema().iter();
        let columns = columns.map(|field| Expr::Column(Column::from(field)));
        let columns = columns.chain(keys).collect();
        let rows = Projection::try_new(columns, rows)?;
        Ok(Arc::new(LogicalPlan::Projection(rows)))
    }
}

/// Values as they are, but for twins: of them all are one.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Compared {
    signature: Signature,
}

impl Default for Compared {
    fn default() -> Self {
        Self {
            signature: Signature::any(1, Volatility::Immutable),
        }
    }
}

impl ScalarUDFImpl for Compared {
    fn name(&self) -> &str {
        COMPARED
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        match types {
            [kind] => Ok(kind.clone()),
            others => exec_err!("expected one value, found {}", others.len()),
        }
    }

    fn return_field_from_args(&self, args: ReturnFieldArgs) -> Result<FieldRef> {
        match args.arg_fields {
            [field] => Ok(Arc::clone(field)),
            others => exec_err!("expected one value, found {}", others.len()),
        }
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        match args.args.as_slice() {
            [ColumnarValue::Array(values)] => Ok(ColumnarValue::Array(plain(values)?)),
            [ColumnarValue::Scalar(value)] => {
                let plain = plain(&value.to_array()?)?;
                Ok(ColumnarValue::Scalar(ScalarValue::try_from_array(
                    &plain, 0,
                )?))
            }
            others => exec_err!("expected one value, found {}", others.len()),
        }
    }
}

type Half = <Float16Type as ArrowPrimitiveType>::Native;

/// Values with one zero and one NaN, and one interval of each length.
fn plain(values: &ArrayRef) -> Result<ArrayRef> {
    Ok(match values.data_type() {
        DataType::Float16 => numbers::<Float16Type>(values, Half::ZERO, Half::NAN),
        DataType::Float32 => numbers::<Float32Type>(values, 0.0, f32::NAN),
        DataType::Float64 => numbers::<Float64Type>(values, 0.0, f64::NAN),
        DataType::Interval(IntervalUnit::MonthDayNano) => {
            let intervals = values.as_primitive::<IntervalMonthDayNanoType>();
            Arc::new(intervals.unary::<_, IntervalMonthDayNanoType>(lengths::plain))
        }
        DataType::Struct(members) => {
            let rows = values.as_struct();
            let columns = rows.columns().iter().map(plain).collect::<Result<_>>()?;
            let (members, nulls) = (members.clone(), rows.nulls().cloned());
            let rows = StructArray::try_new_with_length(members, columns, nulls, rows.len())?;
            Arc::new(rows)
        }
        DataType::List(item) => list::<i32>(values, item)?,
        DataType::LargeList(item) => list::<i64>(values, item)?,
        DataType::FixedSizeList(item, size) => {
            let lists = values.as_fixed_size_list();
            let (items, nulls) = (plain(lists.values())?, lists.nulls().cloned());
            let (item, count) = (Arc::clone(item), lists.len());
            let lists = FixedSizeListArray::try_new_with_length(item, *size, items, nulls, count)?;
            Arc::new(lists)
        }
        _ => Arc::clone(values),
    })
}

fn numbers<T: ArrowPrimitiveType>(values: &ArrayRef, zero: T::Native, nan: T::Native) -> ArrayRef {
    let plain = |value: T::Native| match value.partial_cmp(&value) {
        None => nan,
        Some(_) if value == zero => zero,
        Some(_) => value,
    };
    Arc::new(values.as_primitive::<T>().unary::<_, T>(plain))
}

fn list<O: OffsetSizeTrait>(values: &ArrayRef, item: &FieldRef) -> Result<ArrayRef> {
    let lists = values.as_list::<O>();
    let (offsets, nulls) = (lists.offsets().clone(), lists.nulls().cloned());
    let items = plain(lists.values())?;
    let lists = GenericListArray::<O>::try_new(Arc::clone(item), offsets, items, nulls)?;
    Ok(Arc::new(lists))
}
