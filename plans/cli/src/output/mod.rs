//! Rows on their way out: a table for people, CSV, JSON, Parquet or Arrow for programs.

mod columnar;
mod place;
mod readable;
mod sink;
mod writers;

use std::path::Path;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use clap::ValueEnum;
use evermap_schemas::{Fault, LayerRow, batch};
use futures::{Stream, StreamExt};

pub use columnar::{CRS, GEOMETRY, with_columns};
pub use place::outside_of_maps;
pub use sink::{Sink, write_file};
pub use writers::RowWriter;

use crate::ending::Failure;
use crate::output::readable::Cells;

/// How rows are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people: bytes are counted; on a terminal long cells are cut.
    Table,
    /// Comma separated, with a header; lists and structs are JSON.
    Csv,
    /// One array of objects; bytes are hexadecimal.
    Json,
    /// Parquet, as it is kept in the map.
    Parquet,
    /// Arrow's file, as it lies in memory: read without decoding.
    Arrow,
}

impl Format {
    /// The format that a file's ending names, in capitals or not; `None` for endings that name none.
    pub fn of_ending(file: &Path) -> Option<Self> {
        let ending = file.extension()?.to_str()?;
        Self::from_str(ending, true).ok()
    }

    /// Its name, as `--format` has it.
    pub fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Whether an output is one file of bytes, rather than text.
    pub fn is_binary(self) -> bool {
        matches!(self, Self::Parquet | Self::Arrow)
    }
}

/// Writes rows as they come; how many there were. In a table on a terminal, long cells are cut.
///
/// # Errors
/// What the stream says, or that the output is closed or full.
pub async fn write(
    format: Format,
    schema: SchemaRef,
    rows: impl Stream<Item = Result<RecordBatch, Fault>>,
    sink: &mut Sink,
) -> Result<u64, Failure> {
    let cells = match sink.is_terminal() {
        true => Cells::Short,
        false => Cells::Long,
    };
    written(format, cells, schema, rows, sink).await
}

/// As [`write()`], and each cell is whole, with the lines that it has.
///
/// # Errors
/// As [`write()`].
pub async fn write_whole(
    format: Format,
    schema: SchemaRef,
    rows: impl Stream<Item = Result<RecordBatch, Fault>>,
    sink: &mut Sink,
) -> Result<u64, Failure> {
    written(format, Cells::Lines, schema, rows, sink).await
}

async fn written(
    format: Format,
    cells: Cells,
    schema: SchemaRef,
    rows: impl Stream<Item = Result<RecordBatch, Fault>>,
    sink: &mut Sink,
) -> Result<u64, Failure> {
    if format.is_binary() && sink.is_terminal() {
        return Err(Fault::user("Parquet and Arrow are not for terminals")
            .next("name a file with --out, or redirect")
            .into());
    }
    let writer = writers::open(format, cells, schema, sink)?;
    pour(rows, writer, |_| Ok(())).await
}

/// What writes rows in a format, as [`write()`] does.
///
/// # Errors
/// Columns that the format has no type for, or that the output is closed or full.
pub fn writer(
    format: Format,
    schema: SchemaRef,
    sink: &mut Sink,
) -> Result<Box<dyn RowWriter + '_>, Failure> {
    writers::open(format, Cells::Long, schema, sink)
}

/// Writes rows as they come, to their end; how many there were. `keep` is told how many bytes are kept of them until more
/// come, each time in place of those before, and may refuse it.
///
/// # Errors
/// What the stream, the writer or `keep` says.
pub async fn pour(
    rows: impl Stream<Item = Result<RecordBatch, Fault>>,
    mut writer: Box<dyn RowWriter + '_>,
    keep: impl Fn(usize) -> Result<(), Fault>,
) -> Result<u64, Failure> {
    let mut rows = std::pin::pin!(rows);
    let mut count = 0;
    while let Some(batch) = rows.next().await {
        let batch = batch?;
        count += batch.num_rows() as u64;
        writer.write(&batch)?;
        keep(writer.held())?;
    }
    writer.finish()?;
    Ok(count)
}

/// Writes typed rows to standard output, whole.
///
/// # Errors
/// As [`write()`].
pub async fn print_rows<T: LayerRow>(format: Format, rows: Vec<T>) -> Result<(), Failure> {
    print_batch(format, batch(rows)?).await
}

/// Writes a batch to standard output, whole.
///
/// # Errors
/// As [`write()`].
pub async fn print_batch(format: Format, rows: RecordBatch) -> Result<(), Failure> {
    let mut sink = Sink::stdout();
    write_whole(
        format,
        rows.schema(),
        futures::stream::iter([Ok(rows)]),
        &mut sink,
    )
    .await?;
    sink.finish()
}

#[cfg(test)]
mod tests;
