//! The rows of a map's files.

use arrow::datatypes::Schema;
use datafusion::prelude::{DataFrame, ParquetReadOptions, SessionContext};
use evermap_schemas::Fault;
use object_store::ObjectStoreExt;

use crate::error::OrFault;
use crate::map::receipt::Artifact;
use crate::map::store::{Store, each};
use crate::sql::{Limits, context};

/// The last bytes of a Parquet file that was written to its end: how long its metadata is, and `PAR1`.
const PARQUET_END: usize = 8;

/// The rows of some Parquet files of a map, as one table: of this schema, or, where none is given, of the files' own.
///
/// # Errors
/// When a file is missing or is no Parquet.
pub async fn read_files(
    context: &SessionContext,
    store: &Store,
    names: impl IntoIterator<Item = String>,
    schema: Option<&Schema>,
) -> Result<DataFrame, Fault> {
    let urls = names
        .into_iter()
        .map(|name| Ok(store.url_of(&name)?.to_string()));
    let mut urls = urls.collect::<Result<Vec<_>, Fault>>()?;
    urls.sort();
    urls.dedup();
    let options = ParquetReadOptions {
        schema,
        ..ParquetReadOptions::default()
    };
    context.read_parquet(urls, options).await.or_fault()
}

/// Whether a Parquet file was written to its end.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn is_whole(store: &Store, name: &str, bytes: u64) -> Result<bool, Fault> {
    let Some(end) = bytes.checked_sub(PARQUET_END as u64) else {
        return Ok(false);
    };
    let path = store.path(name);
    let found = store.objects().get_range(&path, end..bytes).await;
    let found = found.map_err(|error| crate::error::store_fault(&error, name))?;
    let Some((length, mark)) = found.split_first_chunk::<4>() else {
        return Ok(false);
    };
    // What reads Parquet believes the length of what lies before these bytes.
    Ok(mark == b"PAR1" && u64::from(u32::from_le_bytes(*length)) <= end)
}

/// The rows of artifacts, as one table.
///
/// # Errors
/// As [`read_files`], and a data fault where one is missing or not as large as it was written.
pub async fn read_artifacts(
    context: &SessionContext,
    store: &Store,
    artifacts: &[Artifact],
) -> Result<DataFrame, Fault> {
    let damages = artifacts.iter().map(|artifact| artifact.size_damage(store));
    if let Some(damage) = each(damages).await?.into_iter().flatten().next() {
        return Err(damage.into());
    }
    read_files(context, store, artifacts.iter().map(Artifact::name), None).await
}

/// The rows of artifacts in the order that they are kept in.
///
/// # Errors
/// As [`read_files`].
pub async fn read_in_order(store: &Store, artifacts: &[Artifact]) -> Result<DataFrame, Fault> {
    let context = context(Limits::one_partition())?;
    context.register_object_store(store.url(), store.objects());
    read_files(&context, store, artifacts.iter().map(Artifact::name), None).await
}
