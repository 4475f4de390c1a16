//! The rows of a map's files.

use std::sync::Arc;

use arrow::datatypes::{Schema, SchemaRef};
use datafusion::datasource::physical_plan::parquet::metadata::DFParquetMetadata;
use datafusion::prelude::{DataFrame, ParquetReadOptions, SessionContext};
use evermap_schemas::Fault;

use crate::error::OrFault;
use crate::map::receipt::Artifact;
use crate::map::store::{Store, each};
use crate::sql::{Limits, context};

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

/// The columns of an artifact as its file describes them, with units and frames. What reads its rows leaves these out.
///
/// # Errors
/// As [`read_files`].
pub async fn described(
    context: &SessionContext,
    store: &Store,
    artifact: &Artifact,
) -> Result<SchemaRef, Fault> {
    let url = store.url_of(&artifact.name())?.to_string();
    let options = ParquetReadOptions::default().skip_metadata(false);
    let rows = context.read_parquet(url, options).await.or_fault()?;
    Ok(Arc::clone(rows.schema().inner()))
}

/// The columns of an artifact with what its file says of itself: its end alone is read.
///
/// # Errors
/// A data fault for a file that is no Parquet.
pub async fn columns_of(store: &Store, artifact: &Artifact) -> Result<SchemaRef, Fault> {
    let name = artifact.name();
    let missing = || Fault::data("expected a file, found nothing").at(name.clone());
    let meta = store.meta(&name).await?.ok_or_else(missing)?;
    let objects = store.objects();
    let end = DFParquetMetadata::new(objects.as_ref(), &meta);
    let read = end.fetch_schema().await;
    let read = read.map_err(|error| Fault::data(error.to_string()).at(name))?;
    Ok(Arc::new(read))
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
