//! A map as its readers see it: layers as tables, versions, what changed between two, what may be forgotten.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use arrow::row::{RowConverter, SortField};
use datafusion::common::TableReference;
use datafusion::prelude::{ParquetReadOptions, SessionContext};
use evermap_contract::Registry;
use evermap_schemas::{Fault, LayerRow, batch, record};
use futures::StreamExt;
use serde::Serialize;

use crate::build::read_artifacts;
use crate::error::fault_of;
use crate::run::RunResult;
use crate::sql::{Limits, context};
use crate::store::Store;
use crate::unit::Receipt;
use crate::version::{StoredLayer, Version};

record! {
    /// How one unit of one run went.
    pub struct RunRow {
        /// Version that the run ended at.
        version: u64,
        /// Name of the run; runs of one version are told apart by it.
        run: String,
        /// Step that the unit belongs to.
        step: String,
        /// Session that the unit covered; null where it covered more.
        session: Option<String>,
        /// Site that the unit covered; null where it covered the map.
        site: Option<String>,
        /// Whether the work had been done before.
        cached: bool,
        /// Rows that came out.
        rows: u64,
        /// Bytes that came out.
        bytes: u64 ["B"],
        /// How long it took, when it was done.
        seconds: f64 ["s"],
        /// When it was done.
        started: evermap_schemas::Stamp ["ns"],
        /// Inputs that were skipped or lost.
        lost: u64,
        /// Digest of what the work depends on.
        recipe: String,
        /// Digest of what came out.
        content: String,
    }
}
impl LayerRow for RunRow {
    const NAME: &'static str = "runs";
    const DOC: &'static str = "How one unit of one run went.";
    const KEY: &'static [&'static str] = &["version", "run", "step", "site", "session"];
}

record! {
    /// One layer of one version.
    pub struct LayerInfo {
        /// Layer name.
        layer: String,
        /// Rows in it.
        rows: u64,
        /// Bytes in it.
        bytes: u64 ["B"],
        /// Files that hold it.
        artifacts: u32,
        /// Operator that made it; null for a query.
        operator: Option<String>,
        /// One digest for all its rows.
        digest: String,
    }
}
impl LayerRow for LayerInfo {
    const NAME: &'static str = "layers";
    const DOC: &'static str = "One layer of one version.";
    const KEY: &'static [&'static str] = &["layer"];
}

record! {
    /// One version of a map.
    pub struct VersionInfo {
        /// Counted from 1.
        version: u64,
        /// When it was published, RFC 3339.
        published: String,
        /// Plan that made it.
        plan: String,
        /// Sessions that it is made from.
        sessions: Vec<String>,
        /// Layers in it.
        layers: u32,
        /// Inputs that were skipped or lost on the way.
        lost: u64,
    }
}
impl LayerRow for VersionInfo {
    const NAME: &'static str = "versions";
    const DOC: &'static str = "One version of a map.";
    const KEY: &'static [&'static str] = &["version"];
}

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
    table: Arc<dyn datafusion::catalog::TableProvider>,
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

/// Appends a run to the `runs` layer.
///
/// # Errors
/// A resource fault when the store does not take it.
pub async fn record_run(store: &Store, result: &RunResult) -> Result<(), Fault> {
    let run = uuid::Uuid::new_v4().to_string();
    let rows = result
        .units
        .iter()
        .map(|(step, receipt, cached)| run_row(result, &run, step, receipt, *cached));
    let table = batch(rows.collect::<Vec<_>>())?;
    let mut file = Vec::new();
    let write = |file: &mut Vec<u8>| -> parquet::errors::Result<()> {
        let mut writer = parquet::arrow::ArrowWriter::try_new(file, table.schema(), None)?;
        writer.write(&table)?;
        writer.close().map(drop)
    };
    write(&mut file).map_err(|error| Fault::bug(error.to_string()))?;
    let name = format!("runs/{:06}-{run}.parquet", result.version.version);
    let put =
        object_store::ObjectStoreExt::put(&store.objects(), &store.path(&name), file.into()).await;
    put.map(drop)
        .map_err(|error| crate::error::store_fault(&error, &name))
}

fn run_row(result: &RunResult, run: &str, step: &str, receipt: &Receipt, cached: bool) -> RunRow {
    RunRow {
        version: result.version.version,
        run: run.to_owned(),
        step: step.to_owned(),
        session: receipt.artifact.session.clone(),
        site: receipt.artifact.site.clone(),
        cached,
        rows: receipt.artifact.rows,
        bytes: receipt.artifact.bytes,
        seconds: receipt.seconds,
        started: evermap_schemas::Stamp(receipt.started),
        lost: receipt
            .skipped
            .values()
            .chain(receipt.log_losses.values())
            .sum(),
        recipe: receipt.digest.clone(),
        content: receipt.artifact.content.clone(),
    }
}

/// What became of one layer between two versions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LayerDiff {
    /// Layer name.
    pub layer: String,
    /// Rows whose key is new.
    pub added: u64,
    /// Rows whose key is gone.
    pub removed: u64,
    /// Rows whose key is in both, with other content.
    pub changed: u64,
    /// Rows that are the same.
    pub same: u64,
}

/// Compares two versions, layer by layer. Rows are matched by the key of the operator's layer; rows of a query, which
/// have no key, are only added or removed.
///
/// # Errors
/// When an artifact is missing.
pub async fn diff(
    store: &Store,
    before: &Version,
    after: &Version,
    registry: &Registry,
) -> Result<Vec<LayerDiff>, Fault> {
    let published = |version: &Version| -> BTreeSet<String> {
        version
            .layers
            .iter()
            .filter(|(_, layer)| layer.published)
            .map(|(name, _)| name.clone())
            .collect()
    };
    let mut diffs = Vec::new();
    for layer in published(before).union(&published(after)) {
        let (old, new) = (before.layers.get(layer), after.layers.get(layer));
        diffs.push(diff_layer(store, layer, old, new, registry).await?);
    }
    Ok(diffs)
}

async fn diff_layer(
    store: &Store,
    name: &str,
    old: Option<&StoredLayer>,
    new: Option<&StoredLayer>,
    registry: &Registry,
) -> Result<LayerDiff, Fault> {
    let mut diff = LayerDiff {
        layer: name.to_owned(),
        added: 0,
        removed: 0,
        changed: 0,
        same: 0,
    };
    if let (Some(old), Some(new)) = (old, new)
        && old.digest() == new.digest()
    {
        diff.same = new.rows();
        return Ok(diff);
    }
    let key = [new, old]
        .into_iter()
        .flatten()
        .find_map(|layer| registry.get(layer.op.as_deref()?).ok());
    let key: &[&str] = key.map_or(&[], |entry| entry.output.key);
    let (mut before, after) = (
        digests(store, old, key).await?,
        digests(store, new, key).await?,
    );
    for (row, content) in after {
        match before.remove(&row) {
            None => diff.added += content.1,
            Some(held) if held.0 == content.0 => {
                diff.same += held.1.min(content.1);
                diff.added += content.1.saturating_sub(held.1);
                diff.removed += held.1.saturating_sub(content.1);
            }
            Some(_) => diff.changed += 1,
        }
    }
    diff.removed += before.into_values().map(|(_, count)| count).sum::<u64>();
    Ok(diff)
}

type RowDigests = BTreeMap<Vec<u8>, (blake3::Hash, u64)>;

/// The digest and the number of rows with each key; the whole row is the key where there is none.
async fn digests(
    store: &Store,
    layer: Option<&StoredLayer>,
    key: &[&str],
) -> Result<RowDigests, Fault> {
    let mut found = RowDigests::new();
    let Some(layer) = layer else { return Ok(found) };
    let context = context(Limits {
        partitions: 1,
        ..Limits::default()
    })?;
    context.register_object_store(store.url(), store.objects());
    let frame = read_artifacts(&context, store, &layer.artifacts).await?;
    let mut stream = frame
        .execute_stream()
        .await
        .map_err(|error| fault_of(&error))?;
    while let Some(batch) = stream.next().await {
        let batch = batch.map_err(|error| fault_of(&error))?;
        let whole = row_bytes(&batch, &batch.schema(), None)?;
        let keys = if key.is_empty() {
            whole.clone()
        } else {
            row_bytes(&batch, &batch.schema(), Some(key))?
        };
        for (key, whole) in keys.into_iter().zip(whole) {
            found
                .entry(key)
                .or_insert_with(|| (blake3::hash(&whole), 0))
                .1 += 1;
        }
    }
    Ok(found)
}

fn row_bytes(
    batch: &RecordBatch,
    schema: &SchemaRef,
    only: Option<&[&str]>,
) -> Result<Vec<Vec<u8>>, Fault> {
    let kept: Vec<usize> = (0..schema.fields().len())
        .filter(|&index| {
            only.is_none_or(|only| only.contains(&schema.field(index).name().as_str()))
        })
        .collect();
    let fields = kept
        .iter()
        .map(|&index| SortField::new(schema.field(index).data_type().clone()))
        .collect();
    let columns: Vec<_> = kept
        .iter()
        .map(|&index| Arc::clone(batch.column(index)))
        .collect();
    let rows = RowConverter::new(fields)?.convert_columns(&columns)?;
    Ok(rows.iter().map(|row| row.as_ref().to_vec()).collect())
}

/// What [`gc`] removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Collected {
    /// Versions forgotten.
    pub versions: u64,
    /// Files removed: artifacts, receipts, leftovers of killed runs.
    pub files: u64,
    /// Bytes given back.
    pub bytes: u64,
}

/// Forgets all but the newest `keep` versions, and every file that none of those needs. Must not run beside a run.
///
/// # Errors
/// A user fault for `keep` 0, a resource fault when the store does not do it.
pub async fn gc(store: &Store, keep: usize, dry: bool) -> Result<Collected, Fault> {
    if keep == 0 {
        return Err(Fault::user("a map keeps at least one version").next("use --keep 1 or more"));
    }
    let numbers = Version::numbers(store).await?;
    let (forgotten, kept) = numbers.split_at(numbers.len().saturating_sub(keep));
    let (mut needed, mut logs) = (BTreeSet::new(), BTreeSet::new());
    for &number in kept {
        let version = Version::read(store, number).await?;
        // What `previous` meant is kept too: the version can then be made again.
        let previous = version.previous.layers.values().flatten();
        needed.extend(previous.map(crate::unit::Artifact::name));
        logs.extend(
            version
                .sessions
                .into_iter()
                .map(|session| session.log.content),
        );
        for layer in version.layers.values() {
            needed.extend(layer.artifacts.iter().map(crate::unit::Artifact::name));
            needed.extend(layer.recipes.iter().map(|digest| Receipt::name(digest)));
        }
    }
    needed.extend(crate::fingerprint::names_of(store, &logs).await?);
    let mut collected = Collected::default();
    for number in forgotten {
        collected.versions += 1;
        if !dry {
            store.remove(&format!("versions/{number}.json")).await?;
        }
    }
    for folder in ["receipts", "artifacts", crate::fingerprint::FOLDER, "tmp"] {
        for (name, bytes) in store.list(folder).await? {
            if !needed.contains(&name) {
                collected.files += 1;
                collected.bytes += bytes;
                if !dry {
                    store.remove(&name).await?;
                }
            }
        }
    }
    Ok(collected)
}
