//! What types are called.

use std::sync::Arc;

use arrow::datatypes::{DataType, Field};

use crate::{Cell, Stamp};

/// A type for people: `text`, `time`, `struct of x, y`.
pub fn type_name(data_type: &DataType) -> String {
    match data_type {
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View => "text".to_owned(),
        DataType::Binary | DataType::LargeBinary | DataType::BinaryView => "bytes".to_owned(),
        DataType::Boolean => "bool".to_owned(),
        DataType::Float64 => "f64".to_owned(),
        DataType::Float32 => "f32".to_owned(),
        DataType::Timestamp(..) => "time".to_owned(),
        DataType::Struct(fields) => {
            let names: Vec<_> = fields.iter().map(|field| field.name().as_str()).collect();
            format!("struct of {}", names.join(", "))
        }
        DataType::List(item) | DataType::LargeList(item) => {
            format!("list of {}", type_name(item.data_type()))
        }
        DataType::FixedSizeList(item, length) => {
            format!("{length} {}", type_name(item.data_type()))
        }
        DataType::Map(..) => "map".to_owned(),
        DataType::Dictionary(_, values) => type_name(values),
        number if number.is_integer() => {
            let (sign, bits) = if number.is_signed_integer() {
                ('i', "Int")
            } else {
                ('u', "UInt")
            };
            format!("{sign}{}", number.to_string().trim_start_matches(bits))
        }
        other => other.to_string(),
    }
}

/// No type has a longer name (bytes): lists of lists end.
const LONGEST: usize = 64;

/// The type that a person calls so; `None` for a name of none, and for structs, whose members say their types.
pub fn type_named(name: &str) -> Option<DataType> {
    let plain = [
        DataType::Utf8,
        DataType::Binary,
        DataType::Boolean,
        DataType::Float64,
        DataType::Float32,
        Stamp::data_type(),
        DataType::Int8,
        DataType::Int16,
        DataType::Int32,
        DataType::Int64,
        DataType::UInt8,
        DataType::UInt16,
        DataType::UInt32,
        DataType::UInt64,
    ];
    if name.len() > LONGEST {
        return None;
    }
    let item = |named: &str| Some(Arc::new(Field::new_list_field(type_named(named)?, true)));
    if let Some(named) = name.strip_prefix("list of ") {
        return Some(DataType::List(item(named)?));
    }
    if let Some((length, named)) = name.split_once(' ') {
        let length = length.parse().ok().filter(|length| *length > 0)?;
        return Some(DataType::FixedSizeList(item(named)?, length));
    }
    plain.into_iter().find(|plain| type_name(plain) == name)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_type_is_found_by_its_name() {
        for name in [
            "text",
            "bytes",
            "bool",
            "f64",
            "time",
            "u8",
            "list of f32",
            "3 list of i64",
        ] {
            assert_eq!(type_name(&type_named(name).unwrap()), name);
        }
        for name in [
            "",
            "double",
            "list of",
            "list of x",
            "0 f64",
            "-1 f64",
            "f64 3",
        ] {
            assert_eq!(type_named(name), None, "{name}");
        }
    }
}
