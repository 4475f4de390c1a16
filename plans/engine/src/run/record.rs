//! How the units of a run went, kept as the `runs` layer.

use evermap_schemas::{Fault, Stamp, batch};
use parquet::arrow::ArrowWriter;

use crate::map::receipt::Receipt;
use crate::map::store::Store;
use crate::map::{RUNS, RunRow, record_name, record_version};
use crate::run::RunResult;

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
    let rows = result
        .units
        .iter()
        .map(|(step, receipt, cached)| run_row(result, &run, step, receipt, *cached));
    let table = batch(rows.collect::<Vec<_>>())?;
    let mut file = Vec::new();
    let write = |file: &mut Vec<u8>| -> parquet::errors::Result<()> {
        let mut writer = ArrowWriter::try_new(file, table.schema(), None)?;
        writer.write(&table)?;
        writer.close().map(drop)
    };
    write(&mut file).map_err(|error| Fault::bug(error.to_string()))?;
    let name = record_name(result.version.version, &file);
    store.write(&name, file).await
}

fn is_idle(result: &RunResult) -> bool {
    !result.published && result.units.iter().all(|(_, _, cached)| *cached)
}

async fn has_record(store: &Store, version: u64) -> Result<bool, Fault> {
    let mut records = store.list(RUNS).await?.into_iter();
    Ok(records.any(|(name, _)| record_version(&name) == Some(version)))
}

fn run_row(result: &RunResult, run: &str, step: &str, receipt: &Receipt, cached: bool) -> RunRow {
    RunRow {
        version: result.version.version,
        run: run.to_owned(),
        step: step.to_owned(),
        session: receipt.artifact.extent.session.clone(),
        site: receipt.artifact.extent.site.clone(),
        cached,
        rows: receipt.artifact.rows,
        bytes: receipt.artifact.bytes,
        seconds: receipt.seconds,
        started: Stamp(receipt.started),
        lost: receipt
            .skipped
            .values()
            .chain(receipt.log_losses.values())
            .sum(),
        recipe: receipt.digest.clone(),
        content: receipt.artifact.content.clone(),
        nodes: Some(receipt.nodes.clone()),
    }
}
