//! What is fetched of a log is what may matter, in few requests: proven by counting bytes and requests.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::common::by_hand::{channel, file, first, message, record, text};
use crate::common::{Log, count, in_memory, open_in};
use async_trait::async_trait;
use bytes::Bytes;
use datafusion::prelude::SessionContext;
use evermap_datasets::Dataset;
use evermap_test_data::stores::{Reads, Watched};
use object_store::path::Path;
use object_store::{GetOptions, GetRange, GetResult, ObjectStore, Result};

/// Counts the bytes that are fetched, and the requests: all, and those that are on their way.
#[derive(Debug, Default)]
struct Counting {
    bytes: AtomicU64,
    requests: AtomicU64,
    waiting: AtomicU64,
    most_waiting: AtomicU64,
}

impl Counting {
    fn forget(&self) {
        for count in [&self.bytes, &self.requests, &self.most_waiting] {
            count.store(0, Ordering::SeqCst);
        }
    }

    fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::SeqCst)
    }

    fn requests(&self) -> u64 {
        self.requests.load(Ordering::SeqCst)
    }

    fn most_waiting(&self) -> u64 {
        self.most_waiting.load(Ordering::SeqCst)
    }
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
        let waiting = self.waiting.fetch_add(1, Ordering::SeqCst) + 1;
        self.most_waiting.fetch_max(waiting, Ordering::SeqCst);
        // Whoever asks for more at a time does so now.
        tokio::task::yield_now().await;
        let result = store.get_opts(location, options).await;
        self.waiting.fetch_sub(1, Ordering::SeqCst);
        let result = result?;
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

/// A log that is open, and what was fetched for that.
async fn opened(log: &[u8]) -> (SessionContext, Dataset, Arc<Watched<Counting>>) {
    let store = Arc::new(Watched {
        store: in_memory(log).await,
        reads: Counting::default(),
    });
    let (context, dataset) = open_in(store.clone(), 1).await.unwrap();
    (context, dataset, store)
}

/// Rows of a query, and what was fetched for it after the log was opened.
async fn fetched(log: &[u8], sql: &str) -> (usize, Arc<Watched<Counting>>) {
    let (context, _, store) = opened(log).await;
    store.reads.forget();
    (count(&context, sql).await, store)
}

/// Rows of a query, and the bytes that were fetched for it.
async fn cost(log: &[u8], sql: &str) -> (usize, u64) {
    let (rows, store) = fetched(log, sql).await;
    (rows, store.reads.bytes())
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
    let requests = store.reads.requests() as usize;
    assert!(requests < chunks / 8, "{requests} for {chunks} chunks");
    assert!(store.reads.bytes() as usize <= log.len());
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

/// What a message says of topics and sites is its own, and no column that the index knows of.
#[tokio::test]
async fn messages_with_a_topic_and_a_site_of_their_own_are_all_looked_at() {
    let options = mcap::WriteOptions::new().chunk_size(Some(200));
    let mut bytes = Cursor::new(Vec::new());
    let mut log = options.create(&mut bytes).unwrap();
    let fields = br#"{"type": "object", "properties": {
        "topic": {"type": "string"}, "site": {"type": "string"}, "session": {"type": "string"}
    }}"#;
    let schema = log.add_schema("Statistics", "jsonschema", fields).unwrap();
    let topic = log.add_channel(schema, "/statistics", "json", &BTreeMap::new());
    for sequence in 0..20 {
        let header = mcap::records::MessageHeader {
            channel_id: *topic.as_ref().unwrap(),
            sequence,
            log_time: sequence.into(),
            publish_time: 0,
        };
        let of = if sequence % 3 == 0 { "/imu" } else { "/odom" };
        let said = format!(r#"{{"topic": "{of}", "site": "lot", "session": "{of}"}}"#);
        log.write_to_known_channel(&header, said.as_bytes())
            .unwrap();
    }
    log.finish().unwrap();
    drop(log);
    let log = bytes.into_inner();
    for (filter, found) in [
        ("topic = '/imu'", 7),
        ("site = 'lot'", 20),
        ("session_ = '/imu'", 7),
        (
            "topic > '/imu' AND log_time < TIMESTAMP '1970-01-01T00:00:01Z'",
            13,
        ),
        ("session = 'log'", 20),
        ("session = '/imu'", 0),
    ] {
        let query = format!("SELECT * FROM \"/statistics\" WHERE {filter}");
        let (context, ..) = opened(&log).await;
        assert_eq!(count(&context, &query).await, found, "{filter}");
    }
}

/// A log with so many attachments of so many bytes, as many metadata records, and a message behind each.
fn records(many: u32, bytes: usize) -> Vec<u8> {
    let options = mcap::WriteOptions::new()
        .compression(None)
        .use_chunks(false);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let none = BTreeMap::new();
    let topic = writer.add_channel(0, "/t", "json", &none).unwrap();
    for number in 0..many {
        let attachment = mcap::Attachment {
            log_time: 1,
            create_time: 1,
            name: format!("a{number}"),
            media_type: "text/plain".to_owned(),
            data: Cow::Owned(vec![b'x'; bytes]),
        };
        writer.attach(&attachment).unwrap();
        let metadata = mcap::records::Metadata {
            name: format!("m{number}"),
            metadata: none.clone(),
        };
        writer.write_metadata(&metadata).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: topic,
            sequence: number,
            log_time: 1,
            publish_time: 1,
        };
        writer.write_to_known_channel(&header, b"{}").unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// Each attachment and each metadata record had cost a request whenever a log was opened, and another one where it was read.
#[tokio::test]
async fn small_records_are_fetched_together() {
    let log = records(1000, 100);
    let (context, dataset, store) = opened(&log).await;
    let part = dataset.parts().remove(0);
    let index = &part.index;
    assert!(index.indexed && index.attachments.len() == 1000 && index.metadata.len() == 1000);
    let requests = store.reads.requests();
    assert!(requests < 10, "{requests} to open it");
    for (sql, rows) in [
        ("SELECT name FROM attachments WHERE size = 100", 1000),
        ("SELECT data FROM attachments", 1000),
        ("SELECT name, metadata FROM metadata", 1000),
    ] {
        store.reads.forget();
        assert_eq!(count(&context, sql).await, rows, "{sql}");
        let requests = store.reads.requests();
        assert!(requests < 10, "{requests} for {sql}");
    }
    store.reads.forget();
    assert_eq!(part.attachments().await.unwrap().len(), 1000);
    assert_eq!(part.metadata_names().await.unwrap().len(), 1000);
    let requests = store.reads.requests();
    assert!(requests < 10, "{requests} to list them");
    assert!(dataset.losses.is_empty(), "{:?}", dataset.losses.entries());
}

/// Of large attachments only what stands before their bytes is read, of several at a time.
#[tokio::test]
async fn heads_of_large_records_are_fetched_side_by_side() {
    let log = records(40, 1 << 20);
    let (context, dataset, store) = opened(&log).await;
    let found = &dataset.parts()[0].index;
    assert!(found.indexed && found.attachments.len() == 40 && found.metadata.len() == 40);
    let (requests, waiting) = (store.reads.requests(), store.reads.most_waiting());
    assert_eq!(waiting, 16, "requests at a time of {requests}");
    store.reads.forget();
    let sql = "SELECT name FROM attachments WHERE size = 1048576";
    assert_eq!(count(&context, sql).await, 40);
    let (bytes, waiting) = (store.reads.bytes(), store.reads.most_waiting());
    assert!(bytes < 40 * (65 << 10), "{bytes} of {}", log.len());
    assert!((4..=32).contains(&waiting), "{waiting} requests at a time");
}

/// Chunks that lie far from each other are fetched side by side, too.
#[tokio::test]
async fn chunks_of_a_sparse_topic_are_fetched_side_by_side() {
    let none = BTreeMap::new();
    let options = mcap::WriteOptions::new()
        .compression(None)
        .chunk_size(Some(200_000));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let often = writer.add_channel(0, "/often", "json", &none).unwrap();
    let rarely = writer.add_channel(0, "/rarely", "json", &none).unwrap();
    let payload = vec![b' '; 10_000];
    for number in 0..2000 {
        let channel_id = match number % 100 {
            0 => rarely,
            _ => often,
        };
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: number,
            log_time: 1,
            publish_time: 1,
        };
        writer.write_to_known_channel(&header, &payload).unwrap();
    }
    writer.finish().unwrap();
    let log = writer.into_inner().into_inner();
    let sql = "SELECT data FROM messages WHERE topic = '/rarely'";
    let (rows, store) = fetched(&log, sql).await;
    assert_eq!(rows, 20);
    let (bytes, waiting) = (store.reads.bytes(), store.reads.most_waiting());
    assert!((bytes as usize) < log.len() / 3, "{bytes} of {}", log.len());
    assert!((3..=32).contains(&waiting), "{waiting} requests at a time");
}

/// An index whose entries overlap, lie outside or are of no record costs no request for each of them, and is not believed.
#[tokio::test]
async fn entries_that_only_claim_cost_no_requests() {
    type Claim = fn(u64, u64) -> (u64, u64);
    const MANY: u64 = 100_000;
    let entry = |offset: u64, length: u64| {
        let place = [offset.to_le_bytes(), length.to_le_bytes()].concat();
        record(13, &[place, text(b"m")].concat())
    };
    let opaque = record(0x80, &vec![7; 9 * MANY as usize]);
    let inside = first() + 9;
    let claims: [(&str, Claim); 5] = [
        ("all at one place", |inside, _| (inside, 1 << 60)),
        ("beyond the file", |_, at| ((1 << 60) + 100 * at, 100)),
        ("one over the other", |inside, at| (inside + at, 20)),
        ("shorter than a record", |inside, at| (inside + at, 1)),
        ("of no record", |inside, at| (inside + 9 * at, 9)),
    ];
    for (what, claim) in claims {
        let entries = (0..MANY).flat_map(|at| {
            let (offset, length) = claim(inside, at);
            entry(offset, length)
        });
        let topic = channel(1, 0, "/t", "json");
        let summary = [topic.clone(), entries.collect()];
        let log = file(&[topic, message(1, 0, b"{}"), opaque.clone()], &summary);
        let (context, dataset, store) = opened(&log).await;
        let requests = store.reads.requests();
        assert!(requests < 30, "{what}: {requests} requests");
        let index = &dataset.parts()[0].index;
        assert!(!index.indexed && index.metadata.is_empty(), "{what}");
        assert_eq!(count(&context, "SELECT * FROM \"/t\"").await, 1, "{what}");
    }
}
