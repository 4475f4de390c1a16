//! An index that was kept spares reading the file again, and is believed only where it fits.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use crate::common::{Log, context, count, in_memory};
use datafusion::prelude::SessionContext;
use evermap_datasets::log::index::LogIndex;
use evermap_datasets::{Dataset, Reason, Recordings};
use url::Url;

/// Opens a log with a kept index.
async fn open_with(log: &[u8], index: Option<&LogIndex>) -> (SessionContext, Dataset) {
    let context = context(1);
    let runtime = context.runtime_env();
    let url = Url::parse("memory://logs").unwrap();
    runtime.register_object_store(&url, in_memory(log).await);
    let paths = ["memory://logs/log.mcap".to_owned()];
    let mut found = Recordings::find(&runtime, &paths, None).await.unwrap();
    found.sessions[0].files[0].index = index.cloned();
    let dataset = found.open().await.unwrap();
    dataset.register(&context).unwrap();
    (context, dataset)
}

/// The index as it comes back from JSON.
async fn kept(log: &[u8]) -> LogIndex {
    let (_, dataset) = open_with(log, None).await;
    let index = &dataset.parts()[0].index;
    let text = serde_json::to_string(index).unwrap();
    assert_eq!(*index, serde_json::from_str(&text).unwrap());
    index.clone()
}

#[tokio::test]
async fn a_kept_index_is_used_and_the_file_is_not_read_for_it() {
    let log = Log {
        indexed: false,
        ..Log::default()
    }
    .write();
    let index = kept(&log).await;
    let (context, _) = open_with(&log, Some(&index)).await;
    assert_eq!(count(&context, "SELECT * FROM messages").await, 60);
    // A file of the same size that has nothing in it would be refused, were it read.
    let (_, dataset) = open_with(&vec![0; log.len()], Some(&index)).await;
    assert_eq!(dataset.parts()[0].index, index);
}

#[tokio::test]
async fn losses_of_the_first_reading_are_told_again() {
    let log = Log::default().write();
    let torn = &log[..log.len() / 2];
    let index = kept(torn).await;
    let (_, read) = open_with(torn, None).await;
    assert!(read.losses.losses().contains_key(&Reason::Torn));
    let (_, again) = open_with(torn, Some(&index)).await;
    assert_eq!(again.losses.entries(), read.losses.entries());
}

#[tokio::test]
async fn an_index_that_does_not_fit_is_not_believed() {
    let log = Log::default().write();
    let index = kept(&log).await;
    let mut forged = vec![index.clone(); 4];
    forged[0].size += 1;
    forged[1].units[0].length = log.len() as u64;
    forged[2].units.swap(0, 1);
    forged[3].units[0].channels = Some(vec![2, 1]);
    for other in forged {
        let (_, dataset) = open_with(&log, Some(&other)).await;
        assert_eq!(dataset.parts()[0].index, index);
    }
}

#[test]
fn scans_and_roles_do_not_form_a_circle() {
    let scan = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/scan");
    for entry in std::fs::read_dir(scan).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        for other in ["crate::roles", "schemas::roles", "crate::dataset"] {
            assert!(!text.contains(other), "{} uses {other}", path.display());
        }
    }
}
