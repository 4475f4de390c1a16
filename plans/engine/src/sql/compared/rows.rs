//! The greatest and the least of some columns, row by row.

use std::cmp::Ordering;
use std::sync::Arc;

use arrow::array::ArrayRef;
use arrow::datatypes::{
    ArrowPrimitiveType, DataType, Float16Type, Float32Type, Float64Type, IntervalMonthDayNanoType,
};
use datafusion::common::{DFSchema, Result, ScalarValue, exec_err};
use datafusion::logical_expr::expr::ScalarFunction;
use datafusion::logical_expr::{
    ColumnarValue, Expr, ExprSchemable, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature,
    Volatility,
};

use crate::sql::compared::plain::has_twins;
use crate::sql::floats;
use crate::sql::lengths;
use crate::sql::measures::{Extreme, Measure, Side, Spread, both};

/// What stands for `greatest` and `least` of values that DataFusion compares by their bits; `None` for all else.
pub fn of_rows(call: &ScalarFunction, schema: &DFSchema) -> Option<Expr> {
    let side = match call.func.name() {
        "greatest" => Side::Greatest,
        "least" => Side::Least,
        _ => return None,
    };
    let kind = call.args.first()?.get_type(schema).ok()?;
    // Of lists, which have no order here, DataFusion tells.
    if !has_twins(&kind) || kind.is_nested() {
        return None;
    }
    let function = ScalarUDF::new_from_impl(ExtremeOfRow {
        side,
        signature: Signature::variadic_any(Volatility::Immutable),
    });
    let call = ScalarFunction::new_udf(Arc::new(function), call.args.clone());
    Some(Expr::ScalarFunction(call))
}

#[derive(Debug, PartialEq, Eq, Hash)]
struct ExtremeOfRow {
    side: Side,
    signature: Signature,
}

impl ScalarUDFImpl for ExtremeOfRow {
    fn name(&self) -> &str {
        match self.side {
            Side::Greatest => "greatest",
            Side::Least => "least",
        }
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        match types {
            [kind, ..] => Ok(kind.clone()),
            [] => exec_err!("expected values, found none"),
        }
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let found = match args.return_field.data_type() {
            DataType::Float16 => found::<Float16Type>(self.side, floats::order, &columns),
            DataType::Float32 => found::<Float32Type>(self.side, floats::order, &columns),
            DataType::Float64 => found::<Float64Type>(self.side, floats::order, &columns),
            _ => found::<IntervalMonthDayNanoType>(self.side, lengths::order, &columns),
        };
        let mut values = args.args.iter();
        Ok(
            match values.all(|value| matches!(value, ColumnarValue::Scalar(_))) {
                true => ColumnarValue::Scalar(ScalarValue::try_from_array(&found, 0)?),
                false => ColumnarValue::Array(found),
            },
        )
    }
}

fn found<T: ArrowPrimitiveType>(
    side: Side,
    order: fn(&T::Native, &T::Native) -> Ordering,
    columns: &[ArrayRef],
) -> ArrayRef {
    let extreme = Extreme::<T>::new(side, order);
    let columns = columns.iter();
    let mut columns = columns.map(|column| extreme.parts(std::slice::from_ref(column)));
    let first = columns.next().unwrap_or_default();
    let best = columns.fold(first, |best, column| {
        let pairs = best.into_iter().zip(column);
        pairs
            .map(|(best, other)| both(&extreme, best, other))
            .collect()
    });
    extreme.answers(best)
}
