//! A layer: a record with a name, a version, a row order and, perhaps, a geometry.

use std::collections::HashMap;
use std::sync::Arc;

use arrow::array::{ArrayRef, RecordBatch};
use arrow::datatypes::{Schema, SchemaRef};

use crate::{Column, Fault, Record};

/// The declaration of a layer, without its row type.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Plural noun.
    pub name: &'static str,
    /// Raised when a column changes meaning.
    pub version: u32,
    /// The row struct's documentation: what one row is.
    pub doc: &'static str,
    /// Columns, in order.
    pub columns: Vec<Column>,
    /// The columns that order, and name, a row. Artifacts are stored in this order, so that equal maps are equal
    /// bytes.
    pub key: &'static [&'static str],
    /// The WKB column that makes the stored file GeoParquet.
    pub geometry: Option<&'static str>,
}

impl Layer {
    /// The metadata in which a schema, and a file, says whose rows it has; those of queries have none.
    pub const SAID_AS: &str = "evermap.layer";

    /// The Arrow schema; units and frames are field metadata, name and version schema metadata.
    pub fn schema(&self) -> SchemaRef {
        let fields: Vec<_> = self.columns.iter().map(Column::field).collect();
        let metadata = HashMap::from([
            (Self::SAID_AS.to_owned(), self.name.to_owned()),
            ("evermap.layer_version".to_owned(), self.version.to_string()),
        ]);
        Arc::new(Schema::new_with_metadata(fields, metadata))
    }

    /// The column of this name.
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|column| column.name == name)
    }
}

/// A record that is a layer's row. Declared by the attribute `layer` of [`record!`](crate::record).
pub trait LayerRow: Record {
    /// Layer name: a plural noun.
    const NAME: &'static str;
    /// Raised when a column changes meaning.
    const VERSION: u32 = 1;
    /// The columns that order a row.
    const KEY: &'static [&'static str];
    /// The WKB column, if there is one.
    const GEOMETRY: Option<&'static str> = None;

    /// The declaration.
    fn layer() -> Layer {
        Layer {
            name: Self::NAME,
            version: Self::VERSION,
            doc: Self::DOC,
            columns: Self::columns(),
            key: Self::KEY,
            geometry: Self::GEOMETRY,
        }
    }
}

/// The batch of these rows, in the layer's schema.
///
/// # Errors
/// As [`crate::Cell::encode`].
pub fn batch<T: LayerRow>(rows: Vec<T>) -> Result<RecordBatch, Fault> {
    let columns =
        T::encode_columns(rows).map_err(|fault| fault.at(format!("layer {}", T::NAME)))?;
    Ok(RecordBatch::try_new(T::layer().schema(), columns)?)
}

/// The typed rows of a batch. Columns are found by name ([`Column::of`]); those that the layer does not declare are ignored.
///
/// # Errors
/// A data fault when a column is missing, of another type, or holds nulls where none may be.
pub fn rows<T: Record>(batch: &RecordBatch) -> Result<Vec<T>, Fault> {
    let columns = T::columns();
    let columns = columns.iter().map(|column| column.of(batch));
    T::decode_columns(&columns.collect::<Result<Vec<_>, _>>()?)
}

/// The column of this name of a batch.
///
/// # Errors
/// A data fault that names those there are.
pub fn column<'b>(batch: &'b RecordBatch, name: &str) -> Result<&'b ArrayRef, Fault> {
    batch.column_by_name(name).ok_or_else(|| {
        let found = batch.schema_ref().fields().iter();
        let found: Vec<_> = found.map(|field| field.name().as_str()).collect();
        Fault::data(format!(
            "expected a column {name}, found {}",
            found.join(", ")
        ))
    })
}
