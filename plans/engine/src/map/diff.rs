//! What changed between two versions.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::row::{RowConverter, SortField};
use evermap_contract::Registry;
use evermap_schemas::{Fault, record};
use futures::StreamExt;

use crate::error::OrFault;
use crate::map::artifact::read_in_order;
use crate::map::store::Store;
use crate::map::version::{StoredLayer, Version};

record! {
    /// What became of one layer between two versions.
    #[layer("changes", key(layer))]
    pub struct LayerDiff {
        /// Layer.
        layer: String,
        /// Rows whose key is new.
        added: u64,
        /// Rows whose key is gone.
        removed: u64,
        /// Rows whose key is in both, with other content.
        changed: u64,
        /// Rows that are the same.
        same: u64,
    }
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
    let mut names: BTreeSet<&String> = before.published().map(|(name, _)| name).collect();
    names.extend(after.published().map(|(name, _)| name));
    let mut diffs = Vec::new();
    for layer in names {
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
    let made = new.or(old).and_then(|layer| layer.op.as_deref());
    let made = made.and_then(|op| registry.get(op).ok());
    let key: &[&str] = made.map_or(&[], |entry| entry.output.key);
    let mut before = digests(store, old, key).await?;
    for (row, content) in digests(store, new, key).await? {
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
    let rows = read_in_order(store, &layer.artifacts).await?;
    let mut stream = rows.execute_stream().await.or_fault()?;
    while let Some(batch) = stream.next().await {
        let batch = batch.or_fault()?;
        let whole = row_bytes(&batch, &[])?;
        for (key, whole) in row_bytes(&batch, key)?.into_iter().zip(whole) {
            let held = found.entry(key);
            held.or_insert_with(|| (blake3::hash(&whole), 0)).1 += 1;
        }
    }
    Ok(found)
}

/// Each row's values of these columns as bytes that compare; of all columns where none are named.
fn row_bytes(batch: &RecordBatch, names: &[&str]) -> Result<Vec<Vec<u8>>, Fault> {
    let fields = batch.schema_ref().fields().iter().zip(batch.columns());
    let (fields, columns): (Vec<_>, Vec<_>) = fields
        .filter(|(field, _)| names.is_empty() || names.contains(&field.name().as_str()))
        .map(|(field, column)| {
            (
                SortField::new(field.data_type().clone()),
                Arc::clone(column),
            )
        })
        .unzip();
    let rows = RowConverter::new(fields)?.convert_columns(&columns)?;
    Ok(rows.iter().map(|row| row.as_ref().to_vec()).collect())
}
