//! What a client binds, read as Postgres reads it where the library does not: texts, lists of them, exact numbers, and UUIDs.

use std::fmt::Write;

use arrow::array::{ArrayRef, StringArray, StringBuilder};
use arrow::compute::{CastOptions, cast_with_options};
use arrow::datatypes::DataType;
use datafusion::common::ScalarValue;
use datafusion::common::utils::SingleRowListArrayBuilder;
use pgwire::api::Type;
use pgwire::error::{PgWireError, PgWireResult};
use uuid::Uuid;

use crate::serve::postgres::arrays::elements;
use crate::serve::postgres::error;
use crate::serve::postgres::wire::Body;

/// Letters of a text that an error tells at most.
const TOLD: usize = 40;

/// What a client bound to one parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Value {
    /// Of the type that its place in the query has.
    pub value: ScalarValue,
    /// What it is as whole numbers, where it is of the type `numeric` and has no fraction: to be compared as such, as
    /// `value` may be rounded.
    pub whole: Option<ScalarValue>,
}

impl From<ScalarValue> for Value {
    fn from(value: ScalarValue) -> Self {
        Self { value, whole: None }
    }
}

/// Bytes that were bound, and what is known of them.
#[derive(Debug, Clone, Copy)]
pub struct Bound<'b> {
    /// The bytes themselves.
    pub bytes: &'b [u8],
    /// Whether they are in the format of texts.
    pub is_text: bool,
    /// Whether the client has said the type.
    pub is_declared: bool,
    /// The type that the client said, or that it was told.
    pub kind: &'b Type,
    /// The type that the place in the query has; null where nobody knows.
    pub target: &'b DataType,
}

impl Bound<'_> {
    /// The value; `None` where the library reads it.
    ///
    /// # Errors
    /// For what is none of its type.
    pub fn read(self) -> PgWireResult<Option<Value>> {
        let is_number = matches!(*self.kind, Type::NUMERIC | Type::NUMERIC_ARRAY);
        let is_uuid = matches!(*self.kind, Type::UUID | Type::UUID_ARRAY);
        let item = match (self.kind, self.target) {
            (&Type::NUMERIC | &Type::UUID, _) => None,
            (_, DataType::List(item)) => Some(item.data_type()),
            (&Type::NUMERIC_ARRAY | &Type::UUID_ARRAY, other) => Some(other),
            _ => None,
        };
        let target = match item.unwrap_or(self.target) {
            DataType::Null if is_number => &DataType::Float64,
            DataType::Null => &DataType::Utf8,
            DataType::Dictionary(_, value) => value.as_ref(),
            other => other,
        };
        let format = Format::of(self.kind).filter(|_| !self.is_text);
        let texts = match (format, item.is_some()) {
            (Some(format), true) => format.many(self.bytes).ok_or_else(none_of_its_type)?,
            (Some(format), false) => one(&(format.read)(self.bytes).ok_or_else(none_of_its_type)?),
            (None, _) if !self.is_read_here(item.is_some(), target) => return Ok(None),
            (None, true) => elements(self.text()?)?,
            (None, false) if target.is_string() => one(self.text()?),
            (None, false) => one(self.text()?.trim()),
        };
        let expected = format!("a value of the type {}", self.kind.name());
        let texts = match is_uuid {
            true => uuids(&texts).ok_or_else(|| self.is_none(&expected))?,
            false => texts,
        };
        let made = match is_number && target.is_integer() {
            true => cast(&without_fractions(&texts), target),
            false => cast(&texts, target),
        };
        let made = made.ok_or_else(|| self.is_none(&expected))?;
        let scalar = |made: ArrayRef| match item {
            Some(_) => Some(SingleRowListArrayBuilder::new(made).build_list_scalar()),
            None => ScalarValue::try_from_array(&made, 0).ok(),
        };
        let whole = if is_number { whole(&texts) } else { None };
        Ok(Some(Value {
            value: scalar(made).ok_or_else(|| self.is_none(&expected))?,
            whole: whole.and_then(scalar),
        }))
    }

    /// Whether it is a text that is read here: of what no type is said, lists, exact numbers, UUIDs, and types that the library
    /// does not know.
    fn is_read_here(self, is_list: bool, target: &DataType) -> bool {
        let is_new = matches!(
            *self.kind,
            Type::JSON | Type::JSONB | Type::BPCHAR | Type::NAME | Type::NUMERIC | Type::UUID
        );
        let is_theirs = target.is_binary()
            || target.is_nested()
            || matches!(target, DataType::Interval(_) | DataType::Duration(_));
        // Bytes of no type are a text.
        (self.is_text || *self.kind == Type::UNKNOWN)
            && (!self.is_declared || is_list || is_new)
            && !is_theirs
    }

    fn text(&self) -> PgWireResult<&str> {
        std::str::from_utf8(self.bytes).map_err(|_| self.is_none("a text of UTF-8"))
    }

    fn is_none(&self, expected: &str) -> PgWireError {
        found_other(&String::from_utf8_lossy(self.bytes), expected)
    }
}

/// The error for a text that is not what is expected.
pub fn found_other(text: &str, expected: &str) -> PgWireError {
    error("ERROR", "22P02", &expected_other(text, expected))
}

/// What is said of a text that is not what is expected.
pub fn expected_other(text: &str, expected: &str) -> String {
    let told: String = text.chars().take(TOLD).collect();
    let more = if told.len() < text.len() { "…" } else { "" };
    format!("expected {expected}, found `{told}{more}`")
}

/// The error for bytes that are not what they should be.
pub fn none_of_its_type() -> PgWireError {
    let message = "expected parameters of their types, found bytes that are none";
    error("ERROR", "22P03", message)
}

fn one(text: &str) -> StringArray {
    StringArray::from_iter_values([text])
}

/// Texts as values of a type; `None` where one of them is none.
fn cast(texts: &StringArray, target: &DataType) -> Option<ArrayRef> {
    let options = CastOptions {
        safe: false,
        ..CastOptions::default()
    };
    cast_with_options(texts, target, &options).ok()
}

/// Numbers as whole ones; `None` where one of them has a fraction, or more digits than there is room for.
fn whole(numbers: &StringArray) -> Option<ArrayRef> {
    let digits = without_fractions(numbers);
    let fits = |target| cast(&digits, &target);
    fits(DataType::Int64).or_else(|| fits(DataType::UInt64))
}

/// Numbers without fractions that are zero.
fn without_fractions(numbers: &StringArray) -> StringArray {
    let short = |number: &str| match number.split_once('.') {
        Some((digits, fraction)) if fraction.bytes().all(|digit| digit == b'0') => {
            digits.to_owned()
        }
        _ => number.to_owned(),
    };
    numbers.iter().map(|number| number.map(short)).collect()
}

/// A `numeric` in the format of bytes as its digits: groups of four, the place of the first, a sign, and how many digits
/// there are behind the point. `None` where it is none.
fn numeric(bytes: &[u8]) -> Option<String> {
    let mut body = Body(bytes);
    let count = usize::from(u16::from_be_bytes(body.number()?));
    let first = i32::from(i16::from_be_bytes(body.number()?));
    let sign = u16::from_be_bytes(body.number()?);
    let behind = usize::from(u16::from_be_bytes(body.number()?));
    let (groups, []) = body.0.as_chunks::<2>() else {
        return None;
    };
    let groups: Vec<u16> = groups
        .iter()
        .map(|group| u16::from_be_bytes(*group))
        .collect();
    if groups.len() != count || groups.iter().any(|group| *group > 9999) {
        return None;
    }
    let mut text = String::from(match sign {
        0x0000 => "",
        0x4000 => "-",
        0xC000 => return Some("NaN".to_owned()),
        0xD000 => return Some("inf".to_owned()),
        0xF000 => return Some("-inf".to_owned()),
        _ => return None,
    });
    let group = |place: i32| {
        let place = usize::try_from(place).ok();
        place
            .and_then(|place| groups.get(place))
            .copied()
            .unwrap_or(0)
    };
    let _ = write!(text, "{}", if first < 0 { 0 } else { group(0) });
    for place in 1..=first {
        let _ = write!(text, "{:04}", group(place));
    }
    if behind > 0 {
        text.push('.');
        let end = text.len() + behind;
        for place in (first + 1..).take(behind.div_ceil(4)) {
            let _ = write!(text, "{:04}", group(place));
        }
        text.truncate(end);
    }
    Some(text)
}

/// UUIDs as Postgres writes them, with dashes; `None` where one of them is none.
fn uuids(texts: &StringArray) -> Option<StringArray> {
    let written = |text: Option<&str>| match text {
        Some(text) => Some(Some(uuid(text)?)),
        None => Some(None),
    };
    texts.iter().map(written).collect()
}

/// A UUID as Postgres writes it, with dashes; `None` where a text is none.
pub fn uuid(text: &str) -> Option<String> {
    Uuid::parse_str(text).ok().map(|uuid| uuid.to_string())
}

/// A UUID in the format of bytes as a text; `None` where it is none.
fn uuid_of_bytes(bytes: &[u8]) -> Option<String> {
    Uuid::from_slice(bytes).ok().map(|uuid| uuid.to_string())
}

/// How the bytes of a type are read that the library does not read.
#[derive(Clone, Copy)]
struct Format {
    /// The number of the type, in lists too.
    oid: u32,
    /// One value as a text; `None` where it is none.
    read: fn(&[u8]) -> Option<String>,
}

impl Format {
    fn of(kind: &Type) -> Option<Self> {
        match *kind {
            Type::NUMERIC | Type::NUMERIC_ARRAY => Some(Self {
                oid: Type::NUMERIC.oid(),
                read: numeric,
            }),
            Type::UUID | Type::UUID_ARRAY => Some(Self {
                oid: Type::UUID.oid(),
                read: uuid_of_bytes,
            }),
            _ => None,
        }
    }

    /// A list of values; `None` where it is none, or one of lists.
    fn many(self, bytes: &[u8]) -> Option<StringArray> {
        let mut body = Body(bytes);
        let dimensions = i32::from_be_bytes(body.number()?);
        let _has_null = body.number::<4>()?;
        let of = u32::from_be_bytes(body.number()?);
        let length = match dimensions {
            0 => 0,
            1 => {
                let length = i32::from_be_bytes(body.number()?);
                let _first = body.number::<4>()?;
                length
            }
            _ => return None,
        };
        let mut found = StringBuilder::new();
        for _ in 0..length {
            match i32::from_be_bytes(body.number()?) {
                -1 => found.append_null(),
                size => found.append_value((self.read)(body.skip(usize::try_from(size).ok()?)?)?),
            }
        }
        (of == self.oid && body.0.is_empty()).then(|| found.finish())
    }
}

#[cfg(test)]
mod tests;
