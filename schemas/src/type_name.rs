//! What types are called.

use arrow::datatypes::DataType;

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
