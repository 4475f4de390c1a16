//! Values as JSON.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, StringArray};
use arrow::datatypes::{DataType, Field};
use arrow::error::ArrowError;
use arrow::json::{EncoderOptions, writer::make_encoder};

use datafusion::logical_expr::ScalarUDF;

use crate::function::{Declaration, Function, Kind};

/// The functions.
pub(crate) const DECLARATIONS: [Declaration; 1] = [Declaration {
    name: "to_json",
    about: "A value as JSON: structs are objects, lists are arrays, bytes are hexadecimal; null where it is null",
    calls: &[&[("value", Kind::Any, "a value of any type")]],
    result: || DataType::Utf8,
    example: [
        "SELECT to_json(transform(pose(1, 2, 0, 0), 3, 0, 0))",
        "{\"x\":4.0,\"y\":2.0,\"z\":0.0}",
    ],
    evaluate: |columns| {
        let [column] = columns else {
            return datafusion::common::exec_err!("expected one argument, found {}", columns.len());
        };
        Ok(Arc::new(json_texts(column)?))
    },
}];

/// The function `to_json`.
pub fn to_json() -> ScalarUDF {
    let [declared] = &DECLARATIONS;
    ScalarUDF::from(Function::new(declared))
}

/// Each value of a column as JSON; null where it is null.
///
/// # Errors
/// For a type that JSON has no form for.
pub fn json_texts(column: &ArrayRef) -> Result<StringArray, ArrowError> {
    let field = Arc::new(Field::new("value", column.data_type().clone(), true));
    let options = EncoderOptions::default().with_explicit_nulls(true);
    let mut encoder = make_encoder(&field, column.as_ref(), &options)?;
    let text = |row| {
        let mut json = Vec::new();
        if column.is_null(row) {
            return None;
        }
        encoder.encode(row, &mut json);
        Some(String::from_utf8_lossy(&json).into_owned())
    };
    Ok((0..column.len()).map(text).collect())
}
