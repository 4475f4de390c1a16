//! Of binary values. DataFusion's `octet_length` is of texts alone.

use arrow::compute::cast;
use arrow::compute::kernels::length::length;
use arrow::datatypes::DataType;
use datafusion::common::exec_err;

use crate::function::{Declaration, Kind};

/// The functions.
pub(crate) const DECLARATIONS: [Declaration; 1] = [Declaration {
    name: "octet_length",
    about: "Bytes of a text or a binary value; null where it is null",
    calls: &[&[(
        "value",
        Kind::Any,
        "a text or a binary value, such as an image",
    )]],
    result: || DataType::Int64,
    example: ["SELECT octet_length(X'00ff10')", "3"],
    evaluate: |columns| {
        let [column] = columns else {
            return exec_err!(
                "octet_length: expected one argument, found {}",
                columns.len()
            );
        };
        let kind = column.data_type();
        if !kind.is_string() && !kind.is_binary() && !matches!(kind, DataType::Null) {
            return exec_err!("octet_length: expected a text or a binary value, found {kind}");
        }
        if matches!(kind, DataType::Null) {
            return Ok(cast(column, &DataType::Int64)?);
        }
        Ok(cast(&length(column)?, &DataType::Int64)?)
    },
}];
