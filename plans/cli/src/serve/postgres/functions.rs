//! Functions on types that clients of Postgres ask, and the library has not, or knows too few types for.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, Int32Array, ListArray, StringArray, StructArray};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Field, Fields, Int32Type};
use datafusion::common::exec_err;
use datafusion::error::Result;
use datafusion::logical_expr::{
    ColumnarValue, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature, TypeSignature,
    Volatility,
};
use datafusion::prelude::SessionContext;
use datafusion::scalar::ScalarValue;

use crate::output::GEOMETRY;
use crate::serve::postgres::geometry::OID;

/// A function on types.
pub trait OnTypes: std::fmt::Debug + Send + Sync + Eq + std::hash::Hash + 'static {
    /// Its name.
    fn name(&self) -> &'static str;
    /// What it takes.
    fn signature(&self) -> Signature;
    /// What it gives.
    fn result(&self) -> DataType;
    /// Answers one call.
    ///
    /// # Errors
    /// For arguments that it does not take.
    fn answer(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue>;
}

#[derive(Debug, PartialEq, Eq, Hash)]
struct Function<F> {
    of: F,
    signature: Signature,
}

/// It, to be called.
pub fn function(of: impl OnTypes) -> ScalarUDF {
    let signature = of.signature();
    ScalarUDF::from(Function { of, signature })
}

/// Adds a function to a context, in place of one of its name.
pub fn register(context: &SessionContext, of: impl OnTypes) {
    context.register_udf(function(of));
}

impl<F: OnTypes> ScalarUDFImpl for Function<F> {
    fn name(&self) -> &str {
        self.of.name()
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(self.of.result())
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        self.of.answer(args)
    }
}

/// What the server says of itself, for clients that ask how they may speak to it: that of Postgres of the version whose
/// clients are understood.
pub const SETTINGS: [(&str, &str); 14] = [
    ("DateStyle", "ISO, MDY"),
    ("TimeZone", "UTC"),
    ("client_encoding", "UTF8"),
    ("default_transaction_isolation", "read committed"),
    ("default_transaction_read_only", "on"),
    ("integer_datetimes", "on"),
    ("is_superuser", "off"),
    ("lc_collate", "C"),
    ("max_index_keys", "32"),
    ("search_path", "public"),
    ("server_encoding", "UTF8"),
    ("server_version", "16.6"),
    ("server_version_num", "160006"),
    ("standard_conforming_strings", "on"),
];

/// `current_setting(name [, missing_ok])`: one of [`SETTINGS`]; null where there is none.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct CurrentSetting;

impl OnTypes for CurrentSetting {
    fn name(&self) -> &'static str {
        "current_setting"
    }

    fn signature(&self) -> Signature {
        let calls = [
            vec![DataType::Utf8],
            vec![DataType::Utf8, DataType::Boolean],
        ];
        let calls = calls.map(TypeSignature::Exact);
        Signature::one_of(calls.into(), Volatility::Immutable)
    }

    fn result(&self) -> DataType {
        DataType::Utf8
    }

    fn answer(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let Some(names) = columns.first() else {
            return exec_err!("expected the name of a setting, found nothing");
        };
        let value = |name: Option<&str>| {
            let name = name?;
            let mut settings = SETTINGS.iter();
            let found = settings.find(|(known, _)| known.eq_ignore_ascii_case(name));
            found.map(|(_, value)| *value)
        };
        let values = names.as_string::<i32>().iter().map(value);
        Ok(ColumnarValue::Array(Arc::new(
            values.collect::<StringArray>(),
        )))
    }
}

/// `to_regtype(name)`: the number of a type; null where there is none of that name.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct ToRegtype {
    /// They, by name.
    pub numbers: BTreeMap<String, i32>,
}

impl OnTypes for ToRegtype {
    fn name(&self) -> &'static str {
        "to_regtype"
    }

    fn signature(&self) -> Signature {
        Signature::exact(vec![DataType::Utf8], Volatility::Immutable)
    }

    fn result(&self) -> DataType {
        DataType::Int32
    }

    fn answer(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let [names] = columns.as_slice() else {
            return exec_err!("expected one argument, found {}", columns.len());
        };
        let number = |name: Option<&str>| self.numbers.get(name?).copied();
        let numbers = names.as_string::<i32>().iter().map(number);
        Ok(ColumnarValue::Array(Arc::new(
            numbers.collect::<Int32Array>(),
        )))
    }
}

/// `format_type(number, modifier)` of the library, with one type more.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct FormatType {
    /// The library's.
    pub inner: Arc<ScalarUDF>,
}

impl OnTypes for FormatType {
    fn name(&self) -> &'static str {
        "format_type"
    }

    fn signature(&self) -> Signature {
        self.inner.signature().clone()
    }

    fn result(&self) -> DataType {
        DataType::Utf8
    }

    fn answer(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let numbers = match args.args.first() {
            Some(numbers) => cast(&numbers.to_array(args.number_rows)?, &DataType::Int32)?,
            None => return exec_err!("expected the number of a type, found none"),
        };
        let rows = args.number_rows;
        let names = self.inner.invoke_with_args(args)?.to_array(rows)?;
        let names = cast(&names, &DataType::Utf8)?;
        let numbers = numbers.as_primitive::<Int32Type>().iter();
        let named = numbers.zip(names.as_string::<i32>().iter());
        let named = named.map(|(number, name)| match number == Some(OID.cast_signed()) {
            true => Some(GEOMETRY),
            false => name,
        });
        Ok(ColumnarValue::Array(Arc::new(
            named.collect::<StringArray>(),
        )))
    }
}

/// `array_out(list)`: its elements as Postgres writes an array.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct ArrayOut;

impl OnTypes for ArrayOut {
    fn name(&self) -> &'static str {
        "array_out"
    }

    fn signature(&self) -> Signature {
        Signature::any(1, Volatility::Immutable)
    }

    fn result(&self) -> DataType {
        DataType::Utf8
    }

    fn answer(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let lists = match columns.as_slice() {
            [lists] if matches!(lists.data_type(), DataType::List(_)) => lists.as_list::<i32>(),
            other => return exec_err!("expected a list, found {} values", other.len()),
        };
        let texts = lists.iter().map(|list| list.map(|list| literal(&list)));
        let texts = texts
            .map(Option::transpose)
            .collect::<Result<StringArray>>();
        Ok(ColumnarValue::Array(Arc::new(texts?)))
    }
}

fn literal(list: &ArrayRef) -> Result<String> {
    let values = cast(list, &DataType::Utf8)?;
    let values = values.as_string::<i32>().iter();
    let elements: Vec<String> = values
        .map(|value| value.map_or_else(|| "NULL".to_owned(), element))
        .collect();
    Ok(format!("{{{}}}", elements.join(",")))
}

/// An element, between quotes where it would be read as something else.
fn element(value: &str) -> String {
    let is_plain = |letter: char| !letter.is_whitespace() && !"{},\"\\".contains(letter);
    if !value.is_empty() && !value.eq_ignore_ascii_case("null") && value.chars().all(is_plain) {
        return value.to_owned();
    }
    let escaped = value.replace('\\', "\\\\").replace('"', "\\\"");
    format!("\"{escaped}\"")
}

/// `_pg_expandarray(list)`: its elements, `x`, with their places, `n`. Postgres makes rows of them.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct ExpandArray;

impl ExpandArray {
    /// Its name.
    pub const NAME: &str = "_pg_expandarray";

    fn fields() -> Fields {
        let number = |name: &str| Field::new(name, DataType::Int32, true);
        Fields::from(vec![number("x"), number("n")])
    }
}

impl OnTypes for ExpandArray {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn signature(&self) -> Signature {
        Signature::any(1, Volatility::Immutable)
    }

    fn result(&self) -> DataType {
        DataType::new_list(DataType::Struct(Self::fields()), true)
    }

    fn answer(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let lists = match columns.as_slice() {
            [lists] if matches!(lists.data_type(), DataType::List(_)) => lists.as_list::<i32>(),
            other => return exec_err!("expected a list, found {} values", other.len()),
        };
        let values = cast(lists.values(), &DataType::Int32)?;
        let mut places = vec![0; values.len()];
        for bounds in lists.offsets().windows(2) {
            let places = &mut places[bounds[0] as usize..bounds[1] as usize];
            places.iter_mut().zip(1..).for_each(|(place, n)| *place = n);
        }
        let places: ArrayRef = Arc::new(Int32Array::from(places));
        let elements = StructArray::try_new(Self::fields(), vec![values, places], None)?;
        let DataType::List(element) = self.result() else {
            return exec_err!("expected a list");
        };
        let (offsets, nulls) = (lists.offsets().clone(), lists.nulls().cloned());
        let expanded = ListArray::try_new(element, offsets, Arc::new(elements), nulls)?;
        Ok(ColumnarValue::Array(Arc::new(expanded)))
    }
}

/// `st_asbinary(geometry)`: well-known binary, as maps hold it, and no geometry any more.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct AsBinary;

impl OnTypes for AsBinary {
    fn name(&self) -> &'static str {
        "st_asbinary"
    }

    fn signature(&self) -> Signature {
        Signature::variadic_any(Volatility::Immutable)
    }

    fn result(&self) -> DataType {
        DataType::Binary
    }

    /// The order of bytes that may be asked for, `NDR`, is the one that there is.
    fn answer(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let mut columns = ColumnarValue::values_to_arrays(&args.args)?;
        if columns.is_empty() {
            return exec_err!("expected a geometry, found nothing");
        }
        let geometries = cast(&columns.swap_remove(0), &DataType::Binary)?;
        Ok(ColumnarValue::Array(geometries))
    }
}

/// A function that says the same of everything: which version there is, or what all geometries are.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct Constant {
    /// The function's name.
    pub name: &'static str,
    /// What it says.
    pub value: ScalarValue,
}

impl OnTypes for Constant {
    fn name(&self) -> &'static str {
        self.name
    }

    fn signature(&self) -> Signature {
        let calls = vec![TypeSignature::Nullary, TypeSignature::VariadicAny];
        Signature::one_of(calls, Volatility::Immutable)
    }

    fn result(&self) -> DataType {
        self.value.data_type()
    }

    fn answer(&self, _: ScalarFunctionArgs) -> Result<ColumnarValue> {
        Ok(ColumnarValue::Scalar(self.value.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_written_as_arrays() {
        let texts = StringArray::from(vec![
            Some("car"),
            None,
            Some("a \"b\" \\"),
            Some("Null"),
            Some(""),
        ]);
        let numbers: ArrayRef = Arc::new(Int32Array::from(vec![Some(1), None, Some(-3)]));
        for (list, expected) in [
            (
                Arc::new(texts) as ArrayRef,
                r#"{car,NULL,"a \"b\" \\","Null",""}"#,
            ),
            (Arc::clone(&numbers), "{1,NULL,-3}"),
            (numbers.slice(0, 0), "{}"),
        ] {
            assert_eq!(literal(&list).ok().as_deref(), Some(expected));
        }
    }
}
