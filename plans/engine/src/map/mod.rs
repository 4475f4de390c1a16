//! A map as its readers see it: layers as tables, versions, what changed between two, what may be forgotten.

pub mod artifact;
mod diff;
mod gc;
pub mod receipt;
mod rows;
pub mod store;
pub mod version;

use arrow::array::RecordBatch;
use datafusion::common::TableReference;
use datafusion::execution::runtime_env::RuntimeEnv;
use datafusion::prelude::{DataFrame, SessionContext};
use evermap_datasets::Dataset;
use evermap_schemas::{Fault, LayerRow, batch};

use crate::error::OrFault;
use crate::fingerprint::open_mapped;
use crate::map::artifact::{read_artifacts, read_files, read_in_order};
use crate::map::store::Store;
use crate::map::version::{MappedSession, StoredLayer, Version};
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
        let published = self.version.published();
        published.map(|(name, layer)| info(name, layer)).collect()
    }

    /// A context in which every published layer is a table, beside `layers`, `versions` and `runs`.
    ///
    /// # Errors
    /// When an artifact is missing.
    pub async fn context(&self, limits: Limits) -> Result<SessionContext, Fault> {
        let (context, store) = (context(limits)?, &self.store);
        context.register_object_store(store.url(), store.objects());
        let register = |name: &str, rows: DataFrame| {
            let registered = context.register_table(TableReference::bare(name), rows.into_view());
            registered.map(drop).or_fault()
        };
        for (name, layer) in self.version.published() {
            register(
                name,
                read_artifacts(&context, store, &layer.artifacts).await?,
            )?;
        }
        let layers = context.read_batch(batch(self.layers())?);
        register("layers", layers.or_fault()?)?;
        let versions = context.read_batch(batch(versions(store).await?)?);
        register("versions", versions.or_fault()?)?;
        let files = store.list("runs").await?.into_iter().map(|(name, _)| name);
        let runs = if files.len() == 0 {
            context
                .read_batch(batch::<RunRow>(Vec::new())?)
                .or_fault()?
        } else {
            read_files(&context, store, files).await?
        };
        register("runs", runs)?;
        Ok(context)
    }

    /// All rows of a layer, in the order of its key within each artifact.
    ///
    /// # Errors
    /// A user fault that names the layers there are.
    pub async fn rows<T: LayerRow>(&self, layer: &str) -> Result<Vec<T>, Fault> {
        let mut rows = Vec::new();
        for batch in self.batches(layer).await? {
            let more = evermap_schemas::rows::<T>(&batch);
            rows.extend(more.map_err(|fault| fault.at(format!("layer {layer}")))?);
        }
        Ok(rows)
    }

    /// All rows of a layer as batches.
    ///
    /// # Errors
    /// As [`Map::rows`].
    pub async fn batches(&self, layer: &str) -> Result<Vec<RecordBatch>, Fault> {
        let stored = self.published(layer).ok_or_else(|| {
            let known: Vec<_> = self
                .version
                .published()
                .map(|(name, _)| name.as_str())
                .collect();
            let known = known.join(", ");
            Fault::user(format!("no layer {layer} in this map; there are {known}"))
        })?;
        let rows = read_in_order(&self.store, &stored.artifacts).await?;
        rows.collect().await.or_fault()
    }

    /// The log of a session, opened where it was when it was mapped; `None` for a session that is not in the map.
    ///
    /// # Errors
    /// A user fault for a log that is gone, or as [`Dataset::open`].
    pub async fn log(&self, session: &str, runtime: &RuntimeEnv) -> Result<Option<Dataset>, Fault> {
        let mut sessions = self.version.sessions.iter();
        match sessions.find(|mapped| mapped.log.session == session) {
            Some(MappedSession { log, manifest }) => Ok(Some(
                open_mapped(&self.store, runtime, manifest, log).await?,
            )),
            None => Ok(None),
        }
    }

    /// Whether the version has the layer.
    pub fn has(&self, layer: &str) -> bool {
        self.published(layer).is_some()
    }

    fn published(&self, layer: &str) -> Option<&StoredLayer> {
        self.version
            .layers
            .get(layer)
            .filter(|stored| stored.published)
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

/// The versions of a map, ascending.
///
/// # Errors
/// As [`Version::read`].
pub async fn versions(store: &Store) -> Result<Vec<VersionInfo>, Fault> {
    let mut infos = Vec::new();
    for number in Version::numbers(store).await? {
        let version = Version::read(store, number).await?;
        let sessions = version.sessions.iter();
        infos.push(VersionInfo {
            layers: version.published().count() as u32,
            sessions: sessions
                .map(|session| session.log.session.clone())
                .collect(),
            lost: version.losses.values().sum(),
            version: version.version,
            published: version.published,
            plan: version.plan,
        });
    }
    Ok(infos)
}
