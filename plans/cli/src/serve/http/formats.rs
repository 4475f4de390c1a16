//! Rows as the body of an answer.

use std::sync::Arc;

use arrow::ipc::writer::StreamWriter;
use arrow::record_batch::RecordBatch;
use axum::body::{Body, Bytes};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use evermap_schemas::{Fault, Layer};
use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use serde::Deserialize;
use tempfile::SpooledData;
use tokio::sync::Mutex;
use tokio_util::io::ReaderStream;

use crate::earth::Earth;
use crate::ending::Failure;
use crate::export::{GeoJson, Head};
use crate::output::{Format, RowWriter, Sink, pour, writer};
use crate::serve::answer::Answer;
use crate::serve::http::Refusal;

/// Bytes of rows of an answer that is made before it is sent, so that what goes wrong is an error and no torn answer.
const LARGEST: usize = 64 << 20;

/// The same of Parquet, which is smaller than its rows.
const LARGEST_PARQUET: usize = 2 << 30;

/// Bytes of such an answer that are kept in memory, and read of it at once. What is larger lies on the disk.
const PIECE: usize = 64 << 10;

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
/// What reading says; a user fault for an answer that is too large, a resource fault where there is no memory for it.
pub async fn body(
    answer: Answer,
    form: Form,
    layer: Option<&Layer>,
    earth: &Earth,
) -> Result<Response, Refusal> {
    let kind = match form {
        Form::Json => "application/json",
        Form::Csv => "text/csv; charset=utf-8",
        Form::Parquet => "application/vnd.apache.parquet",
        Form::Geojson => "application/geo+json",
        Form::Arrow => return Ok(arrow_stream(answer)?),
    };
    let (made, bytes) = made(answer, form, layer, earth).await?.rewound()?;
    let body = match made.into_inner() {
        SpooledData::InMemory(bytes) => Body::from(bytes.into_inner()),
        SpooledData::OnDisk(file) => {
            let file = tokio::fs::File::from_std(file);
            Body::from_stream(ReaderStream::with_capacity(file, PIECE))
        }
    };
    let head = [
        (header::CONTENT_TYPE, kind.to_owned()),
        (header::CONTENT_LENGTH, bytes.to_string()),
    ];
    Ok((head, body).into_response())
}

/// An answer whole: what is more than little lies in a file without a name, which is gone when it was sent.
async fn made(
    answer: Answer,
    form: Form,
    layer: Option<&Layer>,
    earth: &Earth,
) -> Result<Sink, Failure> {
    let mut sink = Sink::spooled(PIECE);
    let schema = Arc::clone(&answer.schema);
    let largest = match form {
        Form::Parquet => LARGEST_PARQUET,
        _ => LARGEST,
    };
    let writer: Box<dyn RowWriter + '_> = match form {
        Form::Geojson => {
            let head = Head {
                title: "evermap",
                on_earth: earth.moves(&[RecordBatch::new_empty(schema)]),
            };
            Box::new(GeoJson::begin(head, layer, earth, &mut sink)?)
        }
        Form::Csv => writer(Format::Csv, schema, &mut sink)?,
        Form::Parquet => writer(Format::Parquet, schema, &mut sink)?,
        Form::Arrow => writer(Format::Arrow, schema, &mut sink)?,
        Form::Json => writer(Format::Json, schema, &mut sink)?,
    };
    let Answer { rows, memory, .. } = answer;
    pour(measured(rows, largest), writer, |bytes| memory.takes(bytes)).await?;
    Ok(sink)
}

/// The rows, until they are too many bytes to be kept.
fn measured(
    rows: BoxStream<'static, Result<RecordBatch, Fault>>,
    largest: usize,
) -> impl futures::Stream<Item = Result<RecordBatch, Fault>> {
    let mut bytes = 0;
    rows.map(move |batch| {
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::{ArrayRef, Int64Array};
    use axum::body::to_bytes;
    use axum::http::StatusCode;
    use datafusion::execution::memory_pool::{GreedyMemoryPool, MemoryPool};

    use super::*;
    use crate::serve::answer::ReservedMemory;

    /// Memory of so many bytes.
    fn memory(bytes: usize) -> Arc<dyn MemoryPool> {
        Arc::new(GreedyMemoryPool::new(bytes))
    }

    fn thousand(at: i64) -> RecordBatch {
        let numbers = Int64Array::from_iter_values(1000 * at..1000 * (at + 1));
        let numbers: ArrayRef = Arc::new(numbers);
        RecordBatch::try_from_iter([("n", numbers)]).unwrap()
    }

    /// An answer of so many thousands of numbers.
    fn thousands(count: i64, memory: &Arc<dyn MemoryPool>) -> Answer {
        let rows = futures::stream::iter((0..count).map(|at| Ok(thousand(at))));
        Answer {
            schema: thousand(0).schema(),
            rows: rows.boxed(),
            memory: ReservedMemory::of(memory),
        }
    }

    #[tokio::test]
    async fn answers_are_whole_from_memory_and_from_the_disk_and_take_none_while_they_are_sent() {
        let (memory, earth) = (memory(1), Earth::default());
        for (count, is_little) in [(1, true), (20, false)] {
            let answer = thousands(count, &memory);
            let response = body(answer, Form::Json, None, &earth).await;
            let response = response.unwrap_or_else(IntoResponse::into_response);
            assert_eq!(response.status(), StatusCode::OK);
            assert_eq!(memory.reserved(), 0);
            let told: usize = response.headers()[header::CONTENT_LENGTH]
                .to_str()
                .unwrap()
                .parse()
                .unwrap();
            let text = to_bytes(response.into_body(), usize::MAX).await.unwrap();
            assert_eq!(text.len(), told);
            assert_eq!(told <= PIECE, is_little, "{told}");
            let rows: Vec<serde_json::Value> = serde_json::from_slice(&text).unwrap();
            assert_eq!(rows.len(), 1000 * count as usize);
            assert_eq!(rows[999]["n"], 999);
        }
    }

    #[tokio::test]
    async fn what_parquet_keeps_of_rows_counts_in_the_memory() {
        let earth = Earth::default();
        let (little, enough) = (memory(1000), memory(1 << 30));
        let answer = thousands(20, &little);
        let refused = body(answer, Form::Parquet, None, &earth).await;
        let refused = refused.unwrap_or_else(IntoResponse::into_response);
        assert_eq!(refused.status(), StatusCode::SERVICE_UNAVAILABLE);
        let said = to_bytes(refused.into_body(), usize::MAX).await.unwrap();
        let said = String::from_utf8(said.to_vec()).unwrap();
        assert!(said.contains("larger --memory"), "{said}");
        assert_eq!(little.reserved(), 0);

        let answer = thousands(20, &enough);
        let response = body(answer, Form::Parquet, None, &earth).await;
        let response = response.unwrap_or_else(IntoResponse::into_response);
        assert_eq!(response.status(), StatusCode::OK);
        assert_eq!(enough.reserved(), 0);
        let file = to_bytes(response.into_body(), usize::MAX).await.unwrap();
        assert!(file.starts_with(b"PAR1") && file.ends_with(b"PAR1"));
    }
}
