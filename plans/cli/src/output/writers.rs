//! One writer a format.

use std::io::{Error as IoError, Result as IoResult, Write};

use arrow::array::RecordBatch;
use arrow::csv::WriterBuilder as CsvBuilder;
use arrow::datatypes::SchemaRef;
use arrow::json::writer::{JsonArray, Writer as JsonWriter, WriterBuilder as JsonBuilder};
use arrow::util::pretty::pretty_format_batches;

use crate::ending::Failure;
use crate::output::columnar::{Arrow, Parquet};
use crate::output::readable::{self, Cells, flat};
use crate::output::{Format, Sink};
use crate::printable::printable;

/// Rows of a table that are laid out together; longer results are several tables, so that memory stays flat.
const TABLE_ROWS: usize = 20_000;

/// Bytes of their texts.
const TABLE_BYTES: usize = 32 << 20;

/// Writes batches.
pub trait RowWriter: Send {
    /// Takes the next rows.
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Failure>;

    /// Bytes that are kept of rows until more of them come.
    fn held(&self) -> usize {
        0
    }

    /// How often a heavy row is in memory meanwhile, beside itself: as another value, as a text that grows, and as a line of texts.
    fn copies(&self) -> usize;

    /// Writes what ends the text.
    fn finish(self: Box<Self>) -> Result<(), Failure>;
}

/// The writer of a format.
pub fn open(
    format: Format,
    cells: Cells,
    schema: SchemaRef,
    sink: &mut Sink,
) -> Result<Box<dyn RowWriter + '_>, Failure> {
    Ok(match format {
        Format::Table => Box::new(Table {
            sink,
            held: vec![readable::cells(&RecordBatch::new_empty(schema), cells)?],
            cells,
            rows: 0,
            bytes: 0,
            shown: false,
        }),
        Format::Csv => {
            let mut csv = Csv { sink };
            // The header stands even where there are no rows.
            csv.lay_out(&RecordBatch::new_empty(schema), true)?;
            Box::new(csv)
        }
        Format::Json => Box::new(
            JsonBuilder::new()
                .with_explicit_nulls(true)
                .build::<_, JsonArray>(sink),
        ),
        Format::Parquet => Box::new(Parquet::open(&schema, sink)?),
        Format::Arrow => Box::new(Arrow::open(&schema, sink)?),
    })
}

struct Table<'s> {
    sink: &'s mut Sink,
    held: Vec<RecordBatch>,
    cells: Cells,
    rows: usize,
    bytes: usize,
    shown: bool,
}

impl Table<'_> {
    fn show(&mut self) -> Result<(), Failure> {
        let text = pretty_format_batches(&self.held)?.to_string();
        self.shown = true;
        (self.rows, self.bytes) = (0, 0);
        self.held.truncate(1);
        Ok(writeln!(self.sink, "{}", printable(&text))?)
    }
}

impl RowWriter for Table<'_> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Failure> {
        let texts = readable::cells(batch, self.cells)?;
        self.rows += texts.num_rows();
        self.bytes += texts.get_array_memory_size();
        self.held.push(texts);
        if self.rows >= TABLE_ROWS || self.bytes >= TABLE_BYTES {
            self.show()
        } else {
            Ok(())
        }
    }

    fn held(&self) -> usize {
        self.bytes
    }

    fn copies(&self) -> usize {
        7
    }

    fn finish(mut self: Box<Self>) -> Result<(), Failure> {
        if self.rows > 0 || !self.shown {
            self.show()
        } else {
            Ok(())
        }
    }
}

struct Csv<'s> {
    sink: &'s mut Sink,
}

impl Csv<'_> {
    fn lay_out(&mut self, batch: &RecordBatch, header: bool) -> Result<(), Failure> {
        let mut failed = None;
        let out = ErrorKeeper {
            sink: self.sink,
            failed: &mut failed,
        };
        let mut csv = CsvBuilder::new().with_header(header).build(out);
        let written = csv.write(&flat(batch)?);
        drop(csv);
        match failed {
            Some(error) => Err(error.into()),
            None => Ok(written?),
        }
    }
}

/// A sink for a library that makes a text of what goes wrong: whether nobody reads any more, or the disk is full, is kept.
struct ErrorKeeper<'s> {
    sink: &'s mut Sink,
    failed: &'s mut Option<IoError>,
}

impl ErrorKeeper<'_> {
    fn keep(&mut self, written: IoResult<()>) -> IoResult<()> {
        written.map_err(|error| {
            let kind = error.kind();
            *self.failed = Some(error);
            kind.into()
        })
    }
}

impl Write for ErrorKeeper<'_> {
    fn write(&mut self, bytes: &[u8]) -> IoResult<usize> {
        let written = self.sink.write_all(bytes);
        self.keep(written).map(|()| bytes.len())
    }

    fn flush(&mut self) -> IoResult<()> {
        let written = self.sink.flush();
        self.keep(written)
    }
}

impl RowWriter for Csv<'_> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Failure> {
        self.lay_out(batch, false)
    }

    fn copies(&self) -> usize {
        5
    }

    fn finish(self: Box<Self>) -> Result<(), Failure> {
        Ok(())
    }
}

/// JSON ends with a line break, as text files do.
impl RowWriter for JsonWriter<&mut Sink, JsonArray> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Failure> {
        Ok(JsonWriter::write(self, batch)?)
    }

    fn copies(&self) -> usize {
        3
    }

    fn finish(mut self: Box<Self>) -> Result<(), Failure> {
        JsonWriter::finish(&mut self)?;
        Ok(self.into_inner().write_all(b"\n")?)
    }
}
