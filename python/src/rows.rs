//! The rows of an answer, handed over by Arrow's C stream.

use arrow::array::{RecordBatch, RecordBatchIterator};
use arrow::datatypes::SchemaRef;
use arrow::ffi_stream::FFI_ArrowArrayStream;
use arrow::util::pretty::pretty_format_batches;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

/// Rows that a text shows.
const SHOWN: usize = 10;

/// The rows of an answer, as Arrow. Whatever reads Arrow's C stream (pyarrow, polars, DuckDB) takes them as they are.
#[pyclass(frozen, module = "evermap")]
pub(crate) struct Rows {
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
}

impl From<(SchemaRef, Vec<RecordBatch>)> for Rows {
    fn from((schema, batches): (SchemaRef, Vec<RecordBatch>)) -> Self {
        Self { schema, batches }
    }
}

#[pymethods]
impl Rows {
    /// Names of the columns.
    #[getter]
    fn columns(&self) -> Vec<String> {
        let fields = self.schema.fields().iter();
        fields.map(|field| field.name().clone()).collect()
    }

    fn __len__(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    fn __repr__(&self) -> String {
        let mut left = SHOWN;
        let mut shown = Vec::new();
        for batch in &self.batches {
            let part = batch.slice(0, batch.num_rows().min(left));
            left -= part.num_rows();
            shown.push(part);
        }
        let table = match pretty_format_batches(&shown) {
            Ok(table) => table.to_string(),
            Err(error) => error.to_string(),
        };
        match self.__len__() {
            rows if rows > SHOWN => format!("{table}\n{rows} rows"),
            _ => table,
        }
    }

    /// The rows as a stream of Arrow's C interface; nothing is copied.
    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_stream__<'p>(
        &self,
        py: Python<'p>,
        requested_schema: Option<Bound<'p, PyAny>>,
    ) -> PyResult<Bound<'p, PyCapsule>> {
        // Whoever wants other types casts what it gets, as the interface lets a producer do.
        let _ = requested_schema;
        let batches = self.batches.clone().into_iter().map(Ok);
        let batches = RecordBatchIterator::new(batches, self.schema.clone());
        let stream = FFI_ArrowArrayStream::new(Box::new(batches));
        PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
    }

    /// As a table of pyarrow.
    fn arrow<'p>(slf: &Bound<'p, Self>) -> PyResult<Bound<'p, PyAny>> {
        slf.py().import("pyarrow")?.call_method1("table", (slf,))
    }

    /// As a data frame of pandas.
    fn pandas<'p>(slf: &Bound<'p, Self>) -> PyResult<Bound<'p, PyAny>> {
        Self::arrow(slf)?.call_method0("to_pandas")
    }

    /// As a data frame of polars.
    fn polars<'p>(slf: &Bound<'p, Self>) -> PyResult<Bound<'p, PyAny>> {
        slf.py().import("polars")?.call_method1("DataFrame", (slf,))
    }

    /// As a frame of geopandas, with a column of well-known binary as geometry, in local metres.
    #[pyo3(signature = (geometry = "geometry"))]
    fn geopandas<'p>(slf: &Bound<'p, Self>, geometry: &str) -> PyResult<Bound<'p, PyAny>> {
        let geopandas = slf.py().import("geopandas")?;
        let frame = Self::pandas(slf)?;
        let series = geopandas.getattr("GeoSeries")?;
        let shapes = series.call_method1("from_wkb", (frame.get_item(geometry)?,))?;
        frame.set_item(geometry, shapes)?;
        let options = pyo3::types::PyDict::new(slf.py());
        options.set_item("geometry", geometry)?;
        geopandas.call_method("GeoDataFrame", (frame,), Some(&options))
    }
}
