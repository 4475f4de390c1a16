//! A map as its readers see it: layers as tables, versions, what changed between two, what may be forgotten.

pub mod artifact;
mod diff;
mod gc;
pub mod receipt;
mod rows;
pub mod store;
pub mod version;

use std::sync::Arc;

use arrow::array::RecordBatch;
use datafusion::catalog::TableProvider;
use datafusion::common::TableReference;
use datafusion::prelude::{ParquetReadOptions, SessionContext};
use evermap_schemas::{Fault, LayerRow, batch};

use crate::error::fault_of;
use crate::map::artifact::read_artifacts;
use crate::map::store::Store;
use crate::map::version::{StoredLayer, Version};
use crate::sql::{Limits, context};

pub use diff::{LayerDiff, diff};
pub use gc::{Collected, gc};
pub use rows::{LayerInfo, RunRow, VersionInfo};

/// A map opened at a version.
#[derive(Debug, Clone)]
pub struct Map {
    /// Where it is kept.
    pub store: Store,
    /// The version.
    pub version: Version,
}

impl Map {
    /// Opens a map at a version, the newest where none is asked for.
    ///
    /// # Errors
    /// A user fault where there is no map or no such version.
    pub async fn open(address: &str, version: Option<u64>) -> Result<Self, Fault> {
        let store = Store::open(address, false)?;
        let version = match version {
            Some(number) => Version::read(&store, number).await?,
            None => Version::latest(&store).await?.ok_or_else(|| {
                Fault::user(format!("the map at {address} has no version yet"))
                    .next("finish a run of `evermap run`")
            })?,
        };
        Ok(Self { store, version })
    }

    /// The published layers.
    pub fn layers(&self) -> Vec<LayerInfo> {
        let published = self
            .version
            .layers
            .iter()
            .filter(|(_, layer)| layer.published);
        published.map(|(name, layer)| info(name, layer)).collect()
    }

    /// A context in which every published layer is a table, beside `layers`, `versions` and `runs`.
    ///
    /// # Errors
    /// When an artifact is missing.
    pub async fn context(&self, limits: Limits) -> Result<SessionContext, Fault> {
        let context = context(limits)?;
        context.register_object_store(self.store.url(), self.store.objects());
        for (name, layer) in self
            .version
            .layers
            .iter()
            .filter(|(_, layer)| layer.published)
        {
            let frame = read_artifacts(&context, &self.store, &layer.artifacts).await?;
            register(&context, name, frame.into_view())?;
        }
        register_rows(&context, "layers", self.layers())?;
        register_rows(&context, "versions", versions(&self.store).await?)?;
        self.register_runs(&context).await?;
        Ok(context)
    }

    async fn register_runs(&self, context: &SessionContext) -> Result<(), Fault> {
        let files = self.store.list("runs").await?;
        if files.is_empty() {
            return register_rows::<RunRow>(context, "runs", Vec::new());
        }
        let urls = files
            .iter()
            .map(|(name, _)| Ok(self.store.url_of(name)?.to_string()));
        let urls = urls.collect::<Result<Vec<_>, Fault>>()?;
        let frame = context
            .read_parquet(urls, ParquetReadOptions::default())
            .await
            .map_err(|error| fault_of(&error))?;
        register(context, "runs", frame.into_view())
    }

    /// All rows of a layer, in the order of its key within each artifact.
    ///
    /// # Errors
    /// A user fault that names the layers there are.
    pub async fn rows<T: LayerRow>(&self, layer: &str) -> Result<Vec<T>, Fault> {
        let mut rows = Vec::new();
        for batch in self.batches(layer).await? {
            rows.extend(
                evermap_schemas::rows::<T>(&batch)
                    .map_err(|fault| fault.at(format!("layer {layer}")))?,
            );
        }
        Ok(rows)
    }

    /// All rows of a layer as batches.
    ///
    /// # Errors
    /// As [`Map::rows`].
    pub async fn batches(&self, layer: &str) -> Result<Vec<RecordBatch>, Fault> {
        let stored = self
            .version
            .layers
            .get(layer)
            .filter(|stored| stored.published)
            .ok_or_else(|| {
                let known: Vec<_> = self.layers().into_iter().map(|info| info.layer).collect();
                Fault::user(format!(
                    "no layer {layer} in this map; there are {}",
                    known.join(", ")
                ))
            })?;
        let context = context(Limits {
            partitions: 1,
            ..Limits::default()
        })?;
        context.register_object_store(self.store.url(), self.store.objects());
        let frame = read_artifacts(&context, &self.store, &stored.artifacts).await?;
        frame.collect().await.map_err(|error| fault_of(&error))
    }

    /// Whether the version has the layer.
    pub fn has(&self, layer: &str) -> bool {
        self.version
            .layers
            .get(layer)
            .is_some_and(|stored| stored.published)
    }
}

fn info(name: &str, layer: &StoredLayer) -> LayerInfo {
    LayerInfo {
        layer: name.to_owned(),
        rows: layer.rows(),
        bytes: layer.bytes(),
        artifacts: layer.artifacts.len() as u32,
        operator: layer.op.clone(),
        digest: layer.digest(),
    }
}

fn register(
    context: &SessionContext,
    name: &str,
    table: Arc<dyn TableProvider>,
) -> Result<(), Fault> {
    context
        .register_table(TableReference::bare(name), table)
        .map(drop)
        .map_err(|error| fault_of(&error))
}

fn register_rows<T: LayerRow>(
    context: &SessionContext,
    name: &str,
    rows: Vec<T>,
) -> Result<(), Fault> {
    context
        .register_batch(name, batch(rows)?)
        .map(drop)
        .map_err(|error| fault_of(&error))
}

/// The versions of a map, ascending.
///
/// # Errors
/// As [`Version::read`].
pub async fn versions(store: &Store) -> Result<Vec<VersionInfo>, Fault> {
    let mut infos = Vec::new();
    for number in Version::numbers(store).await? {
        let version = Version::read(store, number).await?;
        infos.push(VersionInfo {
            version: version.version,
            published: version.published,
            plan: version.plan,
            sessions: version
                .sessions
                .iter()
                .map(|session| session.log.session.clone())
                .collect(),
            layers: version
                .layers
                .values()
                .filter(|layer| layer.published)
                .count() as u32,
            lost: version.losses.values().sum(),
        });
    }
    Ok(infos)
}
