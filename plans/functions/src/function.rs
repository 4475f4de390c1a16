//! Scalar functions as they are declared here: once, with what `evermap functions` prints.

use std::hash::{Hash, Hasher};
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray};
use arrow::datatypes::{DataType, Float64Type};
use datafusion::common::{DataFusionError, Result, plan_err};
use datafusion::logical_expr::{
    ColumnarValue, DocSection, Documentation, ScalarFunctionArgs, ScalarUDFImpl, Signature,
    Volatility,
};
use evermap_schemas::{Cell, Pose, Wkb};

use crate::poses::is_pose;

/// What an argument may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A pose of a layer, or of a ROS or Foxglove message.
    Pose,
    /// A geometry as well-known binary.
    Geometry,
    /// A number.
    Number,
    /// A text.
    Text,
    /// A value of any type.
    Any,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Pose => "a pose",
            Self::Geometry => "a geometry",
            Self::Number => "a number",
            Self::Text => "a text",
            Self::Any => "a value",
        }
    }

    /// The type that an argument of this type is converted to; `None` where it is of another kind.
    fn of(self, found: &DataType) -> Option<DataType> {
        match self {
            Self::Pose if found.is_null() => Some(Pose::data_type()),
            Self::Pose => is_pose(found).then(|| found.clone()),
            Self::Geometry => (found.is_null() || found.is_binary()).then(<Wkb as Cell>::data_type),
            Self::Number => (found.is_null() || found.is_numeric()).then_some(DataType::Float64),
            Self::Text => (found.is_null() || found.is_string()).then_some(DataType::Utf8),
            Self::Any => Some(found.clone()),
        }
    }
}

/// An argument: its name, its kind and what it is.
pub(crate) type Argument = (&'static str, Kind, &'static str);

/// The declaration of a function.
pub(crate) struct Declaration {
    /// Its name.
    pub name: &'static str,
    /// What it gives, with unit and frame, and when it is null beside where an argument is.
    pub about: &'static str,
    /// Its arguments, in each way that it may be called.
    pub calls: &'static [&'static [Argument]],
    /// The type that it gives.
    pub result: fn() -> DataType,
    /// A query, and its only value.
    pub example: [&'static str; 2],
    /// The values of all rows, of arguments as `calls` has them.
    pub evaluate: fn(&[ArrayRef]) -> Result<ArrayRef>,
}

/// A declared function.
#[derive(Debug)]
pub(crate) struct Function {
    name: &'static str,
    calls: &'static [&'static [Argument]],
    result: DataType,
    evaluate: fn(&[ArrayRef]) -> Result<ArrayRef>,
    signature: Signature,
    documentation: Documentation,
}

impl Function {
    pub(crate) fn new(declared: &Declaration) -> Self {
        let mut ways = declared.calls.iter().map(|call| way(declared.name, call));
        let first = ways.next().unwrap_or_default();
        let about = format!("{} → {}", declared.about, type_of(&(declared.result)()));
        let [query, answer] = declared.example;
        let documentation = Documentation::builder(DocSection::default(), about, first)
            .with_sql_example(format!("{query} -- {answer}"));
        let mut named: Vec<&str> = Vec::new();
        let arguments = declared.calls.iter().flat_map(|call| call.iter());
        let documentation = arguments.fold(documentation, |documentation, (name, _, about)| {
            if named.contains(name) {
                return documentation;
            }
            named.push(name);
            documentation.with_argument(*name, *about)
        });
        let documentation = ways.fold(documentation, |documentation, way| {
            documentation.with_alternative_syntax(way)
        });
        Self {
            name: declared.name,
            calls: declared.calls,
            result: (declared.result)(),
            evaluate: declared.evaluate,
            signature: Signature::user_defined(Volatility::Immutable),
            documentation: documentation.build(),
        }
    }
}

fn way(name: &str, call: &[Argument]) -> String {
    let names: Vec<_> = call.iter().map(|(name, ..)| *name).collect();
    format!("{name}({})", names.join(", "))
}

fn type_of(result: &DataType) -> String {
    if is_pose(result) {
        return "pose".to_owned();
    }
    match result {
        DataType::Binary => "geometry".to_owned(),
        other => evermap_schemas::type_name(other),
    }
}

/// Functions are told apart by their names.
impl PartialEq for Function {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for Function {}

impl Hash for Function {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.name.hash(state);
    }
}

impl ScalarUDFImpl for Function {
    fn name(&self) -> &str {
        self.name
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn coerce_types(&self, given: &[DataType]) -> Result<Vec<DataType>> {
        let fits = |call: &&[Argument]| -> Option<Vec<DataType>> {
            let kinds = call.iter().map(|(_, kind, _)| kind);
            let types = kinds.zip(given).map(|(kind, found)| kind.of(found));
            (call.len() == given.len()).then(|| types.collect())?
        };
        match self.calls.iter().find_map(fits) {
            Some(types) => Ok(types),
            None => {
                let ways: Vec<_> = self.calls.iter().map(|call| kinds_of(call)).collect();
                let found: Vec<_> = given.iter().map(evermap_schemas::type_name).collect();
                let (ways, found) = (ways.join(" or "), found.join(", "));
                plan_err!("{} expects {ways}, found ({found})", self.name)
            }
        }
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(self.result.clone())
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        Ok(ColumnarValue::Array((self.evaluate)(&columns)?))
    }

    fn documentation(&self) -> Option<&Documentation> {
        Some(&self.documentation)
    }
}

fn kinds_of(call: &[Argument]) -> String {
    let names: Vec<_> = call
        .iter()
        .map(|(name, kind, _)| format!("{name}: {}", kind.name()))
        .collect();
    format!("({})", names.join(", "))
}

/// The numbers of a row; `None` where one is null.
pub(crate) fn given<const N: usize>(columns: &[ArrayRef], row: usize) -> Option<[f64; N]> {
    let columns: &[ArrayRef; N] = columns.try_into().ok()?;
    let mut given = [0.0; N];
    for (number, column) in given.iter_mut().zip(columns) {
        let column = column.as_primitive_opt::<Float64Type>()?;
        *number = column.is_valid(row).then(|| column.value(row))?;
    }
    Some(given)
}

/// How many rows columns have.
pub(crate) fn rows(columns: &[ArrayRef]) -> usize {
    columns.first().map_or(0, |column| column.len())
}

/// A column of values that each row has or not.
pub(crate) fn encoded<T: Cell>(values: Vec<Option<T>>) -> Result<ArrayRef> {
    let encoded = Option::<T>::encode(values);
    encoded.map_err(|fault| DataFusionError::Execution(fault.to_string()))
}

/// A column of numbers from a value for each row.
pub(crate) fn numbers(
    rows: usize,
    value: impl FnMut(usize) -> Result<Option<f64>>,
) -> Result<ArrayRef> {
    let found = (0..rows).map(value);
    let found = found.collect::<Result<arrow::array::Float64Array>>()?;
    Ok(Arc::new(found))
}
