//! Functions on types that clients of Postgres ask, and the library has not, or knows too few types for.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use arrow::array::{Array, ArrayRef, AsArray, Int32Array, ListArray, StringArray, StructArray};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Field, FieldRef, Fields, Int32Type};
use datafusion::common::exec_err;
use datafusion::error::Result;
use datafusion::logical_expr::{
    ColumnarValue, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature, SimpleScalarUDF,
    TypeSignature, Volatility,
};
use datafusion::scalar::ScalarValue;

use crate::output::GEOMETRY;
use crate::serve::postgres::geometry::OID;
use crate::serve::postgres::values::{expected_other, uuid};

/// A function by its name, what it takes, what it gives, and how it answers one call.
pub fn function(
    name: &str,
    takes: Signature,
    gives: DataType,
    answer: impl Fn(&[ColumnarValue]) -> Result<ColumnarValue> + Send + Sync + 'static,
) -> ScalarUDF {
    ScalarUDF::from(SimpleScalarUDF::new_with_signature(
        name,
        takes,
        gives,
        Arc::new(answer),
    ))
}

/// What the server says of itself, for clients that ask how they may speak to it: that of Postgres of the version whose
/// clients are understood.
pub const SETTINGS: [(&str, &str); 15] = [
    ("DateStyle", "ISO, MDY"),
    ("TimeZone", "UTC"),
    ("client_encoding", "UTF8"),
    ("default_transaction_isolation", "read committed"),
    ("default_transaction_read_only", "on"),
    ("integer_datetimes", "on"),
    ("is_superuser", "off"),
    ("jit", "off"),
    ("lc_collate", "C"),
    ("max_index_keys", "32"),
    ("search_path", "public"),
    ("server_encoding", "UTF8"),
    ("server_version", "16.6"),
    ("server_version_num", "160006"),
    ("standard_conforming_strings", "on"),
];

/// `current_setting(name [, missing_ok])`: one of [`SETTINGS`]; null where there is none.
pub fn current_setting() -> ScalarUDF {
    let calls = [
        vec![DataType::Utf8],
        vec![DataType::Utf8, DataType::Boolean],
    ];
    let calls = calls.map(TypeSignature::Exact);
    let takes = Signature::one_of(calls.into(), Volatility::Immutable);
    function("current_setting", takes, DataType::Utf8, |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let Some(names) = columns.first() else {
            return exec_err!("expected the name of a setting, found nothing");
        };
        let value = |name: Option<&str>| {
            let name = name?;
            let mut settings = SETTINGS.iter();
            let found = settings.find(|(known, _)| known.eq_ignore_ascii_case(name));
            found.map(|(_, value)| *value)
        };
        let values: StringArray = names.as_string::<i32>().iter().map(value).collect();
        Ok(ColumnarValue::Array(Arc::new(values)))
    })
}

/// The setting that says where tables are looked for.
pub const PATH: &str = "search_path";

/// What is told of one that leads elsewhere.
pub const NO_PATH: &str = "search_path is not followed: name tables whole, such as v1.lanes";

/// Whether tables are to be looked for elsewhere than among the layers of the newest version, which would answer of other rows
/// than are asked for.
pub fn leads_elsewhere(path: &str) -> bool {
    const USUAL: [&str; 5] = ["public", "pg_catalog", "$user", "topology", ""];
    let mut schemas = path
        .split(',')
        .map(|name| name.trim().trim_matches(['\'', '"']));
    schemas.any(|name| !USUAL.contains(&name))
}

/// `set_config(name, value, is_local)`: the value, which changes nothing here; an error for a search path that leads
/// elsewhere.
pub fn set_config() -> ScalarUDF {
    let takes = vec![DataType::Utf8, DataType::Utf8, DataType::Boolean];
    let takes = Signature::exact(takes, Volatility::Immutable);
    function("set_config", takes, DataType::Utf8, |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let [names, values, _] = columns.as_slice() else {
            return exec_err!("expected three arguments, found {}", columns.len());
        };
        let mut settings = names
            .as_string::<i32>()
            .iter()
            .zip(values.as_string::<i32>());
        let is_followed = |(name, value): (Option<&str>, Option<&str>)| {
            let is_path = name.is_some_and(|name| name.eq_ignore_ascii_case(PATH));
            !(is_path && value.is_some_and(leads_elsewhere))
        };
        match settings.all(is_followed) {
            true => Ok(ColumnarValue::Array(Arc::clone(values))),
            false => exec_err!("{NO_PATH}"),
        }
    })
}

/// `to_regtype(name)`: the number of a type, of these by name; null where there is none of that name.
pub fn to_regtype(numbers: BTreeMap<String, i32>) -> ScalarUDF {
    let takes = Signature::exact(vec![DataType::Utf8], Volatility::Immutable);
    function("to_regtype", takes, DataType::Int32, move |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let [names] = columns.as_slice() else {
            return exec_err!("expected one argument, found {}", columns.len());
        };
        let number = |name: Option<&str>| numbers.get(name?).copied();
        let numbers: Int32Array = names.as_string::<i32>().iter().map(number).collect();
        Ok(ColumnarValue::Array(Arc::new(numbers)))
    })
}

/// `format_type(number, modifier)` of the library, with one type more.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct FormatType {
    /// The library's.
    pub inner: Arc<ScalarUDF>,
}

impl ScalarUDFImpl for FormatType {
    fn name(&self) -> &str {
        "format_type"
    }

    fn signature(&self) -> &Signature {
        self.inner.signature()
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(DataType::Utf8)
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
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

/// The only argument, which is a list.
fn list(columns: &[ArrayRef]) -> Result<&ListArray> {
    match columns {
        [lists] if matches!(lists.data_type(), DataType::List(_)) => Ok(lists.as_list::<i32>()),
        other => exec_err!("expected a list, found {} values", other.len()),
    }
}

/// `array_out(list)`: its elements as Postgres writes an array. One for all plans, in which functions are told apart by
/// where they are.
pub static ARRAY_OUT: LazyLock<ScalarUDF> = LazyLock::new(|| {
    let takes = Signature::any(1, Volatility::Immutable);
    function("array_out", takes, DataType::Utf8, |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let texts = list(&columns)?.iter();
        let texts = texts.map(|list| list.map(|list| literal(&list)).transpose());
        let texts = texts.collect::<Result<StringArray>>()?;
        Ok(ColumnarValue::Array(Arc::new(texts)))
    })
});

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

/// The name of [`uuid_in`].
pub const UUID_IN: &str = "uuid_in";

/// `uuid_in(text)`: a UUID as Postgres writes it, with dashes; an error for a text that is none.
pub fn uuid_in() -> ScalarUDF {
    let takes = Signature::exact(vec![DataType::Utf8], Volatility::Immutable);
    function(UUID_IN, takes, DataType::Utf8, |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let [texts] = columns.as_slice() else {
            return exec_err!("expected one argument, found {}", columns.len());
        };
        Ok(ColumnarValue::Array(Arc::new(uuids(texts)?)))
    })
}

/// The name of [`uuids_in`].
pub const UUIDS_IN: &str = "uuids_in";

/// `uuids_in(list)`: the same of the elements of a list.
pub fn uuids_in() -> ScalarUDF {
    let element: FieldRef = Arc::new(Field::new_list_field(DataType::Utf8, true));
    let gives = DataType::List(Arc::clone(&element));
    let takes = Signature::any(1, Volatility::Immutable);
    function(UUIDS_IN, takes, gives, move |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let lists = list(&columns)?;
        let values = uuids(&cast(lists.values(), &DataType::Utf8)?)?;
        let (offsets, nulls) = (lists.offsets().clone(), lists.nulls().cloned());
        let lists = ListArray::try_new(Arc::clone(&element), offsets, Arc::new(values), nulls)?;
        Ok(ColumnarValue::Array(Arc::new(lists)))
    })
}

fn uuids(texts: &ArrayRef) -> Result<StringArray> {
    let written = |text: Option<&str>| match text {
        Some(text) => match uuid(text) {
            Some(uuid) => Ok(Some(uuid)),
            None => exec_err!("{}", expected_other(text, "a value of the type uuid")),
        },
        None => Ok(None),
    };
    texts.as_string::<i32>().iter().map(written).collect()
}

/// The name of [`expand_array`].
pub const EXPAND_ARRAY: &str = "_pg_expandarray";

/// `_pg_expandarray(list)`: its elements, `x`, with their places, `n`. Postgres makes rows of them.
pub fn expand_array() -> ScalarUDF {
    let number = |name: &str| Field::new(name, DataType::Int32, true);
    let fields = Fields::from(vec![number("x"), number("n")]);
    let element: FieldRef = Arc::new(Field::new_list_field(
        DataType::Struct(fields.clone()),
        true,
    ));
    let gives = DataType::List(Arc::clone(&element));
    let takes = Signature::any(1, Volatility::Immutable);
    function(EXPAND_ARRAY, takes, gives, move |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let lists = list(&columns)?;
        let values = cast(lists.values(), &DataType::Int32)?;
        let mut places = vec![0; values.len()];
        for bounds in lists.offsets().windows(2) {
            let places = &mut places[bounds[0] as usize..bounds[1] as usize];
            places.iter_mut().zip(1..).for_each(|(place, n)| *place = n);
        }
        let places: ArrayRef = Arc::new(Int32Array::from(places));
        let elements = StructArray::try_new(fields.clone(), vec![values, places], None)?;
        let (offsets, nulls) = (lists.offsets().clone(), lists.nulls().cloned());
        let element = Arc::clone(&element);
        let expanded = ListArray::try_new(element, offsets, Arc::new(elements), nulls)?;
        Ok(ColumnarValue::Array(Arc::new(expanded)))
    })
}

/// `st_asbinary(geometry)`: well-known binary, as maps hold it, and no geometry any more. The order of bytes that may be
/// asked for, `NDR`, is the one that there is.
pub fn as_binary() -> ScalarUDF {
    let takes = Signature::variadic_any(Volatility::Immutable);
    function("st_asbinary", takes, DataType::Binary, |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let Some(geometries) = columns.first() else {
            return exec_err!("expected a geometry, found nothing");
        };
        Ok(ColumnarValue::Array(cast(geometries, &DataType::Binary)?))
    })
}

/// A function that says the same of everything: which version there is, or what all geometries are.
pub fn constant(name: &str, value: ScalarValue) -> ScalarUDF {
    let calls = vec![TypeSignature::Nullary, TypeSignature::VariadicAny];
    let takes = Signature::one_of(calls, Volatility::Immutable);
    function(name, takes, value.data_type(), move |_| {
        Ok(ColumnarValue::Scalar(value.clone()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_path_that_leads_elsewhere_is_told_from_those_that_drivers_set() {
        for path in ["", "public", "\"$user\", public", "'public'", "pg_catalog"] {
            assert!(!leads_elsewhere(path), "{path}");
        }
        for path in ["v1", "public, v1", "\"v1\"", "'monday'"] {
            assert!(leads_elsewhere(path), "{path}");
        }
    }

    #[test]
    fn uuids_are_written_with_dashes_and_what_is_none_is_told() {
        let texts: ArrayRef = Arc::new(StringArray::from(vec![
            Some("0193F0A17E2B7C3D8E4F5A6B7C8D9E0F"),
            None,
        ]));
        let expected = StringArray::from(vec![Some("0193f0a1-7e2b-7c3d-8e4f-5a6b7c8d9e0f"), None]);
        assert_eq!(uuids(&texts).ok(), Some(expected));
        let none: ArrayRef = Arc::new(StringArray::from(vec!["7"]));
        let told = uuids(&none).err().map(|error| error.to_string());
        let said = "expected a value of the type uuid, found `7`";
        assert!(told.is_some_and(|told| told.contains(said)));
    }

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
