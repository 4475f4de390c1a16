//! How fast a log becomes Arrow, for the scripts in `tests/peers`.
//!
//! ```text
//! scan FILE TOPIC [--threads N]    every column of a topic, to record batches: {"rows", "bytes", "seconds"}
//! scan FILE --raw                  only decompresses every chunk, the limit of any reader: {"bytes", "seconds"}
//! ```
//! Opening the file and reading its index is on the clock; starting the process is not.

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::time::Instant;

use datafusion::common::TableReference;
use datafusion::error::DataFusionError;
use datafusion::prelude::{SessionConfig, SessionContext};
use evermap_datasets::Dataset;
use futures::StreamExt;
use serde_json::json;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match words.as_slice() {
        [file, "--raw"] => raw(file)?,
        [file, topic] => scan(file, topic, 1)?,
        [file, topic, "--threads", threads] => scan(file, topic, threads.parse()?)?,
        _ => return Err("usage: scan FILE TOPIC [--threads N] | scan FILE --raw".into()),
    };
    println!("{result}");
    Ok(())
}

fn scan(file: &str, topic: &str, threads: usize) -> Result<serde_json::Value, Box<dyn Error>> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(threads)
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let start = Instant::now();
        let context =
            SessionContext::new_with_config(SessionConfig::new().with_target_partitions(threads));
        let dataset = Dataset::open(&context.runtime_env(), &[file.to_owned()], None).await?;
        dataset.register(&context)?;
        let table = context.table(TableReference::bare(topic)).await?;
        let streams = table.execute_stream_partitioned().await?;
        let read = streams.into_iter().map(|mut stream| {
            tokio::spawn(async move {
                let (mut rows, mut bytes) = (0, 0);
                while let Some(batch) = stream.next().await {
                    let batch = batch?;
                    rows += batch.num_rows();
                    bytes += batch.get_array_memory_size();
                }
                Ok::<_, DataFusionError>((rows, bytes))
            })
        });
        let (mut rows, mut bytes) = (0, 0);
        for read in read.collect::<Vec<_>>() {
            let (more_rows, more_bytes) = read.await??;
            rows += more_rows;
            bytes += more_bytes;
        }
        Ok(json!({ "rows": rows, "bytes": bytes, "seconds": start.elapsed().as_secs_f64() }))
    })
}

fn raw(file: &str) -> Result<serde_json::Value, Box<dyn Error>> {
    let start = Instant::now();
    let data = std::fs::read(file)?;
    let summary = mcap::Summary::read(&data)?.ok_or("the file has no summary")?;
    let mut bytes = 0;
    for chunk in &summary.chunk_indexes {
        let begin = usize::try_from(chunk.compressed_data_offset()?)?;
        let end = begin + usize::try_from(chunk.compressed_size)?;
        let packed = data
            .get(begin..end)
            .ok_or("a chunk lies outside the file")?;
        let size = usize::try_from(chunk.uncompressed_size)?;
        bytes += match chunk.compression.as_str() {
            "zstd" => zstd::bulk::decompress(packed, size)?.len(),
            _ => packed.len(),
        };
    }
    Ok(json!({ "bytes": bytes, "seconds": start.elapsed().as_secs_f64() }))
}
