//! A map opened at a version: what it has, its rows, its logs.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use arrow::array::RecordBatch;
use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_datasets::Dataset;
use evermap_schemas::{Fault, LayerRow};
use futures::TryStreamExt;
use tokio::sync::Mutex;
use url::Url;

use crate::error::{OrFault, no_map};
use crate::fingerprint::{self, open_mapped, stands};
use crate::map::artifact::read_in_order;
use crate::map::damage::Damage;
use crate::map::receipt::{Artifact, RECEIPTS};
use crate::map::rows::{LayerFile, LayerInfo, VersionInfo};
use crate::map::sound::{Sound, SoundArtifacts};
use crate::map::store::{ARTIFACTS, Store, each};
use crate::map::version::{MappedSession, StoredLayer, Version};
use crate::map::{lease, local};

/// Whether a run has left something in a store.
pub(super) async fn begun(store: &Store) -> Result<bool, Fault> {
    for folder in [fingerprint::FOLDER, RECEIPTS, ARTIFACTS, lease::FOLDER] {
        if !store.objects_in(folder).await?.is_empty() {
            return Ok(true);
        }
    }
    Ok(false)
}

/// That a store has no version: there is no map, or its first run has not ended.
///
/// # Errors
/// A resource fault when the store does not answer.
pub(super) async fn no_version(store: &Store) -> Result<Fault, Fault> {
    let address = address(store);
    if !begun(store).await? {
        return Ok(no_map(&address));
    }
    let fault = Fault::user(format!("the map at {address} has no version yet"));
    Ok(fault.next("finish a run of `evermap run`"))
}

/// Where a store is, as people write it.
pub(super) fn address(store: &Store) -> String {
    match folder(store) {
        Some(folder) => folder.display().to_string(),
        None => store.url().to_string(),
    }
}

fn folder(store: &Store) -> Option<PathBuf> {
    let url = store.url();
    let folder = (url.scheme() == "file").then(|| url.to_file_path().ok());
    // Without the slash at the end of the URL.
    Some(folder.flatten()?.components().collect())
}

/// Makes the folder that a map is to be in, where it is to be in one.
///
/// # Errors
/// A user fault where it cannot be made.
pub(crate) fn make(store: &Store) -> Result<(), Fault> {
    let Some(folder) = folder(store) else {
        return Ok(());
    };
    local::make(&folder).map_err(|error| {
        Fault::user(format!(
            "cannot create a map at {}: {error}",
            folder.display()
        ))
    })
}

/// A map opened at a version.
#[derive(Debug, Clone)]
pub struct Map {
    /// Where it is kept.
    pub store: Store,
    /// The version.
    pub version: Version,
    /// The logs that were opened, by session.
    logs: Arc<Mutex<BTreeMap<String, Dataset>>>,
    /// The artifacts that were read and found right.
    known: Arc<SoundArtifacts>,
}

impl Map {
    /// Opens a map at a version, the newest where none is asked for.
    ///
    /// # Errors
    /// A user fault where there is no map or no such version.
    pub async fn open(address: &str, version: Option<u64>) -> Result<Self, Fault> {
        Self::at(Store::open(address, false)?, version).await
    }

    pub(super) async fn at(store: Store, version: Option<u64>) -> Result<Self, Fault> {
        let version = match version {
            Some(number) => Some(Version::read(&store, number).await?),
            None => Version::latest(&store).await?,
        };
        match version {
            Some(version) => Ok(Self::of(store, version)),
            None => Err(no_version(&store).await?),
        }
    }

    /// A version that was read.
    pub fn of(store: Store, version: Version) -> Self {
        Self {
            store,
            version,
            logs: Arc::default(),
            known: Arc::default(),
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
            let known = self.version.published_names().join(", ");
            Fault::user(format!("no layer {layer} in this map; there are {known}"))
        })?;
        let rows = self.checked(layer).await?;
        let rows = read_in_order(&self.store, rows).await?;
        rows.collect().await.or_fault()
    }

    /// The artifacts of a published layer.
    pub(super) fn artifacts(&self, layer: &str) -> &[Artifact] {
        let stored = self.published(layer);
        stored.map_or(&[][..], |stored| &stored.artifacts)
    }

    /// The same, which are as they were written as far as [`Sound::check`] tells.
    pub(super) async fn checked(&self, layer: &str) -> Result<&[Artifact], Fault> {
        let artifacts = self.artifacts(layer);
        self.check(artifacts).await?;
        Ok(artifacts)
    }

    /// That artifacts of the version are as they were written as far as [`Sound::check`] tells.
    pub(super) async fn check(&self, artifacts: &[Artifact]) -> Result<(), Fault> {
        let published = &self.version.published;
        Sound::check(&self.store, published, artifacts, &self.known).await
    }

    /// The log of a session, where it was when it was mapped; `None` for a session that is not in the map. It is opened once,
    /// and again where other files are in the place of those that were: what is open reads none of theirs.
    ///
    /// # Errors
    /// A user fault for a log that is gone, or as [`Dataset::open`].
    pub async fn log(&self, session: &str, runtime: &RuntimeEnv) -> Result<Option<Dataset>, Fault> {
        let known = self.logs.lock().await.get(session).cloned();
        if let Some(log) = known
            && stands(&log).await?
        {
            return Ok(Some(log));
        }
        let mut logs = self.logs.lock().await;
        // Somebody else may have opened it meanwhile.
        if let Some(log) = logs.get(session)
            && stands(log).await?
        {
            return Ok(Some(log.clone()));
        }
        let Some(MappedSession { log, manifest, .. }) = self.session(session) else {
            return Ok(None);
        };
        let log = open_mapped(&self.store, runtime, manifest, log).await?;
        log.register_stores(runtime);
        logs.insert(session.to_owned(), log.clone());
        Ok(Some(log))
    }

    /// The log of a session, where it is open and nobody is just opening one.
    pub(super) fn open_log(&self, session: &str) -> Option<Dataset> {
        self.logs.try_lock().ok()?.get(session).cloned()
    }

    pub(super) fn session(&self, name: &str) -> Option<&MappedSession> {
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

    pub(super) fn published(&self, layer: &str) -> Option<&StoredLayer> {
        self.version
            .layers
            .get(layer)
            .filter(|stored| stored.published)
    }
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
    let numbers = Version::numbers(store).await?;
    let mut read = Version::all(store, &numbers);
    while let Some((number, found)) = read.try_next().await? {
        let version = match found {
            Ok(Some((version, _))) => version,
            Ok(None) => continue, // It was forgotten since.
            Err(fault) => {
                tracing::warn!("version {number} is ignored: {fault}");
                continue;
            }
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
