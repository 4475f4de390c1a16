//! JSON payloads, by their JSON Schema where there is one.
//!
//! All columns are nullable: null stands for a property that is null or absent. A value
//! of another type than promised loses the row, except where nothing is lost: flags are
//! numbers 0 and 1, whole numbers written as `1.0` are integers, and numbers may be the
//! strings `NaN`, `Infinity` and `-Infinity`.

mod locate;
mod plan;

use crate::DecodeError;
use crate::buffers::{Node, Pool};
use crate::decoder::Format;
use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
pub(crate) use locate::locate;
pub(crate) use plan::Plan;
use plan::Shape;
use serde_json::{Map, Value};
use std::sync::Arc;

/// Standard base64; padding may be missing.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// Reads payloads of one JSON channel.
pub(crate) struct Reader(pub(crate) Arc<Plan>);

impl Format for Reader {
    fn append(
        &mut self,
        payload: &[u8],
        message: &Node,
        _row: usize,
        pool: &mut Pool,
    ) -> Result<(), DecodeError> {
        let value: Value = serde_json::from_slice(payload).map_err(|error| malformed(&error))?;
        let Some(properties) = &self.0.properties else {
            let node = message.member(0);
            node.append_present(pool);
            let text = String::from_utf8_lossy(payload);
            return node.append_bytes(pool, text.trim().as_bytes());
        };
        let Value::Object(object) = &value else {
            return Err(mismatch("(the payload)", "an object", &value));
        };
        members(properties, object, message, pool)
    }
}

/// Checks `value`, and appends it.
fn append(
    name: &str,
    shape: &Shape,
    value: Option<&Value>,
    node: &Node,
    pool: &mut Pool,
) -> Result<(), DecodeError> {
    let Some(value) = value.filter(|value| !value.is_null()) else {
        node.append_absent(pool);
        return Ok(());
    };
    node.append_present(pool);
    match (shape, value) {
        (Shape::Boolean, Value::Bool(flag)) => node.append_value(pool, u8::from(*flag)),
        (Shape::Integer, _) => match integer(value) {
            Some(number) => node.append_value(pool, number),
            None => return Err(mismatch(name, "a whole number of 64 bits", value)),
        },
        (Shape::Number, _) => match number(value) {
            Some(number) => node.append_value(pool, number),
            None => return Err(mismatch(name, "a number", value)),
        },
        (Shape::Text, Value::String(text)) => return node.append_bytes(pool, text.as_bytes()),
        (Shape::Base64, Value::String(text)) => match BASE64.decode(text) {
            Ok(bytes) => return node.append_bytes(pool, &bytes),
            Err(_) => return Err(mismatch(name, "base64", value)),
        },
        (Shape::Json, _) => return node.append_bytes(pool, value.to_string().as_bytes()),
        (Shape::List(item), Value::Array(values)) => {
            for value in values {
                append(name, item, Some(value), node.element(), pool)?;
            }
            return node.end_list(pool, values.len());
        }
        (Shape::Object(properties), Value::Object(object)) => {
            return members(properties, object, node, pool);
        }
        (Shape::Boolean, _) => return Err(mismatch(name, "true or false", value)),
        (Shape::Text | Shape::Base64, _) => return Err(mismatch(name, "a string", value)),
        (Shape::List(_), _) => return Err(mismatch(name, "an array", value)),
        (Shape::Object(_), _) => return Err(mismatch(name, "an object", value)),
    }
    Ok(())
}

/// Appends each property to its column.
fn members(
    properties: &[(String, Shape)],
    object: &Map<String, Value>,
    node: &Node,
    pool: &mut Pool,
) -> Result<(), DecodeError> {
    for (index, (name, shape)) in properties.iter().enumerate() {
        append(name, shape, object.get(name), node.member(index), pool)?;
    }
    Ok(())
}

fn integer(value: &Value) -> Option<i64> {
    match value {
        Value::Bool(flag) => Some(i64::from(*flag)),
        Value::Number(number) => number.as_i64().or_else(|| {
            // Beyond 2^53 a float no longer says which whole number was meant.
            let float = number.as_f64()?;
            let exact = float.fract() == 0.0 && float.abs() <= 9_007_199_254_740_992.0;
            (exact && number.is_f64()).then_some(float as i64)
        }),
        _ => None,
    }
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Bool(flag) => Some(f64::from(u8::from(*flag))),
        Value::Number(number) => number.as_f64(),
        Value::String(text) => match text.as_str() {
            "NaN" => Some(f64::NAN),
            "Infinity" => Some(f64::INFINITY),
            "-Infinity" => Some(f64::NEG_INFINITY),
            _ => None,
        },
        _ => None,
    }
}

fn malformed(error: &serde_json::Error) -> DecodeError {
    DecodeError::Malformed {
        format: "json",
        offset: error.column(),
        expected: format!("valid JSON, found: {error}"),
    }
}

fn mismatch(field: &str, expected: &str, value: &Value) -> DecodeError {
    DecodeError::Mismatch {
        field: field.to_owned(),
        expected: expected.to_owned(),
        found: value.to_string().chars().take(60).collect(),
    }
}
