//! Forgets old versions.

use std::collections::BTreeSet;

use evermap_schemas::Fault;
use serde::Serialize;

use crate::fingerprint;
use crate::map::receipt::{Artifact, Receipt};
use crate::map::store::Store;
use crate::map::version::Version;

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
        needed.extend(previous.map(Artifact::name));
        let sessions = version.sessions.into_iter();
        logs.extend(sessions.map(|session| session.log.content));
        for layer in version.layers.values() {
            needed.extend(layer.artifacts.iter().map(Artifact::name));
            needed.extend(layer.recipes.iter().map(|digest| Receipt::name(digest)));
        }
    }
    needed.extend(fingerprint::names_of(store, &logs).await?);
    let mut collected = Collected::default();
    for number in forgotten {
        collected.versions += 1;
        if !dry {
            store.remove(&format!("versions/{number}.json")).await?;
        }
    }
    for folder in ["receipts", "artifacts", fingerprint::FOLDER, "tmp"] {
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
