//! How the units of a run went, kept as the `runs` layer.

use evermap_schemas::{Fault, Stamp, batch};
use parquet::arrow::ArrowWriter;
use parquet::errors::ParquetError;

use crate::map::store::Store;
use crate::map::{RUNS, RunRow, record_name, record_version};
use crate::run::RunResult;
use crate::run::done::Done;

/// Units whose rows are made at once.
const AT_ONCE: usize = 1024;

/// Appends a run to the `runs` layer, unless it computed and published nothing and there is a record of its version: it would
/// say nothing new.
///
/// # Errors
/// A resource fault when the store does not take it.
pub async fn record_run(store: &Store, result: &RunResult) -> Result<(), Fault> {
    if is_idle(result) && has_record(store, result.version.version).await? {
        return Ok(());
    }
    let run = uuid::Uuid::new_v4().to_string();
    let failed = |error: ParquetError| Fault::bug(error.to_string());
    let schema = batch::<RunRow>(Vec::new())?.schema();
    let mut file = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut file, schema, None).map_err(failed)?;
    for units in result.units.chunks(AT_ONCE) {
        let rows = units.iter();
        let rows = rows.map(|(step, done)| run_row(result, &run, step, done));
        let rows = batch(rows.collect::<Vec<_>>())?;
        writer.write(&rows).map_err(failed)?;
    }
    writer.close().map_err(failed)?;
    let name = record_name(result.version.version, &file);
    store.write(&name, file).await
}

fn is_idle(result: &RunResult) -> bool {
    !result.published && result.units.iter().all(|(_, done)| done.cached)
}

async fn has_record(store: &Store, version: u64) -> Result<bool, Fault> {
    let mut records = store.list(RUNS).await?.into_iter();
    Ok(records.any(|(name, _)| record_version(&name) == Some(version)))
}

fn run_row(result: &RunResult, run: &str, step: &str, done: &Done) -> RunRow {
    RunRow {
        version: result.version.version,
        run: run.to_owned(),
        step: step.to_owned(),
        session: done.artifact.extent.session.clone(),
        site: done.artifact.extent.site.clone(),
        cached: done.cached,
        rows: done.artifact.rows,
        bytes: done.artifact.bytes,
        seconds: done.seconds,
        started: Stamp(done.started),
        lost: done.skipped.values().chain(done.log_losses.values()).sum(),
        recipe: done.digest.clone(),
        content: done.artifact.content.clone(),
        nodes: Some(done.nodes.work()),
    }
}
