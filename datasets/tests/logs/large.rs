//! Chunks that do not fit into memory give the rows that they give when they do.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::sync::Arc;

use arrow::array::{AsArray, RecordBatch};
use arrow::datatypes::{TimestampNanosecondType, UInt32Type};
use datafusion::execution::memory_pool::{GreedyMemoryPool, MemoryPool, UnboundedMemoryPool};
use datafusion::execution::runtime_env::RuntimeEnvBuilder;
use datafusion::prelude::{SessionConfig, SessionContext};
use evermap_datasets::fault::fault_of;
use evermap_datasets::{Dataset, Reason};
use evermap_schemas::{Fault, Kind};
use proptest::prelude::*;
use url::Url;

use crate::common::by_hand::{channel, checked_chunk, file, message_at, record};
use crate::common::{in_memory, packed};

/// Memory for a stream of portions, and for the largest message here.
const SMALL: usize = 27 << 20;

/// Bytes of a chunk that a stream cannot open in so little memory.
const LARGE: usize = 15 << 20;

/// A message as it comes out: topic, number, time and digest of the payload.
type Row = (String, u32, i64, u32);

fn rows_of(batch: &RecordBatch) -> Vec<Row> {
    let (topics, data) = (
        batch.column(0).as_string::<i32>(),
        batch.column(3).as_binary_view(),
    );
    let times = batch.column(1).as_primitive::<TimestampNanosecondType>();
    let numbers = batch.column(2).as_primitive::<UInt32Type>();
    let row = |at: usize| {
        let digest = crc32fast::hash(data.value(at));
        (
            topics.value(at).to_owned(),
            numbers.value(at),
            times.value(at),
            digest,
        )
    };
    (0..batch.num_rows()).map(row).collect()
}

/// All messages, the rows of a topic that is decoded, and what was lost.
async fn read(
    log: &[u8],
    pool: Arc<dyn MemoryPool>,
) -> Result<(Vec<Row>, usize, Vec<(Reason, u64, u64)>), Fault> {
    let runtime = RuntimeEnvBuilder::new()
        .with_memory_pool(pool)
        .build_arc()
        .unwrap();
    runtime.register_object_store(&Url::parse("memory://logs").unwrap(), in_memory(log).await);
    let config = SessionConfig::new().with_target_partitions(1);
    let context = SessionContext::new_with_config_rt(config, runtime.clone());
    let paths = ["memory://logs/log.mcap".to_owned()];
    let dataset = Dataset::open(&runtime, &paths, None).await?;
    dataset.register(&context).unwrap();
    let mut found = Vec::new();
    for query in [
        "SELECT topic, log_time, sequence, data FROM messages",
        "SELECT * FROM \"/a\"",
    ] {
        let rows = context.sql(query).await.unwrap().collect().await;
        found.push(rows.map_err(|error| fault_of(&error))?);
    }
    let losses = dataset.losses.losses().into_iter();
    let losses = losses.map(|(reason, loss)| (reason, loss.count, loss.bytes));
    Ok((
        found[0].iter().flat_map(rows_of).collect(),
        found[1].iter().map(RecordBatch::num_rows).sum(),
        losses.collect(),
    ))
}

/// The records of a large chunk: messages of these sizes over and over, of two topics, one that is not described, and
/// a record that does not belong there. Where they are `in_order`, so are their times.
fn records(sizes: &[usize], in_order: bool) -> Vec<u8> {
    let mut records = record(11, b"stray");
    for number in 0_u32.. {
        if records.len() > LARGE {
            break;
        }
        let size = sizes[number as usize % sizes.len()];
        let text: String = (0..size)
            .map(|at| char::from(b'a' + (at * at % 23) as u8))
            .collect();
        let data = format!("{{\"n\":{number},\"text\":\"{text}\"}}");
        let time = match in_order {
            true => u64::from(number),
            false => u64::from(number) * 7919 % 64,
        };
        let id = [1, 2, 1, 9][number as usize % 4];
        records.extend(message_at(id, number, time, data.as_bytes()));
    }
    records
}

#[derive(Debug, Clone)]
enum Damage {
    None,
    /// The file ends at this part of it.
    Cut(f64),
    /// The checksum is another one.
    Checksum,
    /// A byte at this part of the chunk is another one, and there is no checksum.
    Flipped(f64),
}

fn damage() -> impl Strategy<Value = Damage> {
    prop_oneof![
        Just(Damage::None),
        (0.05..0.95).prop_map(Damage::Cut),
        Just(Damage::Checksum),
        (0.3..0.95).prop_map(Damage::Flipped),
    ]
}

fn log(records: &[u8], compression: &str, damage: &Damage) -> Vec<u8> {
    let mut data = packed(compression, records);
    let part = |part: f64, of: usize| (part * of as f64) as usize;
    let crc = match damage {
        Damage::None | Damage::Cut(_) => crc32fast::hash(records),
        Damage::Checksum => crc32fast::hash(records) ^ 1,
        Damage::Flipped(_) => 0,
    };
    if let Damage::Flipped(at) = damage {
        let at = part(*at, data.len());
        data[at] ^= 0xFF;
    }
    let chunk = checked_chunk(records.len() as u64, crc, compression, &data);
    let channels = [channel(1, 0, "/a", "json"), channel(2, 0, "/b", "json")];
    let mut log = file(&[channels.concat(), chunk], &[]);
    if let Damage::Cut(at) = damage {
        log.truncate(part(*at, log.len()));
    }
    log
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    #[test]
    fn a_chunk_that_does_not_fit_into_memory_gives_the_same_rows_and_losses(
        sizes in prop::collection::vec(
            prop_oneof![0..300_usize, 1_000..100_000_usize, 1_000_000..1_400_000_usize],
            1..6,
        ),
        in_order in any::<bool>(),
        compression in prop::sample::select(vec!["", "zstd", "lz4"]),
        damage in damage(),
    ) {
        // Some bytes each, so that there are not a million messages.
        let sizes: Vec<usize> = sizes.into_iter().map(|size| size + 2_000).collect();
        let log = log(&records(&sizes, in_order), compression, &damage);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let (whole, small) = runtime.block_on(async {
            let whole = read(&log, Arc::new(UnboundedMemoryPool::default())).await.unwrap();
            let small = read(&log, Arc::new(GreedyMemoryPool::new(SMALL))).await.unwrap();
            (whole, small)
        });
        let ((mut whole, whole_a, whole_lost), (mut small, small_a, small_lost)) = (whole, small);
        // What is flipped may be a time.
        let is_flipped = matches!(damage, Damage::Flipped(_));
        if !in_order || is_flipped && !small.is_sorted_by_key(|(_, _, time, _)| *time) {
            whole.sort();
            small.sort();
        }
        prop_assert!(whole == small, "{} and {} rows", whole.len(), small.len());
        prop_assert_eq!(whole_a, small_a);
        prop_assert_eq!(whole_lost, small_lost);
    }
}

#[tokio::test]
async fn a_message_that_does_not_fit_into_memory_is_refused_with_its_size() {
    let log = log(&records(&[9 << 20], true), "zstd", &Damage::None);
    let refused = read(&log, Arc::new(GreedyMemoryPool::new(SMALL)))
        .await
        .unwrap_err();
    assert_eq!(refused.kind, Kind::Resource, "{refused}");
    assert!(refused.place.contains("a message of 94372"), "{refused}");
}

/// They are told of the chunk, by whose offset losses are told apart: those of one portion stood for all.
#[tokio::test]
async fn messages_of_a_large_chunk_that_do_not_decode_are_all_counted() {
    let padding = "x".repeat(10_000);
    let mut records = Vec::new();
    let mut broken = 0;
    for number in 0_u32.. {
        if records.len() > LARGE {
            break;
        }
        let is_broken = number % 3 == 0;
        broken += u64::from(is_broken);
        let end = if is_broken { "" } else { "}" };
        let data = format!("{{\"n\":{number},\"text\":\"{padding}\"{end}");
        records.extend(message_at(1, number, u64::from(number), data.as_bytes()));
    }
    let log = log(&records, "zstd", &Damage::None);
    let whole = read(&log, Arc::new(UnboundedMemoryPool::default())).await;
    let small = read(&log, Arc::new(GreedyMemoryPool::new(SMALL))).await;
    let ((_, whole_rows, whole_lost), (_, small_rows, small_lost)) =
        (whole.unwrap(), small.unwrap());
    assert_eq!((&whole_lost, whole_rows), (&small_lost, small_rows));
    let counted: Vec<u64> = whole_lost.iter().map(|(_, count, _)| *count).collect();
    assert_eq!(counted, [broken], "{whole_lost:?}");
}
