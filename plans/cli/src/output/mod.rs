//! Rows on their way out: a table for people, CSV, JSON, Parquet or Arrow for programs.

mod columnar;
mod folder;
mod place;
mod readable;
mod sink;
mod writers;

use std::path::Path;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use clap::ValueEnum;
use evermap_engine::nodes::weight::{self, weight};
use evermap_schemas::{Fault, LayerRow, batch};
use futures::{Stream, StreamExt};

pub use columnar::{CRS, GEOMETRY, with_columns};
pub use folder::Folder;
pub use place::outside_of_maps;
pub use sink::{Sink, write_file, write_together};
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
    write_within(format, schema, rows, sink, |_| Ok(())).await
}

/// As [`write()`]. `copy` is told how many bytes a heavy row will take while it is written, and may refuse it; 0 once it is.
///
/// # Errors
/// As [`write()`], or what `copy` says.
pub async fn write_within(
    format: Format,
    schema: SchemaRef,
    rows: impl Stream<Item = Result<RecordBatch, Fault>>,
    sink: &mut Sink,
    copy: impl Fn(usize) -> Result<(), Fault>,
) -> Result<u64, Failure> {
    let cells = match sink.is_terminal() {
        true => Cells::Short,
        false => Cells::Long,
    };
    let writer = open(format, cells, schema, sink)?;
    poured(rows, writer, |_, copied| copy(copied)).await
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
    pour(rows, open(format, Cells::Lines, schema, sink)?, |_| Ok(())).await
}

fn open(
    format: Format,
    cells: Cells,
    schema: SchemaRef,
    sink: &mut Sink,
) -> Result<Box<dyn RowWriter + '_>, Failure> {
    if format.is_binary() && sink.is_terminal() {
        return Err(Fault::user("Parquet and Arrow are not for terminals")
            .next("name a file with --out, or redirect")
            .into());
    }
    writers::open(format, cells, schema, sink)
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
/// come, and how many a heavy row will take while it is written, each time in place of those before, and may refuse it.
///
/// # Errors
/// What the stream, the writer or `keep` says.
pub async fn pour(
    rows: impl Stream<Item = Result<RecordBatch, Fault>>,
    writer: Box<dyn RowWriter + '_>,
    keep: impl Fn(usize) -> Result<(), Fault>,
) -> Result<u64, Failure> {
    poured(rows, writer, |held, copied| keep(held + copied)).await
}

/// As [`pour`], where `keep` is told both numbers.
async fn poured(
    rows: impl Stream<Item = Result<RecordBatch, Fault>>,
    mut writer: Box<dyn RowWriter + '_>,
    keep: impl Fn(usize, usize) -> Result<(), Fault>,
) -> Result<u64, Failure> {
    let mut rows = std::pin::pin!(rows);
    let mut count = 0;
    while let Some(batch) = rows.next().await {
        let batch = batch?;
        count += batch.num_rows() as u64;
        for piece in pieces(batch) {
            let weight = weight(&piece);
            if weight > LIGHT_BYTES {
                keep(writer.held(), writer.copies() * weight)?;
            }
            writer.write(&piece)?;
            keep(writer.held(), 0)?;
            // Rows that are all there already would not be left before their end, whoever wants to stop.
            tokio::task::yield_now().await;
        }
    }
    writer.finish()?;
    Ok(count)
}

/// Bytes of rows that are written together, unless they are of a single row: what a format makes of them meanwhile is a few times as
/// much.
const LIGHT_BYTES: usize = 8 << 20;

/// A batch as several light ones, as far as its rows are light.
pub fn pieces(batch: RecordBatch) -> Vec<RecordBatch> {
    let (all, bytes) = (batch.num_rows(), weight(&batch));
    if bytes <= LIGHT_BYTES || all <= 1 {
        return vec![batch];
    }
    let rows = (0..all).map(|row| weight(&batch.slice(row, 1)) as u64);
    weight::pieces(&batch, rows, LIGHT_BYTES as u64)
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
