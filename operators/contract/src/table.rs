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
    let normal = json_rows(&table(&found.schema(), expected)?)?;
    let found = json_rows(found)?;
    let differs = |row: usize, found: &JsonRow| {
        let (listed, normal) = (expected.get(row)?, normal.get(row)?);
        differ_struct(listed, normal, found, tolerance)
    };
    let first = match found.len() == expected.len() {
        true => found
            .iter()
            .enumerate()
            .find_map(|(row, found)| Some(format!("row {row}: {}", differs(row, found)?))),
        false => Some(format!(
            "expected {} row{}, found {}",
            expected.len(),
            if expected.len() == 1 { "" } else { "s" },
            found.len()
        )),
    };
    let is_same = |row: usize, other: usize| differs(row, &found[other]).is_none();
    Ok(first.map(|first| format!("{first}{}", diff(expected, &found, is_same))))
}

/// The rows that are not among those found, in any order; `None` where all are. As [`difference`] otherwise.
///
/// # Errors
/// As [`difference`].
pub fn lacking(
    found: &RecordBatch,
    expected: &[JsonRow],
    tolerance: f64,
) -> Result<Option<String>, Fault> {
    let normal = json_rows(&table(&found.schema(), expected)?)?;
    let found = json_rows(found)?;
    let is_there = |listed, normal| {
        let mut found = found.iter();
        found.any(|found| differ_struct(listed, normal, found, tolerance).is_none())
    };
    let rows = expected.iter().zip(&normal);
    let lacking: Vec<&JsonRow> = rows
        .filter(|(listed, normal)| !is_there(listed, normal))
        .map(|(listed, _)| listed)
        .collect();
    let Some(first) = lacking.first() else {
        return Ok(None);
    };
    Ok(Some(format!(
        "expected {}, found no such row among {}",
        json!(first),
        found.len()
    )))
}

/// More rows than this are not compared line by line.
const MOST_COMPARED: usize = 1000;
/// Lines of a diff that are shown.
const MOST_SHOWN: usize = 20;

/// Rows that only one side has: `-` what was expected, `+` what was found, on the columns that are listed.
fn diff(expected: &[JsonRow], found: &[JsonRow], is_same: impl Fn(usize, usize) -> bool) -> String {
    let (m, n) = (expected.len(), found.len());
    if m.max(n) > MOST_COMPARED {
        return String::new();
    }
    // The longest common subsequence of what is left from here on.
    let mut common = vec![vec![0_usize; n + 1]; m + 1];
    for row in (0..m).rev() {
        for other in (0..n).rev() {
            common[row][other] = match is_same(row, other) {
                true => common[row + 1][other + 1] + 1,
                false => common[row + 1][other].max(common[row][other + 1]),
            };
        }
    }
    let is_listed =
        |name: &String| expected.is_empty() || expected.iter().any(|row| row.contains_key(name));
    let shown = |row: &JsonRow| -> Value {
        let listed = row.iter().filter(|(name, _)| is_listed(name));
        Value::Object(
            listed
                .map(|(name, value)| (name.clone(), value.clone()))
                .collect(),
        )
    };
    let (mut lines, mut row, mut other) = (Vec::new(), 0, 0);
    while row < m || other < n {
        if row < m && other < n && is_same(row, other) {
            (row, other) = (row + 1, other + 1);
        } else if other == n || (row < m && common[row + 1][other] >= common[row][other + 1]) {
            lines.push(format!("\n  - {}", json!(expected[row])));
            row += 1;
        } else {
            lines.push(format!("\n  + {}", shown(&found[other])));
            other += 1;
        }
    }
    if lines.len() > MOST_SHOWN {
        let more = lines.len() - MOST_SHOWN;
        lines.truncate(MOST_SHOWN);
        lines.push(format!("\n  … {more} more"));
    }
    lines.concat()
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn rows(rows: Value) -> Vec<JsonRow> {
        serde_json::from_value(rows).unwrap()
    }

    fn found() -> RecordBatch {
        let columns = ["lane", "length_m"].map(|name| Field::new(name, DataType::Float64, true));
        let schema = Arc::new(Schema::new(columns.to_vec()));
        let found = json!([
            { "lane": 0, "length_m": 10.0 },
            { "lane": 1, "length_m": 20.0 },
            { "lane": 2, "length_m": 30.0 },
        ]);
        table(&schema, &rows(found)).unwrap()
    }

    fn differs(expected: Value) -> Option<String> {
        difference(&found(), &rows(expected), 1e-9).unwrap()
    }

    #[test]
    fn a_difference_is_shown_line_by_line() {
        assert_eq!(
            differs(json!([{ "lane": 0 }, { "lane": 1 }, { "lane": 2 }])),
            None
        );
        assert_eq!(
            differs(json!([{ "lane": 0 }, { "lane": 2 }])).unwrap(),
            "expected 2 rows, found 3\n  + {\"lane\":1.0}"
        );
        assert_eq!(
            differs(json!([{ "lane": 0 }, { "lane": 1, "length_m": 21.0 }, { "lane": 2 }]))
                .unwrap(),
            "row 1: length_m: expected 21.0, found 20.0\n  - {\"lane\":1,\"length_m\":21.0}\n  + {\"lane\":1.0,\"length_m\":20.0}"
        );
        assert_eq!(differs(json!([])).unwrap().lines().count(), 4);
        let one = differs(json!([{ "lane": 0 }])).unwrap();
        assert!(one.starts_with("expected 1 row, found 3\n"), "{one}");
    }

    #[test]
    fn some_rows_may_be_all_that_is_asked_for() {
        let lacks = |expected: Value| lacking(&found(), &rows(expected), 1e-9).unwrap();
        assert_eq!(
            lacks(json!([{ "lane": 2 }, { "lane": 0, "length_m": 10.0 }])),
            None
        );
        assert_eq!(
            lacks(json!([{ "lane": 2 }, { "lane": 1, "length_m": 1.0 }])).unwrap(),
            "expected {\"lane\":1,\"length_m\":1.0}, found no such row among 3"
        );
    }
}
