//! What addresses in a store of objects name: just the files that people mean, or a fault that says why not.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::ops::Range;
use std::sync::Arc;

use async_trait::async_trait;
use bytes::Bytes;
use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_datasets::Recordings;
use evermap_schemas::Fault;
use evermap_test_data::stores::{Reads, Watched};
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{Error, GetOptions, GetResult, ObjectStore, ObjectStoreExt, Result};
use url::Url;

/// Refuses to say what a store has of a name; the store lists what it has.
#[derive(Debug)]
struct Guarded;

fn refused<T>(location: &Path) -> Result<T> {
    Err(Error::PermissionDenied {
        path: location.to_string(),
        source: "403 Forbidden".into(),
    })
}

#[async_trait]
impl Reads for Guarded {
    async fn file(&self, _: &dyn ObjectStore, location: &Path, _: GetOptions) -> Result<GetResult> {
        refused(location)
    }

    async fn parts(
        &self,
        _: &dyn ObjectStore,
        location: &Path,
        _: &[Range<u64>],
    ) -> Result<Vec<Bytes>> {
        refused(location)
    }
}

/// The keys that an address names in a store.
async fn named(store: Arc<dyn ObjectStore>, address: &str) -> Result<Vec<String>, Fault> {
    let runtime = RuntimeEnv::default();
    let url = Url::parse("memory://logs").unwrap();
    runtime.register_object_store(&url, store);
    let address = [format!("memory://logs/{address}")];
    let found = Recordings::find(&runtime, &address, None).await?;
    let files = found.sessions.iter().flat_map(|session| &session.files);
    let mut keys: Vec<String> = files.map(|file| file.meta.location.to_string()).collect();
    keys.sort();
    Ok(keys)
}

async fn holding(keys: &[&str]) -> InMemory {
    let store = InMemory::new();
    for key in keys {
        let path = Path::parse(key).unwrap();
        store.put(&path, "a log".into()).await.unwrap();
    }
    store
}

#[tokio::test]
async fn signs_that_mean_something_in_urls_are_part_of_keys_and_patterns() {
    let keys = [
        "drive_1.mcap",
        "drive_1.mcap#other",
        "drive_2.mcap",
        "drive_10.mcap",
        "y202/a.mcap",
        "y2025/b.mcap",
        "odd/drive_?.mcap",
        "odd/drive_3.mcap",
    ];
    let store: Arc<dyn ObjectStore> = Arc::new(holding(&keys).await);
    let cases: [(&str, &[&str]); 4] = [
        ("drive_1.mcap#other", &["drive_1.mcap#other"]),
        ("drive_?.mcap", &["drive_1.mcap", "drive_2.mcap"]),
        ("y202?/*.mcap", &["y2025/b.mcap"]),
        // What has the name of a pattern is what is meant, as on a disk.
        ("odd/drive_?.mcap", &["odd/drive_?.mcap"]),
    ];
    for (address, expected) in cases {
        let found = named(Arc::clone(&store), address).await.unwrap();
        assert_eq!(found, expected, "{address}");
    }
}

#[tokio::test]
async fn a_pattern_leaves_out_what_lies_beside_logs_as_it_does_on_a_disk() {
    let keys = ["a/1.mcap", "a/2.mcap", "a/metadata.yaml", "b/readme.txt"];
    let store: Arc<dyn ObjectStore> = Arc::new(holding(&keys).await);
    let found = named(Arc::clone(&store), "a/*").await.unwrap();
    assert_eq!(found, ["a/1.mcap", "a/2.mcap"]);
    // Who names nothing else is told of that.
    let found = named(store, "b/*").await.unwrap();
    assert_eq!(found, ["b/readme.txt"]);
}

#[tokio::test]
async fn a_store_that_refuses_to_say_what_it_has_is_told_unless_it_lists_logs() {
    let store: Arc<dyn ObjectStore> = Arc::new(Watched {
        store: Arc::new(holding(&["logs/a.mcap"]).await),
        reads: Guarded,
    });
    let found = named(Arc::clone(&store), "logs").await.unwrap();
    assert_eq!(found, ["logs/a.mcap"]);
    let fault = named(store, "logs/a.mcap").await.unwrap_err();
    assert!(fault.message.contains("403 Forbidden"), "{fault}");
    let empty: Arc<dyn ObjectStore> = Arc::new(holding(&[]).await);
    let fault = named(empty, "logs/a.mcap").await.unwrap_err();
    assert!(fault.message.contains("found none"), "{fault}");
}
