//! Cells as people and spreadsheets read them.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema};
use arrow::error::ArrowError;
use arrow::util::display::{ArrayFormatter, FormatOptions};
use evermap_functions::json_texts;

use crate::printable::printable;

/// Characters of a cell that are shown where it is cut.
const WIDEST: usize = 60;

/// How the cells of a table are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cells {
    /// In one line, cut where it is long.
    Short,
    /// In one line.
    Long,
    /// With the lines that they have.
    Lines,
}

/// Every column as text: bytes counted, nulls empty.
pub fn cells(batch: &RecordBatch, how: Cells) -> Result<RecordBatch, ArrowError> {
    mapped(batch, |_| true, |column| texts(column, how))
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

fn texts(column: &ArrayRef, how: Cells) -> Result<StringArray, ArrowError> {
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
                .map(|text| Some(cell(&printable(&text), how)))
        })
        .collect()
}

fn cell(text: &str, how: Cells) -> String {
    let line = text
        .chars()
        .map(|letter| if letter.is_control() { ' ' } else { letter });
    match how {
        Cells::Lines => text.to_owned(),
        Cells::Short if text.chars().count() > WIDEST => {
            line.take(WIDEST - 1).chain(['…']).collect()
        }
        Cells::Short | Cells::Long => line.collect(),
    }
}
