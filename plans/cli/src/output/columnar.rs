//! Rows for programs that read columns: Parquet, whose columns are encoded side by side, and Arrow's own file.

use std::sync::Arc;

use arrow::array::{ArrayRef, RecordBatch, RecordBatchOptions, new_empty_array};
use arrow::compute::cast;
use arrow::datatypes::{DataType, FieldRef, Fields, Schema, SchemaRef};
use arrow::error::ArrowError;
use arrow::ipc::writer::FileWriter;
use evermap_schemas::geoparquet::{self, GeoColumn};
use evermap_schemas::{Fault, type_name};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_writer::{
    ArrowColumnWriter, ArrowLeafColumn, ArrowRowGroupWriterFactory, compute_leaves,
};
use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::{ParquetError, Result as Encoded};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use rayon::prelude::*;
use serde_json::Value;

use crate::ending::Failure;
use crate::output::Sink;
use crate::output::writers::RowWriter;

/// Rows of a row group; fewer, where they take [`GROUP_BYTES`] before.
const GROUP_ROWS: usize = 1 << 20;
/// Encoded bytes that are held until they are written as a row group.
const GROUP_BYTES: usize = 128 << 20;

/// Writes Parquet, each column by whichever core is free.
pub struct Parquet<'s> {
    file: SerializedFileWriter<&'s mut Sink>,
    factory: ArrowRowGroupWriterFactory,
    fields: Vec<FieldRef>,
    /// Of the row group that is being filled.
    columns: Vec<ArrowColumnWriter>,
    groups: usize,
    rows: usize,
    /// The column [`GEOMETRY`], if there is one.
    geometries: GeoColumn,
    /// Where its coordinates lie: PROJJSON, or null for local metres.
    crs: Value,
}

/// Name of the column whose values are taken for geometries, where they are.
pub const GEOMETRY: &str = geoparquet::COLUMN;
/// Key of a schema's metadata that says, as PROJJSON, where the geometries lie.
pub const CRS: &str = "crs";

impl<'s> Parquet<'s> {
    /// To a sink.
    ///
    /// # Errors
    /// Columns that Parquet has no type for, or what the sink says.
    pub fn open(schema: &SchemaRef, sink: &'s mut Sink) -> Result<Self, Failure> {
        let level = ZstdLevel::try_new(1).unwrap_or_default();
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(level))
            // Messages are mostly numbers that do not repeat: looking for repeats costs more than it saves.
            .set_dictionary_enabled(false)
            .set_statistics_enabled(EnabledStatistics::Chunk)
            .build();
        writable(schema)?;
        let (file, factory) = ArrowWriter::try_new(sink, schema.clone(), Some(properties))
            .and_then(ArrowWriter::into_serialized_writer)
            .map_err(failure)?;
        Ok(Self {
            file,
            factory,
            fields: schema.fields().to_vec(),
            columns: Vec::new(),
            groups: 0,
            rows: 0,
            geometries: GeoColumn::new(GEOMETRY),
            crs: crs(schema),
        })
    }

    fn append(&mut self, columns: &[ArrayRef]) -> Encoded<()> {
        if self.columns.is_empty() {
            self.columns = self.factory.create_column_writers(self.groups)?;
        }
        let leaves = self.fields.par_iter().zip(columns);
        let leaves = leaves.map(|(field, column)| compute_leaves(field, column));
        let leaves: Vec<Vec<ArrowLeafColumn>> = leaves.collect::<Encoded<_>>()?;
        let leaves: Vec<ArrowLeafColumn> = leaves.into_iter().flatten().collect();
        let columns = self.columns.par_iter_mut().zip(&leaves);
        columns.try_for_each(|(column, leaf)| column.write(leaf))
    }

    fn end_group(&mut self) -> Encoded<()> {
        if self.rows == 0 {
            return Ok(());
        }
        let columns = std::mem::take(&mut self.columns);
        let chunks: Encoded<Vec<_>> = columns
            .into_par_iter()
            .map(ArrowColumnWriter::close)
            .collect();
        let mut group = self.file.next_row_group()?;
        for chunk in chunks? {
            chunk.append_to_row_group(&mut group)?;
        }
        group.close()?;
        self.groups += 1;
        self.rows = 0;
        Ok(())
    }
}

impl RowWriter for Parquet<'_> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Failure> {
        self.geometries.add(batch);
        self.append(batch.columns()).map_err(failure)?;
        self.rows += batch.num_rows();
        if self.rows >= GROUP_ROWS || self.held() >= GROUP_BYTES {
            self.end_group().map_err(failure)?;
        }
        Ok(())
    }

    fn held(&self) -> usize {
        self.columns
            .iter()
            .map(ArrowColumnWriter::memory_size)
            .sum()
    }

    fn copies(&self) -> usize {
        4
    }

    fn finish(mut self: Box<Self>) -> Result<(), Failure> {
        self.end_group().map_err(failure)?;
        if !self.geometries.is_empty() {
            let said = self.geometries.metadata(&self.crs);
            let said = KeyValue::new(geoparquet::KEY.to_owned(), said);
            self.file.append_key_value_metadata(said);
        }
        self.file.close().map(drop).map_err(failure)
    }
}

/// That Parquet has a type for each column. Of some it tells when values come, and the file has begun by then.
fn writable(schema: &SchemaRef) -> Result<(), Failure> {
    let begun = ArrowWriter::try_new(std::io::sink(), Arc::clone(schema), None);
    let (_, factory) = begun
        .and_then(ArrowWriter::into_serialized_writer)
        .map_err(failure)?;
    let columns = factory.create_column_writers(0).map_err(failure)?;
    let mut columns = columns.into_iter();
    for field in schema.fields() {
        let none = new_empty_array(field.data_type());
        let leaves = compute_leaves(field, &none);
        let written = leaves.and_then(|leaves| {
            let mut leaves = leaves.iter().zip(columns.by_ref());
            leaves.try_for_each(|(leaf, mut column)| column.write(leaf))
        });
        written.map_err(|_| {
            let (name, kind) = (field.name(), type_name(field.data_type()));
            Fault::user(format!("Parquet has no type for column {name}, {kind}"))
                .next("cast it, CAST(x AS TEXT), or write --format arrow")
        })?;
    }
    Ok(())
}

fn crs(schema: &SchemaRef) -> Value {
    let given = schema.metadata().get(CRS);
    let read = given.and_then(|text| serde_json::from_str(text).ok());
    read.unwrap_or(Value::Null)
}

fn failure(error: ParquetError) -> Failure {
    match error {
        ParquetError::External(inner) => match inner.downcast::<std::io::Error>() {
            Ok(error) => (*error).into(),
            Err(other) => Fault::resource(format!("cannot write Parquet: {other}")).into(),
        },
        other => Fault::data(format!("cannot write Parquet: {other}")).into(),
    }
}

/// Writes Arrow's own file. Values stand in the place of dictionaries: a file may have one of each column, and queries make
/// one of each batch.
pub struct Arrow<'s> {
    file: FileWriter<&'s mut Sink>,
    has_dictionaries: bool,
}

impl<'s> Arrow<'s> {
    /// To a sink.
    ///
    /// # Errors
    /// Columns that Arrow's file has no type for, or what the sink says.
    pub fn open(schema: &SchemaRef, sink: &'s mut Sink) -> Result<Self, Failure> {
        let fields: Fields = schema.fields().iter().map(of_values).collect();
        let has_dictionaries = &fields != schema.fields();
        let schema = Schema::new_with_metadata(fields, schema.metadata().clone());
        Ok(Self {
            file: FileWriter::try_new(sink, &schema)?,
            has_dictionaries,
        })
    }
}

/// A column with values where it has dictionaries.
fn of_values(field: &FieldRef) -> FieldRef {
    let values = values(field.data_type());
    Arc::new(field.as_ref().clone().with_data_type(values))
}

/// A type with those of their values in the place of dictionaries.
fn values(found: &DataType) -> DataType {
    match found {
        DataType::Dictionary(_, value) => values(value),
        DataType::Struct(members) => DataType::Struct(members.iter().map(of_values).collect()),
        DataType::List(item) => DataType::List(of_values(item)),
        DataType::LargeList(item) => DataType::LargeList(of_values(item)),
        DataType::FixedSizeList(item, size) => DataType::FixedSizeList(of_values(item), *size),
        DataType::Map(entries, sorted) => DataType::Map(of_values(entries), *sorted),
        other => other.clone(),
    }
}

/// A batch with columns of other types.
///
/// # Errors
/// Columns that do not become what they should.
pub fn with_columns(schema: &SchemaRef, batch: &RecordBatch) -> Result<RecordBatch, ArrowError> {
    let columns = batch.columns().iter().zip(schema.fields());
    let columns = columns.map(|(column, field)| cast(column, field.data_type()));
    let columns = columns.collect::<Result<_, ArrowError>>()?;
    let rows = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
    RecordBatch::try_new_with_options(Arc::clone(schema), columns, &rows)
}

impl RowWriter for Arrow<'_> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Failure> {
        let schema = Arc::clone(self.file.schema());
        // It would write the bytes of one type under the name of another.
        let said = schema.fields().iter();
        let mut columns = said.zip(batch.schema_ref().fields());
        let other = columns.find(|(said, found)| {
            let found = values(found.data_type());
            !said.data_type().equals_datatype(&found)
        });
        match other {
            Some((said, found)) => Err(Fault::bug(format!(
                "cannot write Arrow: expected {} of type {}, found {}",
                said.name(),
                said.data_type(),
                found.data_type()
            ))
            .into()),
            None if self.has_dictionaries => Ok(self.file.write(&with_columns(&schema, batch)?)?),
            None => Ok(self.file.write(batch)?),
        }
    }

    fn copies(&self) -> usize {
        0
    }

    fn finish(mut self: Box<Self>) -> Result<(), Failure> {
        Ok(self.file.finish()?)
    }
}
