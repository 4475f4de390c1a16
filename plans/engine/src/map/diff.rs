//! What changed between two versions.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use arrow::row::{RowConverter, SortField};
use evermap_contract::Registry;
use evermap_schemas::Fault;
use futures::StreamExt;
use serde::Serialize;

use crate::error::fault_of;
use crate::map::artifact::read_artifacts;
use crate::map::store::Store;
use crate::map::version::{StoredLayer, Version};
use crate::sql::{Limits, context};

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
