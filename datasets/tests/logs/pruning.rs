//! A scan fetches only the chunks that may matter: proven by counting bytes.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::fmt;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::common::{Log, count, in_memory, open_in};
use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::BoxStream;
use object_store::path::Path;
use object_store::{
    CopyOptions, GetOptions, GetRange, GetResult, ListResult, MultipartUpload, ObjectMeta,
    ObjectStore, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};

/// Counts the bytes that are fetched, and the requests.
#[derive(Debug)]
struct Counting {
    inner: Arc<dyn ObjectStore>,
    bytes: AtomicU64,
    requests: AtomicU64,
}

impl fmt::Display for Counting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("counting")
    }
}

#[async_trait]
impl ObjectStore for Counting {
    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        let bounded = matches!(options.range, Some(GetRange::Bounded(_))) || options.head;
        let head = options.head;
        let result = self.inner.get_opts(location, options).await?;
        assert!(bounded, "the whole file was asked for");
        if !head {
            let length = result.range.end - result.range.start;
            self.bytes.fetch_add(length, Ordering::SeqCst);
            self.requests.fetch_add(1, Ordering::SeqCst);
        }
        Ok(result)
    }

    async fn get_ranges(&self, location: &Path, ranges: &[Range<u64>]) -> Result<Vec<Bytes>> {
        let length: u64 = ranges.iter().map(|range| range.end - range.start).sum();
        self.bytes.fetch_add(length, Ordering::SeqCst);
        self.inner.get_ranges(location, ranges).await
    }

    async fn put_opts(&self, l: &Path, p: PutPayload, o: PutOptions) -> Result<PutResult> {
        self.inner.put_opts(l, p, o).await
    }

    async fn put_multipart_opts(
        &self,
        l: &Path,
        o: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.inner.put_multipart_opts(l, o).await
    }

    fn delete_stream(
        &self,
        l: BoxStream<'static, Result<Path>>,
    ) -> BoxStream<'static, Result<Path>> {
        self.inner.delete_stream(l)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.inner.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, o: CopyOptions) -> Result<()> {
        self.inner.copy_opts(from, to, o).await
    }
}

/// Rows of a query, and what was fetched for it after the log was opened.
async fn fetched(log: &[u8], sql: &str) -> (usize, Arc<Counting>) {
    let store = Arc::new(Counting {
        inner: in_memory(log).await,
        bytes: AtomicU64::new(0),
        requests: AtomicU64::new(0),
    });
    let (context, _) = open_in(store.clone(), 1).await.unwrap();
    store.bytes.store(0, Ordering::SeqCst);
    store.requests.store(0, Ordering::SeqCst);
    (count(&context, sql).await, store)
}

/// Rows of a query, and the bytes that were fetched for it.
async fn cost(log: &[u8], sql: &str) -> (usize, u64) {
    let (rows, store) = fetched(log, sql).await;
    (rows, store.bytes.load(Ordering::SeqCst))
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
    let requests = store.requests.load(Ordering::SeqCst) as usize;
    assert!(requests < chunks / 8, "{requests} for {chunks} chunks");
    assert!(store.bytes.load(Ordering::SeqCst) as usize <= log.len());
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
