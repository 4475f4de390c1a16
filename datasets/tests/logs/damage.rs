//! Torn and corrupt logs are read as far as they are sound, and never panic.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use crate::common::by_hand::{
    channel, checked_chunk, chunk_index_of, file, first, message, message_index, statistics,
};
use crate::common::{
    Log, complete_messages, context, count, files, in_memory, open_in, record_places, shared,
    without_chunk,
};
use arrow::array::AsArray;
use arrow::datatypes::UInt32Type;
use datafusion::catalog::TableProvider;
use datafusion::physical_plan::collect;
use datafusion::prelude::SessionContext;
use evermap_datasets::fault::fault_of;
use evermap_datasets::log::record::{FRAME, MAGIC, split};
use evermap_datasets::losses::Entry;
use evermap_datasets::scan::{McapTable, MessagesTable};
use evermap_datasets::{Dataset, LossLedger, Reason};
use evermap_schemas::Kind;
use mcap::records::op;
use proptest::prelude::*;
use url::Url;

/// The dataset of a damaged log; none where it is refused whole.
async fn opened(context: &SessionContext, bytes: &[u8]) -> Option<Dataset> {
    let runtime = context.runtime_env();
    let url = Url::parse("memory://logs").unwrap();
    runtime.register_object_store(&url, in_memory(bytes).await);
    let paths = ["memory://logs/log.mcap".to_owned()];
    Dataset::open(&runtime, &paths, None).await.ok()
}

/// Sequence numbers of all messages that a damaged log gives, and its losses; none where it is refused whole. (Scans
/// are collected without a planner: thousands of logs are read here.)
async fn messages(bytes: &[u8]) -> Option<(Vec<u32>, LossLedger)> {
    let context = context(1);
    let dataset = opened(&context, bytes).await?;
    let losses = dataset.losses.clone();
    let table = McapTable::new(Arc::new(MessagesTable), &dataset.parts());
    let plan = table.scan(&context.state(), None, &[], None).await.unwrap();
    let mut sequences = Vec::new();
    for batch in collect(plan, context.task_ctx()).await.unwrap() {
        let column = batch.column_by_name("sequence").unwrap();
        sequences.extend(column.as_primitive::<UInt32Type>().values());
    }
    sequences.sort_unstable();
    Some((sequences, losses))
}

/// As [`messages`], but every other table is read too: it may be refused, but not panic.
async fn read(bytes: &[u8]) -> Option<(Vec<u32>, LossLedger)> {
    let context = context(1);
    let dataset = opened(&context, bytes).await?;
    for (name, table) in dataset.tables().unwrap() {
        let batches = match table.scan(&context.state(), None, &[], None).await {
            Ok(plan) => collect(plan, context.task_ctx()).await,
            Err(error) => Err(error),
        };
        if let Err(error) = batches {
            assert_ne!(fault_of(&error).kind, Kind::Bug, "{name}: {error}");
        }
    }
    let (sequences, losses) = messages(bytes).await?;
    let all = dataset.losses;
    assert!(
        losses
            .entries()
            .iter()
            .all(|loss| all.entries().contains(loss))
    );
    Some((sequences, all))
}

/// Ends of the top-level records of a whole log, with the number of messages up to there.
fn record_ends(log: &[u8]) -> Vec<(usize, usize)> {
    let mut ends = Vec::new();
    let mut offset = MAGIC.len();
    let mut messages = 0;
    while let Some((opcode, body, used)) = split(&log[offset..]) {
        let record = mcap::parse_record(opcode, body).unwrap();
        messages += match record {
            mcap::records::Record::Message { .. } => 1,
            mcap::records::Record::Chunk { header, data } => {
                mcap::read::ChunkReader::new(header, &data)
                    .unwrap()
                    .filter(|r| r.as_ref().unwrap().opcode() == op::MESSAGE)
                    .count()
            }
            _ => 0,
        };
        offset += used;
        ends.push((offset, messages));
    }
    ends
}

/// What a log cut at `length` must still give.
fn expected(ends: &[(usize, usize)], length: usize) -> usize {
    let whole = ends.iter().take_while(|(end, _)| *end <= length);
    whole.last().map_or(0, |(_, messages)| *messages)
}

#[tokio::test]
async fn a_log_cut_at_any_byte_gives_every_message_of_every_complete_chunk() {
    for chunk in [Some(300), None] {
        let log = Log {
            messages: 24,
            chunk,
            ..Log::default()
        }
        .write();
        let ends = record_ends(&log);
        let data_end = ends.iter().rfind(|(_, n)| *n < 24).unwrap().0;
        assert!(ends.len() > 8);
        for length in 0..log.len() {
            let found = messages(&log[..length]).await;
            let Some((sequences, losses)) = found else {
                assert!(length < MAGIC.len(), "refused at {length}");
                continue;
            };
            // Of a chunk that is cut, the messages before its end are salvaged.
            let expected = expected(&ends, length);
            assert!(sequences.len() >= expected, "cut at {length}");
            let first: Vec<u32> = (0..sequences.len() as u32).collect();
            assert_eq!(sequences, first, "cut at {length}");
            if length <= data_end {
                assert!(!losses.is_empty(), "no loss told at {length}");
            }
        }
        let (sequences, losses) = read(&log).await.unwrap();
        assert_eq!(sequences.len(), 24);
        assert!(losses.is_empty(), "{:?}", losses.entries());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn real_logs_are_cut_at_random_bytes() {
    let Some(folder) = shared("data/mcap_real") else {
        return;
    };
    let mut state = 7u64;
    for path in files(&folder, "mcap") {
        let log = std::fs::read(&path).unwrap();
        if log.len() > 2_000_000 {
            continue;
        }
        for _ in 0..8 {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            let length = MAGIC.len() + (state >> 33) as usize % (log.len() - MAGIC.len());
            let (sequences, _) = read(&log[..length]).await.unwrap();
            let complete = complete_messages(&log[..length]);
            assert!(
                sequences.len() >= complete,
                "{} cut at {length}: {} of {complete}",
                path.display(),
                sequences.len()
            );
        }
    }
}

/// All that it holds are two images in one chunk.
#[tokio::test]
async fn soccer_goal_12_cut_anywhere_keeps_what_was_complete() {
    let Some(path) = shared("data/mcap_real/amber/soccer_goal_12.mcap") else {
        return;
    };
    let log = std::fs::read(path).unwrap();
    let mut kept = BTreeSet::new();
    for part in 0..=64 {
        let length = MAGIC.len() + (log.len() - MAGIC.len()) * part / 64;
        let (sequences, losses) = messages(&log[..length]).await.unwrap();
        let complete = complete_messages(&log[..length]);
        assert_eq!(sequences.len(), complete, "cut at {length}");
        let whole = length == log.len();
        assert_eq!(losses.is_empty(), whole, "cut at {length}");
        kept.insert(complete);
    }
    assert_eq!(kept, BTreeSet::from([0, 1, 2]));
}

#[tokio::test]
async fn a_chunk_with_a_flipped_bit_is_lost_alone() {
    let log = Log {
        messages: 80,
        chunk: Some(300),
        compression: None,
        ..Log::default()
    }
    .write();
    let (whole, _) = read(&log).await.unwrap();
    let (first, body, _) = split(&log[record_ends(&log)[0].0..]).unwrap();
    assert_eq!(first, op::CHUNK);
    let middle = record_ends(&log)[0].0 + FRAME as usize + body.len() - 10;
    let mut flipped = log.clone();
    flipped[middle] ^= 1;
    for bytes in [flipped.clone(), flipped[..log.len() - 1].to_vec()] {
        let (sequences, losses) = read(&bytes).await.unwrap();
        assert!(sequences.len() < whole.len() && sequences.len() > whole.len() / 2);
        assert_eq!(losses.losses()[&Reason::BadChecksum].count, 1);
    }
}

/// Nothing but the checksum of all data says that a payload outside chunks was another one.
#[tokio::test]
async fn a_flipped_bit_outside_chunks_is_counted_and_read_as_it_is() {
    for (indexed, payload) in [(true, 40), (false, 40), (true, 600_000), (false, 600_000)] {
        let log = Log {
            messages: 24,
            payload,
            chunk: None,
            indexed,
            ..Log::default()
        }
        .write();
        let (_, losses) = messages(&log).await.unwrap();
        assert!(losses.is_empty(), "{:?}", losses.entries());
        let mut flipped = log.clone();
        let text = b"message 000020";
        let at = log.windows(text.len()).position(|w| w == text).unwrap();
        flipped[at] ^= 1;
        let (sequences, losses) = messages(&flipped).await.unwrap();
        assert_eq!(sequences.len(), 24);
        let entries = losses.entries();
        assert_eq!(entries.len(), 1, "{entries:?}");
        assert_eq!(entries[0].reason, Reason::BadData);
        assert_eq!((entries[0].loss.count, entries[0].loss.bytes), (1, 0));
        // Zero stands for a checksum that nobody made.
        let end = entries[0].offset as usize;
        assert_eq!(flipped[end], op::DATA_END);
        flipped[end + FRAME as usize..][..4].fill(0);
        let (_, losses) = messages(&flipped).await.unwrap();
        assert!(losses.is_empty(), "{:?}", losses.entries());
    }
}

/// A log of a chunk of two messages with a checksum of its own, and a message beside it; with the checksum of all data.
fn beside_a_chunk(summed_up: bool) -> Vec<u8> {
    let topic = channel(1, 0, "/a", "json");
    let inner = [message(1, 0, b"{}"), message(1, 1, b"{}")].concat();
    let size = inner.len() as u64;
    let chunk = checked_chunk(size, crc32fast::hash(&inner), "", &inner);
    let (offset, length, listed) = (first() + topic.len() as u64, chunk.len() as u64, [(1, 2)]);
    let summary = match summed_up {
        true => vec![
            topic.clone(),
            chunk_index_of((1, 2), offset, length, size, &listed),
            statistics((1, 3), 1, &[(1, 3)]),
        ],
        false => Vec::new(),
    };
    let loose = message(1, 2, b"{\"volts\": 12.25}");
    let mut log = file(&[topic, chunk, message_index(1, 2), loose], &summary);
    let end = data_end(&log);
    let crc = crc32fast::hash(&log[..end]);
    log[end + FRAME as usize..][..4].copy_from_slice(&crc.to_le_bytes());
    log
}

/// Where the record is that ends the data of a log.
fn data_end(log: &[u8]) -> usize {
    let mut at = MAGIC.len();
    while log[at] != op::DATA_END {
        at += split(&log[at..]).unwrap().2;
    }
    at
}

/// What reading all of a log finds wrong, and how many messages it holds to no checksum.
async fn surveyed(log: &[u8]) -> (Vec<(Reason, String)>, u64) {
    let dataset = opened(&context(1), log).await.unwrap();
    let parts = dataset.parts();
    let unchecked = parts[0].survey().await.unwrap().unchecked;
    let entries = dataset.losses.entries().into_iter();
    let found = entries.map(|entry| (entry.reason, entry.detail));
    (found.collect(), unchecked)
}

#[tokio::test]
async fn a_flipped_bit_beside_chunks_with_checksums_is_counted_by_who_reads_everything() {
    for summed_up in [false, true] {
        let log = beside_a_chunk(summed_up);
        assert_eq!(surveyed(&log).await, (vec![], 0));
        let flipped = |what: &[u8]| {
            let mut flipped = log.clone();
            let at = log.windows(what.len()).position(|bytes| bytes == what);
            flipped[at.unwrap()] ^= 1;
            flipped
        };
        let beside = flipped(b"volts");
        let (found, unchecked) = surveyed(&beside).await;
        assert_eq!((found.len(), unchecked), (1, 0), "{found:?}");
        assert_eq!(found[0].0, Reason::BadData);
        let said = "what differs is outside of chunks, which match theirs";
        assert!(found[0].1.ends_with(said), "{found:?}");
        // The chunk says that it is damaged, and then all data say nothing more.
        let (found, unchecked) = surveyed(&flipped(b"{}")).await;
        let reasons: Vec<Reason> = found.iter().map(|(reason, _)| *reason).collect();
        assert!(reasons.contains(&Reason::BadChecksum), "{found:?}");
        assert!(!reasons.contains(&Reason::BadData), "{found:?}");
        assert_eq!(unchecked, 1);
        // Nobody made a checksum.
        let mut bare = beside;
        let end = data_end(&bare);
        bare[end + FRAME as usize..][..4].fill(0);
        assert_eq!(surveyed(&bare).await, (vec![], 1));
    }
}

/// Who reads all of a log for its digest compares what nobody has compared by then, and the index that is kept says it.
#[tokio::test]
async fn a_flipped_bit_beside_chunks_is_counted_by_who_digests_the_log() {
    let digested = async |log: &[u8]| {
        let dataset = opened(&context(1), log).await.unwrap();
        let part = dataset.parts().remove(0);
        assert!(part.index.sum.is_some() && dataset.losses.is_empty());
        let digest = dataset.sessions[0].fingerprint(&AtomicU64::new(0)).await;
        let index = part.index_since();
        assert_eq!(index.sum, None);
        let reasons = |entries: Vec<Entry>| -> Vec<Reason> {
            entries.iter().map(|entry| entry.reason).collect()
        };
        let (kept, noted) = (reasons(index.losses), reasons(dataset.losses.entries()));
        assert_eq!(kept, noted);
        (digest.unwrap(), kept)
    };
    let log = beside_a_chunk(true);
    let (digest, found) = digested(&log).await;
    assert!(found.is_empty(), "{found:?}");
    let at = log.windows(5).position(|bytes| bytes == b"volts").unwrap();
    let mut flipped = log.clone();
    flipped[at] ^= 1;
    let (of_flipped, found) = digested(&flipped).await;
    assert_eq!(found, [Reason::BadData]);
    assert_ne!(of_flipped, digest);
}

/// Every chunk that is left matches its own checksum, and nothing was counted: the checksum of all data alone says that one is
/// gone.
#[tokio::test]
async fn a_chunk_that_is_gone_is_counted_by_the_checksum_of_all_data() {
    let log = Log {
        chunk: Some(300),
        indexed: false,
        ..Log::default()
    }
    .write();
    assert!(messages(&log).await.unwrap().1.is_empty());
    let mut cut = without_chunk(&log, 2);
    let (sequences, losses) = messages(&cut).await.unwrap();
    assert!((20..60).contains(&sequences.len()));
    let reasons: Vec<Reason> = losses.losses().into_keys().collect();
    assert_eq!(reasons, [Reason::BadData]);
    // Nobody made one.
    let end = data_end(&cut);
    cut[end + FRAME as usize..][..4].fill(0);
    assert!(messages(&cut).await.unwrap().1.is_empty());
}

/// Of a log with a sound summary, whose message indexes nobody needs.
#[tokio::test]
async fn a_flipped_bit_between_chunks_is_counted_by_who_reads_everything() {
    let mut log = Log {
        chunk: Some(300),
        ..Log::default()
    }
    .write();
    assert_eq!(surveyed(&log).await, (vec![], 0));
    let mut places = record_places(&log).into_iter();
    let index = places.find(|(opcode, _)| *opcode == op::MESSAGE_INDEX);
    log[index.unwrap().1.end - 1] ^= 1;
    assert!(messages(&log).await.unwrap().1.is_empty());
    let (found, unchecked) = surveyed(&log).await;
    assert_eq!((found.len(), unchecked), (1, 0), "{found:?}");
    assert_eq!(found[0].0, Reason::BadData);
}

#[tokio::test]
async fn a_summary_that_lies_is_not_believed() {
    let log = Log {
        messages: 24,
        chunk: Some(300),
        ..Log::default()
    }
    .write();
    // A tail that belongs to a longer file: all of its offsets point elsewhere.
    let longer = Log {
        messages: 60,
        chunk: Some(300),
        ..Log::default()
    }
    .write();
    let data = record_ends(&log).iter().rfind(|(_, n)| *n < 24).unwrap().0;
    let tail = longer.len() - 400;
    let lying = [&log[..data], &longer[tail..]].concat();
    let (sequences, _) = read(&lying).await.unwrap();
    assert!(sequences.len() >= expected(&record_ends(&log), data));
}

/// What `cat` makes of two logs, and messages behind the end of the data, are told.
#[tokio::test]
async fn what_lies_behind_an_end_is_counted() {
    let log = Log {
        messages: 6,
        chunk: None,
        indexed: false,
        ..Log::default()
    }
    .write();
    let (sequences, losses) = messages(&log).await.unwrap();
    assert!(sequences.len() == 6 && losses.is_empty());
    let two = [log.clone(), log.clone()].concat();
    let (sequences, losses) = messages(&two).await.unwrap();
    let told: Vec<String> = losses.told().into_keys().collect();
    assert!(
        sequences.len() >= 6 && told[0].contains("behind the end of the log"),
        "{told:?}"
    );
    // The last message, once more behind the record that ends the data.
    let ends = record_ends(&log);
    let body = |opcode: u8| {
        let mut starts = [MAGIC.len()]
            .into_iter()
            .chain(ends.iter().map(|(end, _)| *end));
        let start = starts.find(|start| log[*start] == opcode).unwrap();
        let end = ends
            .iter()
            .map(|(end, _)| *end)
            .find(|end| *end > start)
            .unwrap();
        (start, end)
    };
    let (message, data_end) = (body(op::MESSAGE), body(op::DATA_END));
    let late = [
        &log[..data_end.1],
        &log[message.0..message.1],
        &log[data_end.1..],
    ]
    .concat();
    let (sequences, losses) = messages(&late).await.unwrap();
    let told: Vec<String> = losses.told().into_keys().collect();
    assert!(
        sequences.len() == 6 && told[0].contains("behind the end of the data"),
        "{told:?}"
    );
}

#[tokio::test]
async fn undecodable_messages_are_skipped_and_counted() {
    let log = Log {
        messages: 4,
        compression: None,
        ..Log::default()
    }
    .write();
    // The length of the first string becomes larger than its payload; checksums are taken away with the summary.
    let at = log.windows(4).position(|w| w == b"mess").unwrap() - 4;
    let mut bad = Log {
        messages: 4,
        compression: None,
        chunk: None,
        indexed: false,
        ..Log::default()
    }
    .write();
    let bare = bad.windows(4).position(|w| w == b"mess").unwrap() - 4;
    assert!(at > 0);
    bad[bare..bare + 4].copy_from_slice(&1000u32.to_le_bytes());
    let (context, dataset) = open_in(in_memory(&bad).await, 1).await.unwrap();
    assert_eq!(count(&context, "SELECT * FROM \"/text\"").await, 1);
    assert_eq!(count(&context, "SELECT sequence FROM \"/text\"").await, 1);
    assert_eq!(dataset.losses.losses()[&Reason::Undecodable].count, 1);
    assert_eq!(dataset.losses.entries()[0].topic, "/text");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn random_damage_never_panics(
        hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        cut in any::<prop::sample::Index>(),
        whole in any::<bool>(),
        chunked in any::<bool>(),
    ) {
        let chunk = chunked.then_some(300);
        let mut log = Log { messages: 12, chunk, compression: None, ..Log::default() }.write();
        for (index, byte) in hits {
            let at = index.index(log.len());
            log[at] = byte;
        }
        if !whole {
            log.truncate(cut.index(log.len()));
        }
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        if let Some((sequences, _)) = runtime.block_on(read(&log)) {
            prop_assert!(sequences.len() <= 12 * 2);
        }
    }
}
