//! Operators on integers of one type as functions that refuse what does not fit it.

use std::sync::Arc;

use arrow::array::{ArrayRef, Datum};
use arrow::compute::kernels::numeric::{add, div, mul, neg, rem, sub};
use arrow::datatypes::{DataType, Field, FieldRef};
use arrow::error::ArrowError;
use datafusion::common::{Result, exec_err};
use datafusion::error::DataFusionError;
use datafusion::logical_expr::interval_arithmetic::{Interval, apply_operator};
use datafusion::logical_expr::sort_properties::{ExprProperties, SortProperties};
use datafusion::logical_expr::{
    ColumnarValue, Expr, Operator, ReturnFieldArgs, ScalarFunctionArgs, ScalarUDFImpl, Signature,
    Volatility,
};
use datafusion::physical_expr_common::datum::apply;
use evermap_schemas::{Fault, type_name};

use crate::error::external;

/// Operators of one call at most: all its arguments are there at once, and calls of calls take stack.
const LONGEST: usize = 64;

/// What operators do one after the other, from the left to the right: `a + b - c`.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct Chain {
    operators: Vec<Operator>,
    /// The type of all arguments and of the answer.
    result: DataType,
    name: String,
    signature: Signature,
}

impl Chain {
    /// One operator.
    pub fn new(operator: Operator, result: DataType) -> Self {
        Self::of(vec![operator], result)
    }

    fn of(operators: Vec<Operator>, result: DataType) -> Self {
        let names: Vec<String> = operators.iter().map(ToString::to_string).collect();
        Self {
            operators,
            result,
            name: names.join(" "),
            signature: Signature::variadic_any(Volatility::Immutable),
        }
    }

    /// With one more operator; `None` for one that it cannot have, and where it has enough.
    pub fn then(&self, operator: Operator) -> Option<Self> {
        kernel(operator)?;
        (self.operators.len() < LONGEST).then(|| {
            let operators = [self.operators.as_slice(), &[operator]].concat();
            Self::of(operators, self.result.clone())
        })
    }

    /// The type of its arguments and of its answer.
    pub fn result(&self) -> &DataType {
        &self.result
    }

    fn write_name(&self, args: &[Expr], name: &mut String) {
        let mut args = args.iter();
        if let Some(first) = args.next() {
            write_name(first, name);
        }
        for (operator, arg) in self.operators.iter().zip(args) {
            name.push_str(&format!(" {operator} "));
            write_name(arg, name);
        }
    }

    fn bounds(&self, operator: Operator, left: &Interval, right: &Interval) -> Result<Interval> {
        let is_known = |interval: &Interval| interval.data_type() == self.result;
        // Of a remainder DataFusion knows nothing.
        match operator {
            Operator::Modulo => Interval::make_unbounded(&self.result),
            _ if is_known(left) && is_known(right) => apply_operator(&operator, left, right),
            _ => Interval::make_unbounded(&self.result),
        }
    }
}

/// Writes what an expression is called. Of thousands that stand in each other, each would else write all those within anew.
fn write_name(expr: &Expr, name: &mut String) {
    if let Expr::ScalarFunction(call) = expr {
        let function = call.func.inner();
        if let Some(chain) = function.downcast_ref::<Chain>() {
            return chain.write_name(&call.args, name);
        }
        if function.is::<Negated>() {
            return write_negated(&call.args, name);
        }
    }
    name.push_str(&expr.schema_name().to_string());
}

fn write_negated(args: &[Expr], name: &mut String) {
    for arg in args {
        name.push_str("(- ");
        write_name(arg, name);
        name.push(')');
    }
}

type Kernel = fn(&dyn Datum, &dyn Datum) -> Result<ArrayRef, ArrowError>;

/// What an operator does, and fails where the answer does not fit.
fn kernel(operator: Operator) -> Option<Kernel> {
    match operator {
        Operator::Plus => Some(add),
        Operator::Minus => Some(sub),
        Operator::Multiply => Some(mul),
        Operator::Divide => Some(div),
        Operator::Modulo => Some(rem),
        _ => None,
    }
}

/// How an error begins that says that an answer does not fit its type.
pub const OVERFLOW: &str = "Arithmetic overflow: ";

/// An error of an operator, or of a negation; of an answer that does not fit, with what to write instead.
fn told(error: DataFusionError, operator: Option<Operator>, result: &DataType) -> DataFusionError {
    let DataFusionError::ArrowError(cause, _) = &error else {
        return error;
    };
    let ArrowError::ArithmeticOverflow(said) = &**cause else {
        return error;
    };
    let found = said
        .strip_prefix("Overflow happened on: ")
        .unwrap_or(said.as_str());
    let answer = match operator {
        Some(Operator::Plus) => "a sum",
        Some(Operator::Minus) => "a difference",
        Some(Operator::Multiply) => "a product",
        Some(_) => "a quotient",
        None => "a negation",
    };
    let name = type_name(result);
    let next = match (operator, result) {
        (Some(Operator::Minus), unsigned) if unsigned.is_unsigned_integer() => {
            format!("{name} has nothing below zero: write CAST(… AS BIGINT) - …")
        }
        (_, DataType::Int64 | DataType::UInt64) => {
            "compute with CAST(… AS DECIMAL(38, 0)) or DOUBLE".to_owned()
        }
        _ => "compute with CAST(… AS BIGINT)".to_owned(),
    };
    let message = format!("{OVERFLOW}expected {answer} that fits {name}, found {found}");
    external(Fault::user(message).next(next))
}

/// How `left operator right` is sorted: nothing wraps, so a sum of what rises does.
fn ordering(left: SortProperties, operator: Operator, right: SortProperties) -> SortProperties {
    match operator {
        Operator::Plus => left.add(&right),
        Operator::Minus => left.sub(&right),
        _ if [left, right] == [SortProperties::Singleton; 2] => SortProperties::Singleton,
        _ => SortProperties::Unordered,
    }
}

/// The field of an answer that is null where an argument is.
fn answer(name: &str, result: &DataType, args: &ReturnFieldArgs) -> FieldRef {
    let nullable = args.arg_fields.iter().any(|field| field.is_nullable());
    Arc::new(Field::new(name, result.clone(), nullable))
}

impl ScalarUDFImpl for Chain {
    fn name(&self) -> &str {
        &self.name
    }

    /// As that of the operators: a column of a query is called by it.
    fn schema_name(&self, args: &[Expr]) -> Result<String> {
        let mut name = String::new();
        self.write_name(args, &mut name);
        Ok(name)
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(self.result.clone())
    }

    fn return_field_from_args(&self, args: ReturnFieldArgs) -> Result<FieldRef> {
        Ok(answer(self.name(), &self.result, &args))
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let mut args = args.args.into_iter();
        let Some(first) = args.next() else {
            return exec_err!("{}: expected integers, found none", self.name);
        };
        let mut steps = self.operators.iter().zip(args);
        steps.try_fold(first, |left, (operator, right)| match kernel(*operator) {
            Some(kernel) => apply(&left, &right, kernel)
                .map_err(|error| told(error, Some(*operator), &self.result)),
            None => exec_err!("{operator}: expected an operator on integers"),
        })
    }

    fn is_strict(&self) -> bool {
        true
    }

    fn evaluate_bounds(&self, inputs: &[&Interval]) -> Result<Interval> {
        let Some((first, others)) = inputs.split_first() else {
            return Interval::make_unbounded(&self.result);
        };
        let mut steps = self.operators.iter().zip(others);
        steps.try_fold((*first).clone(), |left, (operator, right)| {
            self.bounds(*operator, &left, right)
        })
    }

    fn output_ordering(&self, inputs: &[ExprProperties]) -> Result<SortProperties> {
        let Some((first, others)) = inputs.split_first() else {
            return Ok(SortProperties::Singleton);
        };
        let steps = self.operators.iter().zip(others);
        Ok(
            steps.fold(first.sort_properties, |left, (operator, right)| {
                ordering(left, *operator, right.sort_properties)
            }),
        )
    }
}

/// `-a`.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct Negated {
    result: DataType,
    signature: Signature,
}

impl Negated {
    /// Of integers with a sign.
    pub fn new(result: DataType) -> Self {
        Self {
            result,
            signature: Signature::any(1, Volatility::Immutable),
        }
    }
}

impl ScalarUDFImpl for Negated {
    fn name(&self) -> &str {
        "-"
    }

    /// As that of the operator.
    fn schema_name(&self, args: &[Expr]) -> Result<String> {
        let mut name = String::new();
        write_negated(args, &mut name);
        Ok(name)
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(self.result.clone())
    }

    fn return_field_from_args(&self, args: ReturnFieldArgs) -> Result<FieldRef> {
        Ok(answer(self.name(), &self.result, &args))
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let negated = match args.args.as_slice() {
            [ColumnarValue::Array(values)] => neg(values.as_ref())
                .map(ColumnarValue::Array)
                .map_err(DataFusionError::from),
            [ColumnarValue::Scalar(value)] => value.arithmetic_negate().map(ColumnarValue::Scalar),
            others => exec_err!("-: expected one integer, found {}", others.len()),
        };
        negated.map_err(|error| told(error, None, &self.result))
    }

    fn is_strict(&self) -> bool {
        true
    }

    fn evaluate_bounds(&self, inputs: &[&Interval]) -> Result<Interval> {
        match inputs {
            [value] if value.data_type() == self.result => value
                .arithmetic_negate()
                .or_else(|_| Interval::make_unbounded(&self.result)),
            _ => Interval::make_unbounded(&self.result),
        }
    }

    fn output_ordering(&self, inputs: &[ExprProperties]) -> Result<SortProperties> {
        Ok(match inputs {
            [value] => -value.sort_properties,
            _ => SortProperties::Unordered,
        })
    }
}
