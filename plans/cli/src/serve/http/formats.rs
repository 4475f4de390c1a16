//! Rows as the body of an answer.

use std::io::{BufWriter, Seek, SeekFrom};
use std::sync::Arc;

use arrow::ipc::writer::StreamWriter;
use arrow::record_batch::RecordBatch;
use axum::body::{Body, Bytes};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use evermap_schemas::{Fault, Layer};
use futures::{StreamExt, TryStreamExt};
use serde::Deserialize;
use tokio::sync::Mutex;
use tokio_util::io::ReaderStream;

use crate::earth::Earth;
use crate::ending::Failure;
use crate::export::geojson;
use crate::output::{Format, Sink, write};
use crate::serve::answer::Answer;
use crate::serve::http::Refusal;

/// Bytes of an answer that is made before it is sent, so that what goes wrong is an error and no torn answer.
const LARGEST: usize = 64 << 20;

/// The same of one that is made on the disk.
const LARGEST_FILE: usize = 2 << 30;

/// How rows are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// One array of objects, as `evermap sql --format json`.
    #[default]
    Json,
    /// As `evermap sql --format csv`.
    Csv,
    /// As `evermap sql --format parquet`: made on the disk, so that a layer may be large.
    Parquet,
    /// A stream of Arrow, as long as it gets.
    Arrow,
    /// A feature collection, of rows with a geometry: on earth, where it is known where their site lies.
    Geojson,
}

/// The body of an answer. `layer` says which column is the geometry, `earth` where on earth GeoJSON puts it.
///
/// # Errors
/// What reading says; a user fault for an answer that is too large.
pub async fn body(
    answer: Answer,
    form: Form,
    layer: Option<&Layer>,
    earth: &Earth,
) -> Result<Response, Refusal> {
    let (kind, bytes) = match form {
        Form::Json => ("application/json", written(answer, Format::Json).await?),
        Form::Csv => (
            "text/csv; charset=utf-8",
            written(answer, Format::Csv).await?,
        ),
        Form::Parquet => return Ok(parquet(answer).await?),
        Form::Geojson => {
            let batches: Vec<RecordBatch> = measured(answer, LARGEST).try_collect().await?;
            let mut text = Vec::new();
            geojson(batches, layer, "evermap", earth, &mut text)?;
            ("application/geo+json", text)
        }
        Form::Arrow => return Ok(arrow_stream(answer)?),
    };
    Ok(([(header::CONTENT_TYPE, kind)], bytes).into_response())
}

async fn written(answer: Answer, format: Format) -> Result<Vec<u8>, Failure> {
    let schema = Arc::clone(&answer.schema);
    let mut sink = Sink::Memory(Vec::new());
    write(format, schema, measured(answer, LARGEST), &mut sink).await?;
    match sink {
        Sink::Memory(bytes) => Ok(bytes),
        _ => Ok(Vec::new()),
    }
}

/// Parquet from a file without a name, which is gone when it was sent.
async fn parquet(answer: Answer) -> Result<Response, Failure> {
    let schema = Arc::clone(&answer.schema);
    let mut file = tempfile::tempfile()?;
    let mut sink = Sink::Special(BufWriter::new(file.try_clone()?));
    write(
        Format::Parquet,
        schema,
        measured(answer, LARGEST_FILE),
        &mut sink,
    )
    .await?;
    sink.finish()?;
    let bytes = file.seek(SeekFrom::End(0))?;
    file.rewind()?;
    let body = Body::from_stream(ReaderStream::new(tokio::fs::File::from_std(file)));
    let head = [
        (
            header::CONTENT_TYPE,
            "application/vnd.apache.parquet".to_owned(),
        ),
        (header::CONTENT_LENGTH, bytes.to_string()),
    ];
    Ok((head, body).into_response())
}

/// The rows, until they are too many bytes to be kept.
fn measured(
    answer: Answer,
    largest: usize,
) -> impl futures::Stream<Item = Result<RecordBatch, Fault>> {
    let mut bytes = 0;
    answer.rows.map(move |batch| {
        let batch = batch?;
        bytes += batch
            .columns()
            .iter()
            .map(|column| column.get_array_memory_size())
            .sum::<usize>();
        if bytes > largest {
            return Err(
                Fault::user(format!("the answer is larger than {} MiB", largest >> 20)).next(
                    "ask for fewer rows or columns, for format=parquet, which may be larger, or for format=arrow, which is sent as it comes",
                ),
            );
        }
        Ok(batch)
    })
}

/// Rows as they come. A batch counts in the memory until what was made of it is sent: then the next one is asked for.
fn arrow_stream(answer: Answer) -> Result<Response, Fault> {
    let writer = Arc::new(Mutex::new(StreamWriter::try_new(
        Vec::new(),
        &answer.schema,
    )?));
    let of_rows = {
        let writer = Arc::clone(&writer);
        answer.rows.then(move |batch| {
            let writer = Arc::clone(&writer);
            async move {
                let mut writer = writer.lock().await;
                writer.write(&batch?)?;
                Ok::<_, Fault>(Bytes::from(std::mem::take(writer.get_mut())))
            }
        })
    };
    let end = futures::stream::once(async move {
        let mut writer = writer.lock().await;
        writer.finish()?;
        Ok::<_, Fault>(Bytes::from(std::mem::take(writer.get_mut())))
    });
    let body = Body::from_stream(of_rows.chain(end).map_err(|fault| {
        tracing::warn!("an answer ends early: {fault}");
        std::io::Error::other(fault.to_string())
    }));
    let kind = [(header::CONTENT_TYPE, "application/vnd.apache.arrow.stream")];
    Ok((kind, body).into_response())
}
