//! Tables written by hand (on a page, in a plan's test) to batches, and how a result is compared with them.

use std::sync::Arc;

use arrow::array::{RecordBatch, new_null_array};
use arrow::datatypes::{DataType, Field, Fields, Schema, SchemaRef};
use evermap_schemas::{Cell, Column, Fault, ImageRef};
use serde_json::{Map, Value, json};

use crate::Port;
use crate::port::pixels_column;

/// A row written by hand.
pub type JsonRow = Map<String, Value>;

/// The batch of rows written by hand. A column that a row leaves out is null where it may be, else its type's zero;
/// stamps are nanoseconds or RFC 3339 text, bytes are hexadecimal.
///
/// # Errors
/// A user fault for a column that the schema does not have, or a value of another type.
pub fn table(schema: &SchemaRef, rows: &[JsonRow]) -> Result<RecordBatch, Fault> {
    let filled = rows
        .iter()
        .map(|row| fill_struct(schema.fields(), row))
        .collect::<Result<Vec<_>, _>>()?;
    let decode = || -> Result<Option<RecordBatch>, arrow::error::ArrowError> {
        let mut decoder = arrow::json::ReaderBuilder::new(Arc::clone(schema)).build_decoder()?;
        decoder.serialize(&filled)?;
        decoder.flush()
    };
    let batch = decode()
        .map_err(|error| Fault::user(format!("a row does not fit its columns: {error}")))?;
    Ok(batch.unwrap_or_else(|| RecordBatch::new_empty(Arc::clone(schema))))
}

/// The rows of a batch as JSON, nulls written out.
///
/// # Errors
/// For a column that has no JSON form.
pub fn json_rows(batch: &RecordBatch) -> Result<Vec<JsonRow>, Fault> {
    let mut text = Vec::new();
    let mut writer = arrow::json::WriterBuilder::new()
        .with_explicit_nulls(true)
        .build::<_, arrow::json::writer::JsonArray>(&mut text);
    writer.write(batch)?;
    writer.finish()?;
    if batch.num_rows() == 0 {
        return Ok(Vec::new());
    }
    serde_json::from_slice(&text)
        .map_err(|error| Fault::bug(format!("Arrow wrote JSON that does not parse: {error}")))
}

/// Compares a result with the rows to expect, in order, on the columns that those rows list; floating point within
/// `tolerance`, absolute or relative, whichever allows more. `None` where they agree.
///
/// # Errors
/// When the rows to expect do not fit the result's schema.
pub fn difference(
    found: &RecordBatch,
    expected: &[JsonRow],
    tolerance: f64,
) -> Result<Option<String>, Fault> {
    if found.num_rows() != expected.len() {
        let rows = json_rows(found)?;
        return Ok(Some(format!(
            "expected {} rows, found {}: {}",
            expected.len(),
            found.num_rows(),
            json!(rows)
        )));
    }
    let normal = json_rows(&table(&found.schema(), expected)?)?;
    for (row, ((listed, normal), found)) in expected
        .iter()
        .zip(&normal)
        .zip(&json_rows(found)?)
        .enumerate()
    {
        if let Some(text) = differ_struct(listed, normal, found, tolerance) {
            return Ok(Some(format!("row {row}: {text}")));
        }
    }
    Ok(None)
}

fn differ_struct(
    listed: &JsonRow,
    expected: &JsonRow,
    found: &JsonRow,
    tolerance: f64,
) -> Option<String> {
    listed.iter().find_map(|(name, listed)| {
        let (expected, found) = (expected.get(name)?, found.get(name)?);
        let text = match (listed, expected, found) {
            (Value::Object(listed), Value::Object(expected), Value::Object(found)) => {
                differ_struct(listed, expected, found, tolerance)
            }
            _ => (!close(expected, found, tolerance))
                .then(|| format!("expected {expected}, found {found}")),
        };
        text.map(|text| format!("{name}: {text}"))
    })
}

fn close(expected: &Value, found: &Value, tolerance: f64) -> bool {
    match (expected, found) {
        (Value::Number(a), Value::Number(b)) => match (a.as_f64(), b.as_f64()) {
            (Some(a), Some(b)) => (a - b).abs() <= tolerance * a.abs().max(b.abs()).max(1.0),
            _ => a == b,
        },
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| close(a, b, tolerance))
        }
        (Value::Object(a), Value::Object(b)) => a.iter().all(|(name, value)| {
            b.get(name)
                .is_some_and(|other| close(value, other, tolerance))
        }),
        _ => expected == found,
    }
}

fn fill_struct(fields: &Fields, row: &JsonRow) -> Result<Value, Fault> {
    if let Some(unknown) = row.keys().find(|name| fields.find(name).is_none()) {
        let known: Vec<_> = fields.iter().map(|field| field.name().as_str()).collect();
        return Err(Fault::user(format!(
            "no column {unknown}; there are {}",
            known.join(", ")
        )));
    }
    let filled = fields
        .iter()
        .map(|field| Ok((field.name().clone(), fill(field, row.get(field.name()))?)))
        .collect::<Result<Map<_, _>, Fault>>()?;
    Ok(Value::Object(filled))
}

fn fill(field: &Field, value: Option<&Value>) -> Result<Value, Fault> {
    match (field.data_type(), value) {
        (DataType::Struct(fields), Some(Value::Object(row))) => fill_struct(fields, row),
        (DataType::List(item), Some(Value::Array(items))) => items
            .iter()
            .map(|value| fill(item, Some(value)))
            .collect::<Result<Vec<_>, _>>()
            .map(Value::Array),
        (_, Some(value)) => Ok(value.clone()),
        (_, None) if field.is_nullable() => Ok(Value::Null),
        (data_type, None) => zero(data_type),
    }
}

fn zero(data_type: &DataType) -> Result<Value, Fault> {
    Ok(match data_type {
        DataType::Struct(fields) => identity_rotation(fill_struct(fields, &JsonRow::new())?),
        DataType::List(_) => json!([]),
        DataType::FixedSizeList(item, length) => {
            Value::Array(vec![zero(item.data_type())?; *length as usize])
        }
        DataType::Utf8 | DataType::Binary => json!(""),
        DataType::Boolean => json!(false),
        _ => json!(0),
    })
}

/// The zero of a rotation is the identity, not a quaternion of no length.
fn identity_rotation(mut value: Value) -> Value {
    if let Some(fields) = value.as_object_mut()
        && fields.contains_key("qw")
    {
        fields.insert("qw".to_owned(), json!(1.0));
    }
    value
}

/// The schema of a port's table as a person writes it: images are bytes in the place of their references.
pub fn port_schema(port: &Port) -> SchemaRef {
    let field = |column: &Column| match port.pixels == Some(column.name) {
        true => Field::new(column.name, DataType::Binary, true),
        false => column.field(),
    };
    let fields: Vec<Field> = port.layer.columns.iter().map(field).collect();
    Arc::new(Schema::new(fields))
}

/// A port's table with its images beside their references. Images that stand in the place of references get empty ones.
pub(crate) fn with_pixels(rows: &RecordBatch, pixels: Option<&str>) -> Result<RecordBatch, Fault> {
    let place = |column| Some((column, rows.schema_ref().index_of(column).ok()?));
    let Some((column, index)) = pixels.and_then(place) else {
        return Ok(rows.clone());
    };
    let name = pixels_column(column);
    if rows.column_by_name(&name).is_some() {
        return Ok(rows.clone());
    }
    let mut fields = rows.schema_ref().fields().to_vec();
    let mut columns = rows.columns().to_vec();
    let mut images = new_null_array(&DataType::Binary, rows.num_rows());
    if *fields[index].data_type() == DataType::Binary {
        fields[index] = Arc::new(Field::new(column, ImageRef::data_type(), false));
        let bare: SchemaRef = Arc::new(Schema::new(vec![Arc::clone(&fields[index])]));
        let references = table(&bare, &vec![JsonRow::new(); rows.num_rows()])?;
        images = std::mem::replace(&mut columns[index], Arc::clone(references.column(0)));
    }
    fields.push(Arc::new(Field::new(name, DataType::Binary, true)));
    columns.push(images);
    let schema = Arc::new(Schema::new(fields));
    Ok(RecordBatch::try_new(schema, columns)?)
}
