//! A scan fetches only the chunks that may matter: proven by counting bytes.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::common::{Log, count, in_memory, open_in};
use async_trait::async_trait;
use bytes::Bytes;
use evermap_test_data::stores::{Reads, Watched};
use object_store::path::Path;
use object_store::{GetOptions, GetRange, GetResult, ObjectStore, Result};

/// Counts the bytes that are fetched, and the requests.
#[derive(Debug, Default)]
struct Counting {
    bytes: AtomicU64,
    requests: AtomicU64,
}

#[async_trait]
impl Reads for Counting {
    async fn file(
        &self,
        store: &dyn ObjectStore,
        location: &Path,
        options: GetOptions,
    ) -> Result<GetResult> {
        let bounded = matches!(options.range, Some(GetRange::Bounded(_))) || options.head;
        let head = options.head;
        let result = store.get_opts(location, options).await?;
        assert!(bounded, "the whole file was asked for");
        if !head {
            let length = result.range.end - result.range.start;
            self.bytes.fetch_add(length, Ordering::SeqCst);
            self.requests.fetch_add(1, Ordering::SeqCst);
        }
        Ok(result)
    }

    async fn parts(
        &self,
        store: &dyn ObjectStore,
        location: &Path,
        ranges: &[Range<u64>],
    ) -> Result<Vec<Bytes>> {
        let length: u64 = ranges.iter().map(|range| range.end - range.start).sum();
        self.bytes.fetch_add(length, Ordering::SeqCst);
        store.get_ranges(location, ranges).await
    }
}

/// Rows of a query, and what was fetched for it after the log was opened.
async fn fetched(log: &[u8], sql: &str) -> (usize, Arc<Watched<Counting>>) {
    let store = Arc::new(Watched {
        store: in_memory(log).await,
        reads: Counting::default(),
    });
    let (context, _) = open_in(store.clone(), 1).await.unwrap();
    store.reads.bytes.store(0, Ordering::SeqCst);
    store.reads.requests.store(0, Ordering::SeqCst);
    (count(&context, sql).await, store)
}

/// Rows of a query, and the bytes that were fetched for it.
async fn cost(log: &[u8], sql: &str) -> (usize, u64) {
    let (rows, store) = fetched(log, sql).await;
    (rows, store.reads.bytes.load(Ordering::SeqCst))
}

fn log() -> Vec<u8> {
    let log = Log {
        messages: 2000,
        payload: 4000,
        chunk: Some(50_000),
        compression: None,
        ..Log::default()
    };
    log.write()
}

#[tokio::test]
async fn time_filters_choose_chunks() {
    let log = log();
    let (rows, all) = cost(&log, "SELECT * FROM \"/blob\"").await;
    assert_eq!(rows, 1000);
    assert!(all as usize > log.len() / 2);
    let filter = "log_time >= TIMESTAMP '1970-01-01T00:10:00Z' AND log_time < TIMESTAMP '1970-01-01T00:11:00Z'";
    let (rows, some) = cost(&log, &format!("SELECT data FROM \"/blob\" WHERE {filter}")).await;
    assert_eq!(rows, 30);
    assert!(some < all / 10, "{some} of {all}");
}

/// Each request of an object store costs its own time: chunks near each other are fetched with one.
#[tokio::test]
async fn chunks_are_fetched_in_stretches() {
    let log = log();
    let (rows, store) = fetched(&log, "SELECT data FROM \"/blob\"").await;
    assert_eq!(rows, 1000);
    let chunks = log.len() / 50_000;
    let requests = store.reads.requests.load(Ordering::SeqCst) as usize;
    assert!(requests < chunks / 8, "{requests} for {chunks} chunks");
    assert!(store.reads.bytes.load(Ordering::SeqCst) as usize <= log.len());
}

#[tokio::test]
async fn limits_stop_reading() {
    let log = log();
    let (rows, some) = cost(&log, "SELECT * FROM \"/blob\" LIMIT 3").await;
    assert_eq!(rows, 3);
    assert!(some < 200_000, "{some}");
}

#[tokio::test]
async fn sessions_and_topics_that_are_not_there_cost_nothing() {
    let log = log();
    assert_eq!(
        cost(&log, "SELECT * FROM messages WHERE topic = '/nothing'").await,
        (0, 0)
    );
    assert_eq!(
        cost(&log, "SELECT * FROM messages WHERE session = 'other'").await,
        (0, 0)
    );
    let (rows, _) = cost(
        &log,
        "SELECT * FROM messages WHERE topic IN ('/blob', '/x')",
    )
    .await;
    assert_eq!(rows, 1000);
}
