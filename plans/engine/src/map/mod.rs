//! A map as its readers see it: layers as tables, versions, what changed between two, what may be forgotten.

pub mod artifact;
mod catalog;
pub mod damage;
mod diff;
mod flat;
mod gc;
pub mod lease;
mod lineage;
mod local;
mod logs;
pub mod newest;
mod parts;
pub mod receipt;
mod rows;
pub mod sound;
pub mod store;
mod table_function;
pub mod tables;
mod verify;
pub mod version;

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::RecordBatch;
use datafusion::catalog::{CatalogProvider, MemoryCatalogProvider};
use datafusion::execution::runtime_env::RuntimeEnv;
use datafusion::prelude::SessionContext;
use evermap_contract::Registry;
use evermap_datasets::Dataset;
use evermap_schemas::{Fault, Kind, LayerRow};
use tokio::sync::Mutex;
use url::Url;

use crate::error::OrFault;
use crate::fingerprint::open_mapped;
use crate::map::artifact::read_in_order;
use crate::map::catalog::Catalog;
use crate::map::damage::Damage;
use crate::map::diff::DiffFunction;
use crate::map::lineage::LineageFunction;
use crate::map::receipt::Artifact;
use crate::map::sound::Sound;
use crate::map::store::{Store, each};
use crate::map::tables::Tables;
use crate::map::version::{MappedSession, StoredLayer, Version};
use crate::sql::{TABLES, Unlisted, catalog, catalog_name};

pub use diff::{Comparison, LayerDiff, documentation as diff_documentation};
pub use gc::{Collected, gc};
pub use lineage::{Origin, documentation as lineage_documentation, lineage};
pub(crate) use rows::RUNS;
pub use rows::{LayerFile, LayerInfo, RunRow, VersionInfo};
pub use verify::{Finding, Verified, verify};

/// A map opened at a version.
#[derive(Debug, Clone)]
pub struct Map {
    /// Where it is kept.
    pub store: Store,
    /// The version.
    pub version: Version,
    /// The logs that were opened, by session.
    logs: Arc<Mutex<BTreeMap<String, Dataset>>>,
}

impl Map {
    /// Opens a map at a version, the newest where none is asked for.
    ///
    /// # Errors
    /// A user fault where there is no map or no such version.
    pub async fn open(address: &str, version: Option<u64>) -> Result<Self, Fault> {
        Self::at(Store::open(address, false)?, version).await
    }

    async fn at(store: Store, version: Option<u64>) -> Result<Self, Fault> {
        let version = match version {
            Some(number) => Version::read(&store, number).await?,
            None => Version::latest(&store).await?.ok_or_else(|| {
                Fault::user(format!("the map at {} has no version yet", store.url()))
                    .next("finish a run of `evermap run`")
            })?,
        };
        Ok(Self::of(store, version))
    }

    /// A version that was read.
    pub fn of(store: Store, version: Version) -> Self {
        Self {
            store,
            version,
            logs: Arc::default(),
        }
    }

    /// What is missing or damaged of the published layers, as far as sizes tell.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn damages(&self) -> Result<Vec<Damage>, Fault> {
        let layers = self.version.published().map(|(_, layer)| layer);
        let artifacts = layers.flat_map(|layer| &layer.artifacts);
        let damages = each(artifacts.map(|artifact| artifact.size_damage(&self.store))).await?;
        Ok(damages.into_iter().flatten().collect())
    }

    /// The published layers.
    pub fn layers(&self) -> Vec<LayerInfo> {
        let published = self.version.published();
        published.map(|(name, layer)| info(name, layer)).collect()
    }

    /// The Parquet files of each published layer, in the order of their rows.
    ///
    /// # Errors
    /// A fault of ours.
    pub fn files(&self) -> Result<Vec<LayerFile>, Fault> {
        let published = self.version.published();
        let files = published
            .flat_map(|(name, layer)| layer.artifacts.iter().map(move |artifact| (name, artifact)));
        files
            .map(|(name, artifact)| {
                Ok(LayerFile {
                    layer: name.clone(),
                    file: place(&self.store.url_of(&artifact.name())?),
                    rows: artifact.rows,
                    bytes: artifact.bytes,
                })
            })
            .collect()
    }

    /// Makes every published layer a table of a new context, those with structs also with columns in their place
    /// (`poses_flat`), beside `layers`, `versions` and `runs`; those of another
    /// version are `v1.lanes`, topics and roles of the log of a session `monday."/odom"`; `diff` compares versions, `lineage` says what rows were made from. A table is opened when a query names it, and then it is that a
    /// missing or damaged artifact shows.
    ///
    /// # Errors
    /// A fault of ours.
    pub fn context(
        &self,
        context: SessionContext,
        registry: &Registry,
    ) -> Result<SessionContext, Fault> {
        context.register_object_store(self.store.url(), self.store.objects());
        let catalog = catalog(&context)?;
        let tables = Arc::new(Tables::new(self.clone(), &context, registry));
        let public = Arc::clone(&tables);
        catalog.register_schema(TABLES, public).or_fault()?;
        let catalog = Arc::new(Catalog::new(catalog, tables));
        context.register_catalog(catalog_name(&context), catalog);
        let sessions = self.version.sessions.iter();
        let logs = sessions
            .map(|session| session.log.session.clone())
            .collect();
        let state = context.state_ref();
        state
            .write()
            .config_mut()
            .set_extension(Arc::new(Unlisted(logs)));
        let diff = DiffFunction {
            map: self.clone(),
            registry: registry.clone(),
            reading: beside(&context),
        };
        context.register_udtf("diff", Arc::new(diff));
        context.register_udtf("lineage", Arc::new(LineageFunction(self.clone())));
        Ok(context)
    }

    /// Puts the map's tables beside those of another one in a context: `name.lanes` in its catalog, and all that this map
    /// has in a catalog of the name, `name.v1.lanes`, `name.monday."/odom"`.
    ///
    /// # Errors
    /// A user fault where the name is taken.
    pub fn join(
        &self,
        name: &str,
        context: &SessionContext,
        registry: &Registry,
    ) -> Result<(), Fault> {
        let beside = catalog(context)?;
        if context.catalog(name).is_some() || beside.schema(name).is_some() {
            return Err(
                Fault::user(format!("`{name}` is the name of several maps or sessions"))
                    .next("give the map another one: --map NAME=DIR"),
            );
        }
        context.register_object_store(self.store.url(), self.store.objects());
        let tables = Arc::new(Tables::new(self.clone(), context, registry));
        let own = MemoryCatalogProvider::new();
        for (catalog, schema) in [
            (&own as &dyn CatalogProvider, TABLES),
            (beside.as_ref(), name),
        ] {
            let public = Arc::clone(&tables);
            catalog.register_schema(schema, public).or_fault()?;
        }
        let catalog = Arc::new(Catalog::new(Arc::new(own), tables));
        context.register_catalog(name, catalog);
        Ok(())
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
        self.published(layer).ok_or_else(|| {
            let known: Vec<_> = self
                .version
                .published()
                .map(|(name, _)| name.as_str())
                .collect();
            let known = known.join(", ");
            Fault::user(format!("no layer {layer} in this map; there are {known}"))
        })?;
        let rows = self.checked(layer).await?;
        let rows = read_in_order(&self.store, rows).await?;
        rows.collect().await.or_fault()
    }

    /// The artifacts of a published layer, which are as they were written as far as [`Sound::check`] tells.
    async fn checked(&self, layer: &str) -> Result<&[Artifact], Fault> {
        let stored = self.published(layer);
        let artifacts = stored.map_or(&[][..], |stored| &stored.artifacts);
        Sound::check(&self.store, &self.version, artifacts).await?;
        Ok(artifacts)
    }

    /// The log of a session, opened once, where it was when it was mapped; `None` for a session that is not in the map.
    ///
    /// # Errors
    /// A user fault for a log that is gone, or as [`Dataset::open`].
    pub async fn log(&self, session: &str, runtime: &RuntimeEnv) -> Result<Option<Dataset>, Fault> {
        let mut logs = self.logs.lock().await;
        if let Some(log) = logs.get(session) {
            return Ok(Some(log.clone()));
        }
        let Some(MappedSession { log, manifest }) = self.session(session) else {
            return Ok(None);
        };
        let log = open_mapped(&self.store, runtime, manifest, log).await?;
        log.register_stores(runtime);
        logs.insert(session.to_owned(), log.clone());
        Ok(Some(log))
    }

    /// The log of a session, where it is open and nobody is just opening one.
    fn open_log(&self, session: &str) -> Option<Dataset> {
        self.logs.try_lock().ok()?.get(session).cloned()
    }

    fn session(&self, name: &str) -> Option<&MappedSession> {
        MappedSession::named(&self.version.sessions, name)
    }

    /// The logs that were opened so far, which know what reading them lost.
    pub async fn logs(&self) -> Vec<Dataset> {
        self.logs.lock().await.values().cloned().collect()
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

/// A context with the settings and limits of another, and without its tables.
fn beside(context: &SessionContext) -> SessionContext {
    SessionContext::new_with_config_rt(context.copied_config(), context.runtime_env())
}

/// A path on this machine, or a URL.
fn place(url: &Url) -> String {
    let path = url.to_file_path().ok();
    path.map_or_else(|| url.to_string(), |path| path.display().to_string())
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

/// The versions of a map, ascending. Those that do not read are told and left out.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn versions(store: &Store) -> Result<Vec<VersionInfo>, Fault> {
    let mut infos = Vec::new();
    for number in Version::numbers(store).await? {
        let version = match Version::read(store, number).await {
            Err(fault) if fault.kind == Kind::Data => {
                tracing::warn!("version {number} is ignored: {fault}");
                continue;
            }
            read => read?,
        };
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
