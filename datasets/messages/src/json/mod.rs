//! JSON payloads, by their JSON Schema where there is one.
//!
//! All columns are nullable: null stands for a property that is null or absent. A value
//! of another type than promised loses the row, except where nothing is lost: flags are
//! numbers 0 and 1, whole numbers written as `1.0` are integers, and numbers may be the
//! strings `NaN`, `Infinity` and `-Infinity`.

mod locate;
mod plan;

use crate::DecodeError;
use crate::buffers::{Layout, Node, OFFSET_LIMIT, Pool, offset};
use crate::columns::{Columns, Format};
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
        columns: &Columns,
        _row: usize,
        pool: &mut Pool,
    ) -> Result<(), DecodeError> {
        let value: Value = serde_json::from_slice(payload).map_err(|error| malformed(&error))?;
        let Some(properties) = &self.0.properties else {
            if let Some(node) = columns.get(0) {
                let text = String::from_utf8_lossy(payload);
                node.append_present(pool);
                text_into(Some(node), text.trim(), pool)?;
            }
            return Ok(());
        };
        let Value::Object(object) = &value else {
            return Err(mismatch("(the payload)", "an object", &value));
        };
        members(properties, object, |index| columns.get(index), pool)
    }
}

/// Checks `value`, and appends it where there is a column for it.
fn append(
    name: &str,
    shape: &Shape,
    value: Option<&Value>,
    node: Option<&Node>,
    pool: &mut Pool,
) -> Result<(), DecodeError> {
    let Some(value) = value.filter(|value| !value.is_null()) else {
        if let Some(node) = node {
            node.append_absent(pool);
        }
        return Ok(());
    };
    if let Some(node) = node {
        node.append_present(pool);
    }
    match (shape, value) {
        (Shape::Boolean, Value::Bool(flag)) => flag_value(node, *flag, pool),
        (Shape::Integer, _) => match integer(value) {
            Some(number) => fixed(node, number, pool),
            None => return Err(mismatch(name, "a whole number of 64 bits", value)),
        },
        (Shape::Number, _) => match number(value) {
            Some(number) => fixed(node, number.to_bits() as i64, pool),
            None => return Err(mismatch(name, "a number", value)),
        },
        (Shape::Text, Value::String(text)) => return text_into(node, text, pool),
        (Shape::Base64, Value::String(text)) => match BASE64.decode(text) {
            Ok(bytes) => return bytes_into(node, &bytes, pool),
            Err(_) => return Err(mismatch(name, "base64", value)),
        },
        (Shape::Json, _) => return text_into(node, &value.to_string(), pool),
        (Shape::List(item), Value::Array(values)) => return list(name, item, values, node, pool),
        (Shape::Object(properties), Value::Object(object)) => {
            return object_into(properties, object, node, pool);
        }
        (Shape::Boolean, _) => return Err(mismatch(name, "true or false", value)),
        (Shape::Text | Shape::Base64, _) => return Err(mismatch(name, "a string", value)),
        (Shape::List(_), _) => return Err(mismatch(name, "an array", value)),
        (Shape::Object(_), _) => return Err(mismatch(name, "an object", value)),
    }
    Ok(())
}

fn list(
    name: &str,
    item: &Shape,
    values: &[Value],
    node: Option<&Node>,
    pool: &mut Pool,
) -> Result<(), DecodeError> {
    let target = match node.map(|node| &node.layout) {
        Some(Layout::List { offsets, child }) => Some((*offsets, child.as_ref())),
        _ => None,
    };
    for value in values {
        append(
            name,
            item,
            Some(value),
            target.map(|(_, child)| child),
            pool,
        )?;
    }
    if let Some((offsets, _)) = target {
        let end = offset(pool.last_offset(offsets) + values.len())?;
        pool.0[offsets].push(end);
    }
    Ok(())
}

fn object_into(
    properties: &[(String, Shape)],
    object: &Map<String, Value>,
    node: Option<&Node>,
    pool: &mut Pool,
) -> Result<(), DecodeError> {
    let children: &[Node] = match node.map(|node| &node.layout) {
        Some(Layout::Struct { children }) => children,
        _ => &[],
    };
    members(properties, object, |index| children.get(index), pool)
}

/// Appends each property to its column, where it has one.
fn members<'a>(
    properties: &[(String, Shape)],
    object: &Map<String, Value>,
    column: impl Fn(usize) -> Option<&'a Node>,
    pool: &mut Pool,
) -> Result<(), DecodeError> {
    for (index, (name, shape)) in properties.iter().enumerate() {
        append(name, shape, object.get(name), column(index), pool)?;
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

fn flag_value(node: Option<&Node>, flag: bool, pool: &mut Pool) {
    if let Some(Layout::Bool { data }) = node.map(|node| &node.layout) {
        pool.0[*data].push(u8::from(flag));
    }
}

fn fixed(node: Option<&Node>, bits: i64, pool: &mut Pool) {
    if let Some(Layout::Fixed { data, .. }) = node.map(|node| &node.layout) {
        pool.0[*data].push(bits);
    }
}

fn text_into(node: Option<&Node>, text: &str, pool: &mut Pool) -> Result<(), DecodeError> {
    bytes_into(node, text.as_bytes(), pool)
}

fn bytes_into(node: Option<&Node>, bytes: &[u8], pool: &mut Pool) -> Result<(), DecodeError> {
    match node.map(|node| &node.layout) {
        Some(Layout::Bytes { offsets, data }) => pool.append_bytes(*offsets, *data, bytes),
        Some(_) => Err(DecodeError::Full {
            limit: OFFSET_LIMIT,
        }),
        None => Ok(()),
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
