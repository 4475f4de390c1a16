//! The rows of a map's files.

use datafusion::prelude::{DataFrame, ParquetReadOptions, SessionContext};
use evermap_schemas::Fault;

use crate::error::fault_of;
use crate::map::receipt::Artifact;
use crate::map::store::Store;

/// The rows of artifacts, as one table.
///
/// # Errors
/// When a file is missing or is no Parquet.
pub async fn read_artifacts(
    context: &SessionContext,
    store: &Store,
    artifacts: &[Artifact],
) -> Result<DataFrame, Fault> {
    let mut urls = artifacts
        .iter()
        .map(|artifact| Ok(store.url_of(&artifact.name())?.to_string()))
        .collect::<Result<Vec<_>, Fault>>()?;
    urls.sort();
    urls.dedup();
    context
        .read_parquet(urls, ParquetReadOptions::default())
        .await
        .map_err(|error| fault_of(&error))
}
