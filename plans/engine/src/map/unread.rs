//! What becomes of the file of a version that does not read: what `gc` removes, and what a person decides.

use evermap_schemas::{Fault, Kind};
use serde_json::Value;

use crate::map::store::Store;
use crate::map::version::Version;
use crate::map::{parts, sealed};

/// What becomes of it.
#[derive(Debug)]
pub enum Unread {
    /// Nobody can say what it needs, now or later, or another version says the same: it can go.
    Nobodys,
    /// It may need what nothing else tells. The fault says what a person does before `gc` goes on.
    Kept(Fault),
}

impl Unread {
    /// What becomes of the version of a number that does not read, as a data fault says.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn of(store: &Store, number: u64, fault: Fault) -> Result<Self, Fault> {
        let name = Version::name(number);
        let mut found = match sealed::read::<Value>(store, &name).await {
            Ok(Some(found)) if found.is_object() => found,
            Err(fault) if fault.kind != Kind::Data => return Err(fault),
            // Torn, not as it was published, or gone since.
            _ => return Ok(Self::Nobodys),
        };
        let holds = found.get("version").and_then(Value::as_u64);
        let first = if let Some(other) = holds.filter(|holds| *holds != number) {
            if is_copy(store, &name, other).await? {
                return Ok(Self::Nobodys);
            }
            put_right(store, &name, other).await?
        } else if lacks_part(store, &mut found).await? {
            format!("run the same plan again, which writes its parts anew, or remove {name}")
        } else {
            format!("use the evermap that wrote it, or remove {name}")
        };
        Ok(Self::Kept(Fault {
            message: format!("version {number} does not read: {}", fault.message),
            next: format!("{first}, then run `evermap gc` again"),
            ..fault
        }))
    }
}

/// Whether the file of a name is, byte for byte, that of another version.
async fn is_copy(store: &Store, name: &str, of: u64) -> Result<bool, Fault> {
    match store.read(&Version::name(of)).await {
        Err(fault) if fault.kind == Kind::Data => Ok(false),
        version => Ok(version? == store.read(name).await?),
    }
}

/// What puts the file of a name right, which holds a version of another number.
async fn put_right(store: &Store, name: &str, holds: u64) -> Result<String, Fault> {
    let own = Version::name(holds);
    match Version::find(store, holds).await {
        Err(fault) if fault.kind != Kind::Data => Err(fault),
        Ok(Some(_)) => Ok(format!(
            "move {name} out of the map, whose version {holds} is another one"
        )),
        _ => Ok(format!("rename {name} to {own}, which it is")),
    }
}

/// Whether a part of its lists is missing or damaged.
async fn lacks_part(store: &Store, version: &mut Value) -> Result<bool, Fault> {
    match parts::taken(store, version).await {
        Err(fault) if fault.kind == Kind::Data => Ok(true),
        taken => taken.map(|_| false),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use async_trait::async_trait;
    use evermap_test_data::stores::{Reads, Watched};
    use object_store::path::Path;
    use object_store::{GetOptions, GetResult, ObjectStore};

    use super::*;
    use crate::map::version::Previous;
    use crate::map::{Remedy, gc, verify, versions};

    /// What `verify` advises, which is what `gc` says where it refuses.
    async fn advice(store: &Store) -> String {
        let remedies = verify(store, None).await.unwrap().remedies();
        let remedies: Vec<Remedy> = remedies.into_iter().collect();
        let [Remedy::Decide(step)] = remedies.as_slice() else {
            panic!("{remedies:?}");
        };
        let before = Version::numbers(store).await.unwrap();
        assert_eq!(gc(store, 1, false).await.unwrap_err().next, *step);
        assert_eq!(Version::numbers(store).await.unwrap(), before);
        step.clone()
    }

    #[tokio::test]
    async fn a_copy_of_a_version_goes_and_the_version_stays() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        Version::publish_empty(&store, 2).await;
        let within = |name: &str| folder.path().join("versions").join(name);
        std::fs::copy(within("2.json"), within("3.json")).unwrap();
        let remedies = verify(&store, None).await.unwrap().remedies();
        assert!(remedies.iter().eq([&Remedy::Collect]), "{remedies:?}");
        gc(&store, 1, false).await.unwrap();
        assert_eq!(Version::numbers(&store).await.unwrap(), [2]);
        assert!(Version::find(&store, 2).await.unwrap().is_some());
    }

    #[tokio::test]
    async fn a_version_in_the_place_of_another_is_kept_until_it_is_put_right() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        Version::publish_empty(&store, 2).await;
        let within = |name: &str| folder.path().join("versions").join(name);
        std::fs::rename(within("2.json"), within("3.json")).unwrap();
        let step = advice(&store).await;
        assert!(step.starts_with("rename versions/3.json to versions/2.json"));

        let other = Version {
            version: 2,
            plan: "other".into(),
            ..Version::default()
        };
        assert!(other.publish(&store).await.unwrap());
        let step = advice(&store).await;
        assert!(step.starts_with("move versions/3.json out of the map"));

        std::fs::rename(within("3.json"), within("2.json")).unwrap();
        gc(&store, 1, false).await.unwrap();
        assert_eq!(Version::numbers(&store).await.unwrap(), [2]);
    }

    #[tokio::test]
    async fn a_version_that_lacks_a_part_is_kept_until_a_run_writes_it() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let sessions = (0..2000).map(|number| format!("drive_{number:04}"));
        let mut version = Version {
            version: 1,
            previous: Previous {
                sessions: sessions.collect(),
                ..Previous::default()
            },
            ..Version::default()
        };
        assert!(version.publish(&store).await.unwrap());
        let listed = store.list(parts::PARTS).await.unwrap();
        store.remove(&listed[0].0).await.unwrap();
        let step = advice(&store).await;
        assert!(step.starts_with("run the same plan again"), "{step}");
        version.version = 2;
        assert!(version.publish(&store).await.unwrap());
        gc(&store, 2, false).await.unwrap();
        assert_eq!(Version::numbers(&store).await.unwrap(), [1, 2]);
    }

    /// The most files that are asked for at once.
    #[derive(Debug, Default)]
    struct AtOnce {
        now: AtomicUsize,
        most: Arc<AtomicUsize>,
    }

    #[async_trait]
    impl Reads for AtOnce {
        async fn file(
            &self,
            store: &dyn ObjectStore,
            location: &Path,
            options: GetOptions,
        ) -> object_store::Result<GetResult> {
            let now = self.now.fetch_add(1, Ordering::SeqCst) + 1;
            self.most.fetch_max(now, Ordering::SeqCst);
            tokio::time::sleep(Duration::from_millis(5)).await;
            self.now.fetch_sub(1, Ordering::SeqCst);
            store.get_opts(location, options).await
        }
    }

    #[tokio::test]
    async fn versions_are_read_side_by_side_and_told_in_order() {
        let most = Arc::new(AtomicUsize::new(0));
        let reads = AtOnce {
            most: Arc::clone(&most),
            ..AtOnce::default()
        };
        let store = Store::open("memory:///lot", true).unwrap();
        let store = store.over(|store| Arc::new(Watched { store, reads }));
        Version::publish_empty(&store, 40).await;
        let is_side_by_side = || (2..=16).contains(&most.swap(0, Ordering::SeqCst));
        most.store(0, Ordering::SeqCst);
        let told = versions(&store).await.unwrap();
        let told = told.iter().map(|version| version.version);
        assert!(told.eq(1..=40) && is_side_by_side());
        assert_eq!(verify(&store, None).await.unwrap().versions, 40);
        assert!(is_side_by_side());
        assert_eq!(gc(&store, 1, true).await.unwrap().versions, 39);
        assert!(is_side_by_side());
    }
}
