//! Cells as people and spreadsheets read them.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema};
use arrow::error::ArrowError;
use arrow::json::LineDelimitedWriter;
use arrow::json::writer::{LineDelimited, WriterBuilder};
use arrow::util::display::{ArrayFormatter, FormatOptions};

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
    if *column.data_type() == DataType::Binary {
        let sizes = column.as_binary::<i32>().iter();
        return Ok(sizes
            .map(|bytes| bytes.map(|bytes| format!("{} B", bytes.len())))
            .collect());
    }
    let options = FormatOptions::default().with_null("");
    let formatter = ArrayFormatter::try_new(column.as_ref(), &options)?;
    (0..column.len())
        .map(|row| {
            formatter
                .value(row)
                .try_to_string()
                .map(|text| Some(short(&text)))
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

fn json_texts(column: &ArrayRef) -> Result<StringArray, ArrowError> {
    let field = Field::new("v", column.data_type().clone(), true);
    let batch = RecordBatch::try_new(Arc::new(Schema::new(vec![field])), vec![Arc::clone(column)])?;
    let mut bytes = Vec::new();
    let mut writer: LineDelimitedWriter<_> = WriterBuilder::new()
        .with_explicit_nulls(true)
        .build::<_, LineDelimited>(&mut bytes);
    writer.write(&batch)?;
    writer.finish()?;
    let text = String::from_utf8_lossy(&bytes);
    let value = |line: &str| {
        line.strip_prefix("{\"v\":")
            .and_then(|line| line.strip_suffix('}'))
            .map(str::to_owned)
    };
    let texts = text
        .lines()
        .map(value)
        .map(|value| value.filter(|value| value != "null"));
    Ok(texts.collect())
}
