//! Forgets old versions.

use std::collections::BTreeSet;

use evermap_schemas::Fault;
use futures::TryStreamExt;
use serde::Serialize;

use crate::fingerprint;
use crate::map::lease::{self, Lease};
use crate::map::newest;
use crate::map::opened::no_version;
use crate::map::parts::PARTS;
use crate::map::receipt::{Artifact, RECEIPTS, Receipt};
use crate::map::records::record_version;
use crate::map::rows::RUNS;
use crate::map::sound::Sound;
use crate::map::store::{ARTIFACTS, Store};
use crate::map::unread::Unread;
use crate::map::version::Version;

/// What [`gc`] removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Collected {
    /// Versions forgotten.
    pub versions: u64,
    /// Files removed: artifacts, receipts, records of runs, leftovers of killed runs.
    pub files: u64,
    /// Bytes given back.
    pub bytes: u64,
}

/// Forgets all but the newest `keep` versions, every file that none of those needs, and the records of runs that ended at an
/// older version than they are.
///
/// # Errors
/// A user fault for `keep` 0, and where no version is there that reads: what it needs would not be known, and the folder may be
/// no map; a resource fault beside a run, where the process was suspended so long that a run may have begun,
/// or when the store does not do it.
pub async fn gc(store: &Store, keep: usize, dry: bool) -> Result<Collected, Fault> {
    if keep == 0 {
        return Err(Fault::user("a map keeps at least one version").next("use --keep 1 or more"));
    }
    if Version::numbers(store).await?.is_empty() {
        return Err(no_version(store).await?);
    }
    let lease = match dry {
        true => None,
        false => Some(Lease::of_gc(store).await?),
    };
    let taking = Taking {
        store,
        lease: lease.as_ref(),
    };
    let collected = collect(&taking, keep).await;
    if let Some(lease) = lease {
        lease.end().await;
    }
    collected
}

/// What takes files away as long as its lease holds; without a lease, nothing.
struct Taking<'s> {
    store: &'s Store,
    lease: Option<&'s Lease>,
}

impl Taking<'_> {
    /// Whether files are to be taken.
    ///
    /// # Errors
    /// As [`Lease::holds`].
    fn takes(&self) -> Result<bool, Fault> {
        self.lease.map_or(Ok(false), |lease| {
            lease.holds()?;
            Ok(true)
        })
    }

    async fn take(&self, name: &str) -> Result<(), Fault> {
        match self.takes()? {
            true => self.store.remove(name).await,
            false => Ok(()),
        }
    }
}

async fn collect(taking: &Taking<'_>, keep: usize) -> Result<Collected, Fault> {
    let store = taking.store;
    let mut versions = Vec::new();
    let mut torn = Vec::new();
    let numbers = Version::numbers(store).await?;
    let mut read = Version::all(store, &numbers);
    while let Some((number, found)) = read.try_next().await? {
        match found {
            Ok(found) => versions.extend(found),
            Err(fault) => match Unread::of(store, number, fault).await? {
                Unread::Nobodys => torn.push(Version::name(number)),
                Unread::Kept(fault) => return Err(fault),
            },
        }
    }
    if versions.is_empty() {
        let none = "expected a version that reads, found none: what the map's files are needed for is not known";
        return Err(Fault::user(none)
            .next("publish a version by `evermap run`, or remove the folder by hand"));
    }
    let kept = versions.split_off(versions.len().saturating_sub(keep));
    let forgotten = versions;
    let oldest = kept.first().map(|(version, _)| version.version);
    let (mut needed, mut logs) = (BTreeSet::new(), BTreeSet::new());
    for (version, parts) in kept {
        needed.extend(parts);
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
    for (version, _) in forgotten {
        collected.versions += 1;
        taking.take(&Version::name(version.version)).await?;
    }
    if taking.takes()? {
        Sound::forget_all_but(store, &needed).await?;
        if let Some(oldest) = oldest {
            newest::forget_before(store, oldest).await?;
        }
    }
    let mut left_over: Vec<(String, u64)> = torn.into_iter().map(|name| (name, 0)).collect();
    for folder in [RECEIPTS, ARTIFACTS, PARTS, fingerprint::FOLDER] {
        let listed = store.list(folder).await?.into_iter();
        left_over.extend(listed.filter(|(name, _)| !needed.contains(name)));
    }
    let records = store.list(RUNS).await?.into_iter();
    left_over.extend(records.filter(|(name, _)| is_older(name, oldest)));
    // Those of just now may be of a run that is about to begin or has just ended.
    left_over.extend(store.temporary(lease::TERM).await?);
    for (name, bytes) in left_over {
        collected.files += 1;
        collected.bytes += bytes;
        taking.take(&name).await?;
    }
    Ok(collected)
}

/// Whether a record is of a run that ended at a version before the oldest one that is kept.
fn is_older(record: &str, oldest: Option<u64>) -> bool {
    let version = record_version(record);
    version
        .zip(oldest)
        .is_some_and(|(version, oldest)| version < oldest)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::map::verify::verify;

    #[tokio::test]
    async fn records_of_runs_go_with_the_versions_they_ended_at() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        Version::publish_empty(&store, 3).await;
        let records = ["000001-a", "000002-b", "000003-c", "000004-d", "mine"];
        for record in records.map(|record| format!("{RUNS}/{record}.parquet")) {
            store.write(&record, vec![7]).await.unwrap();
        }
        gc(&store, 2, false).await.unwrap();
        let kept = store.list(RUNS).await.unwrap();
        let kept: Vec<String> = kept.into_iter().map(|(name, _)| name).collect();
        let expected = ["000002-b", "000003-c", "000004-d", "mine"];
        assert_eq!(kept, expected.map(|name| format!("{RUNS}/{name}.parquet")));
    }

    /// A folder of somebody's that is called as one of a map's, and a map whose versions were lost.
    #[tokio::test]
    async fn where_no_version_is_nothing_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let none = gc(&store, 1, false).await.unwrap_err();
        assert!(none.to_string().contains("no map at"), "{none}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let none = verify(&store, None).await.unwrap_err();
        assert!(none.to_string().contains("no map at"), "{none}");
        let rows = Artifact::name_of("rows");
        store.write(&rows, vec![7]).await.unwrap();
        let none = gc(&store, 1, false).await.unwrap_err();
        assert!(none.to_string().contains("has no version yet"), "{none}");
        store.write(&Version::name(1), vec![7]).await.unwrap();
        let torn = gc(&store, 1, false).await.unwrap_err();
        assert!(torn.to_string().contains("found none"), "{torn}");
        assert!(store.read(&rows).await.unwrap().is_some());
        verify(&store, None).await.unwrap();
    }

    #[tokio::test]
    async fn a_gc_that_was_suspended_takes_nothing_more() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        Version::publish_empty(&store, 2).await;
        let left_over = Artifact::name_of("left_over");
        store.write(&left_over, vec![7]).await.unwrap();
        let lease = Lease::of_gc(&store).await.unwrap();
        let taking = Taking {
            store: &store,
            lease: Some(&lease),
        };
        lease.lapse();
        // A list that was made before: nothing of it is believed any longer.
        let fault = taking.take(&left_over).await.unwrap_err();
        assert!(fault.to_string().contains("run it again"), "{fault}");
        collect(&taking, 1).await.unwrap_err();
        assert_eq!(Version::numbers(&store).await.unwrap(), [1, 2]);
        assert!(store.read(&left_over).await.unwrap().is_some());
        lease.end().await;
        let collected = gc(&store, 1, false).await.unwrap();
        assert_eq!((collected.versions, collected.files), (1, 1));
        assert_eq!(Version::numbers(&store).await.unwrap(), [2]);
    }
}
