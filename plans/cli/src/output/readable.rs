//! Cells as people and spreadsheets read them.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema};
use arrow::error::ArrowError;
use arrow::util::display::{ArrayFormatter, FormatOptions};
use evermap_functions::json_texts;

use crate::printable::printable;

/// Characters of a cell that are shown.
const WIDEST: usize = 60;

/// Every column as text: bytes counted, long cells cut, nulls empty.
pub fn cells(batch: &RecordBatch) -> Result<RecordBatch, ArrowError> {
    mapped(batch, |_| true, short_texts)
}

/// Lists and structs as JSON text; the rest as it is.
pub fn flat(batch: &RecordBatch) -> Result<RecordBatch, ArrowError> {
    mapped(batch, DataType::is_nested, json_texts)
}

fn mapped(
    batch: &RecordBatch,
    which: impl Fn(&DataType) -> bool,
    texts: impl Fn(&ArrayRef) -> Result<StringArray, ArrowError>,
) -> Result<RecordBatch, ArrowError> {
    let (mut fields, mut columns): (Vec<Field>, Vec<ArrayRef>) = (Vec::new(), Vec::new());
    for (field, column) in batch.schema_ref().fields().iter().zip(batch.columns()) {
        if which(field.data_type()) {
            fields.push(Field::new(field.name(), DataType::Utf8, true));
            columns.push(Arc::new(texts(column)?));
        } else {
            fields.push(field.as_ref().clone());
            columns.push(Arc::clone(column));
        }
    }
    let options = arrow::array::RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
    RecordBatch::try_new_with_options(Arc::new(Schema::new(fields)), columns, &options)
}

fn short_texts(column: &ArrayRef) -> Result<StringArray, ArrowError> {
    let sizes = |bytes: Option<&[u8]>| bytes.map(|bytes| format!("{} B", bytes.len()));
    match column.data_type() {
        DataType::Binary => return Ok(column.as_binary::<i32>().iter().map(sizes).collect()),
        DataType::BinaryView => return Ok(column.as_binary_view().iter().map(sizes).collect()),
        _ => {}
    }
    let options = FormatOptions::default().with_null("");
    let formatter = ArrayFormatter::try_new(column.as_ref(), &options)?;
    (0..column.len())
        .map(|row| {
            formatter
                .value(row)
                .try_to_string()
                .map(|text| Some(short(&printable(&text))))
        })
        .collect()
}

/// One line of at most so many characters.
pub fn short(text: &str) -> String {
    let line = text
        .chars()
        .map(|letter| if letter.is_control() { ' ' } else { letter });
    if text.chars().count() <= WIDEST {
        return line.collect();
    }
    line.take(WIDEST - 1).chain(['…']).collect()
}
