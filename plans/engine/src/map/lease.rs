//! Who is at work on a map, so that `gc` takes nothing from under a run.
//!
//! A run holds a lease from before it looks for what was done until it has published; `gc` holds one while it removes.
//! Each is written first, and the others are looked for afterwards: of a run and a `gc` that begin at once, at least one
//! sees the other. A run waits for `gc`, which is short; `gc` that sees a run gives up. A lease ends when it was not
//! renewed in time, so that a process that was killed is in nobody's way for long.

use std::time::Duration;

use chrono::{DateTime, Utc};
use evermap_schemas::{Fault, Kind};
use serde::{Deserialize, Serialize};
use tokio::task::JoinHandle;

use crate::map::store::Store;

/// The folder of a map that has the leases.
pub const FOLDER: &str = "leases";

/// How long a lease holds that is not renewed. Clocks of machines that share a map may differ by three quarters of it.
pub const TERM: Duration = Duration::from_secs(60);

/// How often a lease is renewed, so that one or two renewals may fail.
const RENEWAL: Duration = Duration::from_secs(15);

/// How often a run looks whether `gc` has ended.
const POLL: Duration = Duration::from_millis(50);

/// What is done under a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Work {
    Run,
    Gc,
}

/// A lease as it is written.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Written {
    work: Work,
    until: DateTime<Utc>,
}

impl Written {
    fn now(work: Work) -> Self {
        Self {
            work,
            until: Utc::now() + TERM,
        }
    }
}

/// A lease that is held, and renewed until it is dropped.
#[derive(Debug)]
pub struct Lease {
    store: Store,
    name: String,
    renewing: JoinHandle<()>,
}

impl Lease {
    /// A lease for a run; waits for `gc` to end.
    ///
    /// # Errors
    /// A resource fault when the store does not take it.
    pub async fn of_run(store: &Store) -> Result<Self, Fault> {
        let lease = Self::take(store, Work::Run).await?;
        while is_at(store, Work::Gc).await? {
            tokio::time::sleep(POLL).await;
        }
        Ok(lease)
    }

    /// Its name in the map.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// A lease for `gc`.
    ///
    /// # Errors
    /// A resource fault where a run is at work, or when the store does not take it.
    pub async fn of_gc(store: &Store) -> Result<Self, Fault> {
        let lease = Self::take(store, Work::Gc).await?;
        if !is_at(store, Work::Run).await? {
            return Ok(lease);
        }
        lease.end().await;
        let term = TERM.as_secs();
        Err(Fault::resource(format!(
            "a run is at work on this map, or was killed less than {term} s ago"
        ))
        .next("run gc when it has ended"))
    }

    async fn take(store: &Store, work: Work) -> Result<Self, Fault> {
        let name = format!("{FOLDER}/{}.json", uuid::Uuid::new_v4());
        store.write_json(&name, &Written::now(work)).await?;
        Ok(Self {
            renewing: tokio::spawn(renew(store.clone(), name.clone(), work)),
            store: store.clone(),
            name,
        })
    }

    /// Gives it back. Where the store does not do that, it ends by itself.
    pub async fn end(mut self) {
        self.renewing.abort();
        // A renewal that was under way must not bring it back.
        let _ = (&mut self.renewing).await;
        if let Err(fault) = self.store.remove(&self.name).await {
            tracing::debug!("the lease {} is not given back: {fault}", self.name);
        }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        self.renewing.abort();
        self.store.remove_if_local(&self.name);
    }
}

async fn renew(store: Store, name: String, work: Work) {
    loop {
        tokio::time::sleep(RENEWAL).await;
        if let Err(fault) = store.write_json(&name, &Written::now(work)).await {
            tracing::warn!("the lease {name} was not renewed: {fault}");
        }
    }
}

/// Whether the lease of this name is held still.
///
/// # Errors
/// A resource fault when the store does not answer, a data fault for a lease that does not read.
pub async fn is_held(store: &Store, name: &str) -> Result<bool, Fault> {
    let lease = store.read_json::<Written>(name).await?;
    Ok(lease.is_some_and(|lease| lease.until >= Utc::now()))
}

/// Whether somebody holds a lease for this work. Leases that have ended are removed.
async fn is_at(store: &Store, work: Work) -> Result<bool, Fault> {
    let mut found = false;
    for (name, _) in store.list(FOLDER).await? {
        match store.read_json::<Written>(&name).await {
            Ok(Some(lease)) if lease.until >= Utc::now() => found |= lease.work == work,
            Ok(None) => {}
            Err(fault) if fault.kind != Kind::Data => return Err(fault),
            Ok(Some(_)) | Err(_) => store.remove(&name).await?,
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[tokio::test]
    async fn gc_gives_up_beside_a_run_that_lives_and_a_run_waits_for_gc() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let run = Lease::of_run(&store).await.unwrap();
        let another = Lease::of_run(&store).await.unwrap();
        let name = another.name().to_owned();
        assert!(is_held(&store, &name).await.unwrap());
        another.end().await;
        assert!(!is_held(&store, &name).await.unwrap());
        let fault = Lease::of_gc(&store).await.unwrap_err();
        assert!(fault.to_string().contains("a run is at work"), "{fault}");
        drop(run);

        let gc = Lease::of_gc(&store).await.unwrap();
        let waiting = tokio::spawn({
            let store = store.clone();
            async move { Lease::of_run(&store).await.unwrap() }
        });
        while store.list(FOLDER).await.unwrap().len() < 2 {
            tokio::task::yield_now().await;
        }
        assert!(!waiting.is_finished());
        gc.end().await;
        waiting.await.unwrap().end().await;
        assert_eq!(store.list(FOLDER).await.unwrap(), []);
    }

    #[tokio::test]
    async fn the_lease_of_the_dead_ends() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let ended = Written {
            work: Work::Run,
            until: Utc::now() - TERM,
        };
        store.write_json("leases/dead.json", &ended).await.unwrap();
        assert!(!is_held(&store, "leases/dead.json").await.unwrap());
        store.write("leases/torn.json", Vec::new()).await.unwrap();
        Lease::of_gc(&store).await.unwrap().end().await;
        assert_eq!(store.list(FOLDER).await.unwrap(), []);
    }
}
