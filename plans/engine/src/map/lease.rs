//! Who is at work on a map, so that `gc` takes nothing from under a run.
//!
//! A run holds a lease from before it looks for what was done until it has published; `gc` holds one while it removes.
//! Each is written first, and the others are looked for afterwards: of a run and a `gc` that begin at once, at least one
//! sees the other. A run waits for `gc`, which is short; `gc` that sees a run gives up. A lease ends when it was not
//! renewed in time, so that a process that was killed is in nobody's way for long. A process that was only suspended goes
//! on when others took it for dead: `gc` looks at its own lease before it removes anything, and one that has ended is not
//! renewed; a run looks whether all is there before it publishes.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use chrono::{DateTime, Utc};
use evermap_schemas::{Fault, Kind};
use serde::{Deserialize, Serialize};
use tokio::task::JoinHandle;

use crate::locked::locked;
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
struct StoredLease {
    work: Work,
    until: DateTime<Utc>,
}

impl StoredLease {
    fn at(now: DateTime<Utc>, work: Work) -> Self {
        Self {
            work,
            until: now + TERM,
        }
    }
}

/// A lease that is held, and renewed until it is dropped.
#[derive(Debug)]
pub struct Lease {
    store: Store,
    name: String,
    until: Until,
    renewing: JoinHandle<()>,
}

/// Until when a lease holds that was written.
type Until = Arc<Mutex<DateTime<Utc>>>;

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
        let written = StoredLease::at(Utc::now(), work);
        store.write_json(&name, &written).await?;
        let until = Until::new(Mutex::new(written.until));
        let renewal = Renewal {
            store: store.clone(),
            name: name.clone(),
            work,
            until: Arc::clone(&until),
        };
        Ok(Self {
            renewing: tokio::spawn(renewal.go_on()),
            store: store.clone(),
            name,
            until,
        })
    }

    /// That nobody could take the `gc` that holds it for dead until now.
    ///
    /// # Errors
    /// A resource fault where it was not renewed in time, from then on for good.
    pub fn holds(&self) -> Result<(), Fault> {
        if Utc::now() <= *locked(&self.until) {
            return Ok(());
        }
        let term = TERM.as_secs();
        Err(Fault::resource(format!(
            "gc was suspended, or could not renew its lease, for more than {term} s: a run may need by now what it was to remove"
        ))
        .next("run it again"))
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

/// What renews a lease.
struct Renewal {
    store: Store,
    name: String,
    work: Work,
    until: Until,
}

impl Renewal {
    async fn go_on(self) {
        loop {
            tokio::time::sleep(RENEWAL).await;
            if !self.renew(Utc::now()).await {
                break;
            }
        }
    }

    /// Renews it; `false` for one of `gc` that had ended by then, which stays so.
    async fn renew(&self, now: DateTime<Utc>) -> bool {
        if self.work == Work::Gc && now > *locked(&self.until) {
            return false;
        }
        // From `now` on: it does not hold for longer if this is suspended here.
        let written = StoredLease::at(now, self.work);
        match self.store.write_json(&self.name, &written).await {
            Ok(()) => *locked(&self.until) = written.until,
            Err(fault) => tracing::warn!("the lease {} was not renewed: {fault}", self.name),
        }
        true
    }
}

/// Whether the lease of this name is held still.
///
/// # Errors
/// A resource fault when the store does not answer, a data fault for a lease that does not read.
pub async fn is_held(store: &Store, name: &str) -> Result<bool, Fault> {
    let lease = store.read_json::<StoredLease>(name).await?;
    Ok(lease.is_some_and(|lease| lease.until >= Utc::now()))
}

/// Whether somebody holds a lease for this work. Leases that have ended are removed.
async fn is_at(store: &Store, work: Work) -> Result<bool, Fault> {
    let mut found = false;
    for (name, _) in store.list(FOLDER).await? {
        match store.read_json::<StoredLease>(&name).await {
            Ok(Some(lease)) if lease.until >= Utc::now() => found |= lease.work == work,
            Ok(None) => {}
            Err(fault) if fault.kind != Kind::Data => return Err(fault),
            Ok(Some(_)) | Err(_) => store.remove(&name).await?,
        }
    }
    Ok(found)
}

#[cfg(test)]
impl Lease {
    /// As if the process had been suspended since before it would have been renewed.
    pub(super) fn lapse(&self) {
        *locked(&self.until) = Utc::now() - Duration::from_millis(1);
    }
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
        let ended = StoredLease {
            work: Work::Run,
            until: Utc::now() - TERM,
        };
        store.write_json("leases/dead.json", &ended).await.unwrap();
        assert!(!is_held(&store, "leases/dead.json").await.unwrap());
        store.write("leases/torn.json", Vec::new()).await.unwrap();
        Lease::of_gc(&store).await.unwrap().end().await;
        assert_eq!(store.list(FOLDER).await.unwrap(), []);
    }
    #[tokio::test]
    async fn a_gc_that_was_suspended_has_lost_its_lease_for_good() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let lease = Lease::of_gc(&store).await.unwrap();
        let renewal = |work| Renewal {
            store: store.clone(),
            name: lease.name.clone(),
            work,
            until: Arc::clone(&lease.until),
        };
        let begun = *locked(&lease.until);
        assert!(renewal(Work::Gc).renew(Utc::now()).await);
        assert!(*locked(&lease.until) > begun);
        lease.holds().unwrap();

        lease.lapse();
        assert!(!renewal(Work::Gc).renew(Utc::now()).await);
        let fault = lease.holds().unwrap_err();
        assert!(fault.to_string().contains("suspended"), "{fault}");
        // Suspended while it was renewing: what it wrote has ended when it wakes.
        let before = Utc::now() - 2 * TERM;
        assert!(renewal(Work::Gc).renew(before).await);
        assert!(!is_held(&store, lease.name()).await.unwrap());
        lease.holds().unwrap_err();
        // A run goes on: it looks before it publishes.
        assert!(renewal(Work::Run).renew(Utc::now()).await);
        lease.end().await;
    }
}
