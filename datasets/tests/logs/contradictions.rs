//! Summaries, chunks and definitions that contradict each other: the file is read, or what was read is counted.
#![allow(clippy::unwrap_used, clippy::panic)]

use evermap_datasets::Reason;
use evermap_datasets::fault::fault_of;
use evermap_datasets::log::index::LogIndex;
use evermap_datasets::log::record::{FRAME, MAGIC};
use mcap::records::op;

use crate::common::by_hand::{
    channel, chunk, chunk_index, chunk_index_of, file, first, message, message_at, message_index,
    record, schema, statistics, text, transform, transforms,
};
use crate::common::{Log, count, in_memory, open_in, packed, record_places, without_chunk};
use crate::hostile::{messages, opened, rows};

/// A chunk of five messages of `/a` and of `/b` each, at 1 to 5 ns, with its message indexes.
fn two_topics() -> (Vec<u8>, u64, u64) {
    let definitions = [channel(1, 0, "/a", "json"), channel(2, 0, "/b", "json")].concat();
    let inner = [definitions, messages(&[1, 2], 5)].concat();
    let whole = chunk(inner.len() as u64, "", &inner);
    let length = whole.len() as u64;
    (whole, length, inner.len() as u64)
}

/// A log of [`two_topics`], by what its summary says of channels, times and numbers of messages.
fn summed_up(listed: &[(u16, u64)], times: (u64, u64), counted: (u64, u64)) -> Vec<u8> {
    let (whole, length, size) = two_topics();
    let indexes = listed.iter().map(|(id, n)| message_index(*id, *n as usize));
    let summary = [
        channel(1, 0, "/a", "json"),
        channel(2, 0, "/b", "json"),
        chunk_index_of(times, first(), length, size, listed),
        statistics(counted, 2, listed),
    ];
    file(&[whole, indexes.collect::<Vec<_>>().concat()], &summary)
}

/// What `inspect` finds, as it reads everything.
async fn surveyed(log: &[u8]) -> Vec<Reason> {
    let (_, dataset) = opened(log).await;
    let parts = dataset.parts();
    parts[0].survey().await.unwrap();
    dataset.losses.losses().into_keys().collect()
}

#[tokio::test]
async fn a_true_summary_is_believed_without_loss() {
    let log = summed_up(&[(1, 5), (2, 5)], (1, 5), (1, 5));
    assert_eq!(rows(&log, "/a").await, (5, vec![]));
    assert!(surveyed(&log).await.is_empty());
}

#[tokio::test]
async fn what_a_chunk_holds_beside_what_is_said_of_it_is_counted() {
    let hidden = summed_up(&[(1, 5)], (1, 5), (1, 5));
    assert_eq!(
        rows(&hidden, "/a").await,
        (5, vec![(Reason::BadSummary, 5)])
    );
    assert!(surveyed(&hidden).await.contains(&Reason::BadSummary));
    let early = summed_up(&[(1, 5), (2, 5)], (1, 3), (1, 3));
    assert_eq!(rows(&early, "/a").await, (5, vec![(Reason::BadSummary, 4)]));
    assert!(surveyed(&early).await.contains(&Reason::BadSummary));
}

#[tokio::test]
async fn a_summary_that_contradicts_itself_is_not_believed() {
    // The times of chunks are not those that were counted.
    let other_times = summed_up(&[(1, 5), (2, 5)], (1, 3), (1, 5));
    assert_eq!(rows(&other_times, "/a").await, (5, vec![]));
    let backwards = summed_up(&[(1, 5), (2, 5)], (5, 1), (1, 5));
    assert_eq!(rows(&backwards, "/a").await, (5, vec![]));
    // The message indexes are those of two channels, one is listed.
    let (whole, length, size) = two_topics();
    let mut entry = chunk_index(first(), length, size, &[(1, 5), (2, 5)]);
    let lists = 9 + 32;
    entry[lists] = 10;
    entry.drain(lists + 4 + 10..lists + 4 + 20);
    let body = (entry.len() as u64 - 9).to_le_bytes();
    entry[1..9].copy_from_slice(&body);
    let summary = [
        channel(1, 0, "/a", "json"),
        channel(2, 0, "/b", "json"),
        entry,
        statistics((1, 9), 2, &[(1, 5)]),
    ];
    let indexes = [message_index(1, 5), message_index(2, 5)].concat();
    assert_eq!(
        rows(&file(&[whole, indexes], &summary), "/b").await,
        (5, vec![])
    );
}

/// Nobody says what chunks hold, or what is said of them is forged as well: only who reads them finds out.
#[tokio::test]
async fn messages_that_are_counted_and_not_there_are_said_by_who_reads_everything() {
    let (whole, length, size) = two_topics();
    let said = [(1, 5), (2, 8)];
    let counted = statistics((1, 5), 2, &said);
    let [a, b] = [(1, "/a"), (2, "/b")].map(|(id, topic)| channel(id, 0, topic, "json"));
    let entry = |listed: &[(u16, u64)]| chunk_index_of((1, 5), first(), length, size, listed);
    let unlisted = [a.clone(), b.clone(), entry(&[]), counted.clone()];
    let unlisted = file(std::slice::from_ref(&whole), &unlisted);
    let indexes = [message_index(1, 5), message_index(2, 8)].concat();
    let forged = [a.clone(), b, entry(&said), counted];
    let forged = file(&[whole, indexes], &forged);
    for log in [unlisted, forged] {
        for topic in ["/a", "/b"] {
            assert_eq!(rows(&log, topic).await, (5, vec![(Reason::BadSummary, 1)]));
        }
        let (_, dataset) = opened(&log).await;
        assert!(dataset.losses.is_empty());
    }

    // Two chunks: who asks for the times of one cannot tell.
    let early = [a.clone(), messages(&[1], 3)].concat();
    let late = [message_at(1, 3, 20, b"{}"), message_at(1, 4, 22, b"{}")].concat();
    let chunks = [&early, &late].map(|inner| chunk(inner.len() as u64, "", inner));
    let [before, behind] = [&chunks[0], &chunks[1]].map(|chunk| chunk.len() as u64);
    let summary = [
        a,
        chunk_index_of((1, 3), first(), before, early.len() as u64, &[]),
        chunk_index_of((20, 22), first() + before, behind, late.len() as u64, &[]),
        statistics((1, 22), 1, &[(1, 9)]),
    ];
    let log = file(&chunks, &summary);
    let (context, dataset) = opened(&log).await;
    let some = "SELECT * FROM \"/a\" WHERE log_time < TIMESTAMP '1970-01-01T00:00:00.000000010Z'";
    assert_eq!(count(&context, some).await, 3);
    assert!(dataset.losses.is_empty(), "{:?}", dataset.losses.lines());
    assert_eq!(count(&context, "SELECT * FROM \"/a\"").await, 5);
    let said: Vec<String> = dataset.losses.told().into_keys().collect();
    let expected = "expected 9 messages as the summary says, found 5";
    assert!(said.len() == 1 && said[0].contains(expected), "{said:?}");
}

/// The summary of a log that a chunk was cut out of leads nowhere: what it counts is said all the same. So it is where the
/// footer was led to the summary again.
#[tokio::test]
async fn messages_that_went_with_a_chunk_are_counted_by_whatever_opens_the_log() {
    let log = Log {
        chunk: Some(300),
        ..Log::default()
    };
    let whole = log.write();
    let chunks = record_places(&whole).into_iter();
    let chunks = chunks.filter(|(opcode, _)| *opcode == op::CHUNK).count();
    assert!(chunks > 4);
    for which in [0, 2, chunks - 1] {
        for led in [false, true] {
            let mut cut = without_chunk(&whole, which);
            let mut places = record_places(&cut).into_iter();
            let (_, end) = places.find(|(opcode, _)| *opcode == op::DATA_END).unwrap();
            cut[end.start + FRAME as usize..][..4].fill(0);
            if led {
                let footer = cut.len() - MAGIC.len() - 20;
                let start = u64::from_le_bytes(*cut[footer..].first_chunk().unwrap());
                let start = start - (whole.len() - cut.len()) as u64;
                cut[footer..footer + 8].copy_from_slice(&start.to_le_bytes());
                cut[footer + 16..footer + 20].fill(0);
            }
            let (context, dataset) = opened(&cut).await;
            let found = count(&context, "SELECT sequence FROM messages").await;
            assert!((20..60).contains(&found), "{found}");
            let entries = dataset.losses.entries();
            let said: Vec<_> = entries.iter().map(|e| (e.reason, &*e.detail)).collect();
            let short = format!("expected 60 messages as the summary says, found {found}");
            assert_eq!(said, [(Reason::BadSummary, &*short)]);
            assert!(dataset.parts()[0].index.unbelieved);
        }
    }
    let (_, dataset) = opened(&whole).await;
    assert!(dataset.losses.is_empty() && !dataset.parts()[0].index.unbelieved);
}

/// The sum is right, and one of the channels is described nowhere.
#[tokio::test]
async fn messages_that_are_counted_of_a_channel_that_nobody_describes_are_said() {
    let (whole, length, size) = two_topics();
    let listed = [(1, 5), (2, 5)];
    let summary = [
        channel(1, 0, "/a", "json"),
        channel(2, 0, "/b", "json"),
        chunk_index_of((1, 5), first(), length, size, &listed),
        statistics((1, 5), 2, &[(1, 5), (3, 5)]),
    ];
    let indexes = [message_index(1, 5), message_index(2, 5)].concat();
    let log = file(&[whole, indexes], &summary);
    assert_eq!(rows(&log, "/b").await, (5, vec![(Reason::BadSummary, 1)]));
    let (_, dataset) = opened(&log).await;
    let said =
        "channel 3, which nobody describes: expected 5 messages as the summary says, found 0";
    assert_eq!(dataset.losses.entries()[0].detail, said);
}

#[tokio::test]
async fn an_attachment_whose_entry_covers_a_chunk_hides_none() {
    let (whole, _, _) = two_topics();
    let attachment = [&[0; 16][..], &text(b"a.txt"), &text(b""), &[0; 12]].concat();
    let attachment = record(9, &attachment);
    let covered = (attachment.len() + whole.len()) as u64;
    let entry = |length: u64| {
        let place = [first().to_le_bytes(), length.to_le_bytes()].concat();
        record(
            10,
            &[&place[..], &[0; 24], &text(b"a.txt"), &text(b"")].concat(),
        )
    };
    let log = file(
        &[attachment, whole],
        &[entry(covered), statistics((0, 0), 0, &[])],
    );
    assert_eq!(rows(&log, "/b").await, (5, vec![]));
}

#[tokio::test]
async fn a_number_that_is_defined_twice_is_counted() {
    let other = [
        [channel(1, 0, "/a", "json"), channel(1, 0, "/b", "json")],
        [
            schema(1, "A", "jsonschema", b"{}"),
            schema(1, "A", "jsonschema", b"{ }"),
        ],
    ];
    for definitions in other {
        let own = channel(2, 0, "/t", "json");
        let inner = [definitions.concat(), own.clone(), messages(&[2], 3)].concat();
        let (size, whole) = (inner.len() as u64, chunk(inner.len() as u64, "", &inner));
        let expected = (3, vec![(Reason::BadRecord, 1)]);
        let read = file(std::slice::from_ref(&whole), &[]);
        assert_eq!(rows(&read, "/t").await, expected);
        let entry = chunk_index_of((1, 3), first(), whole.len() as u64, size, &[(2, 3)]);
        let first_ones = [definitions[0].clone(), own];
        let counted = statistics((1, 3), 1, &[(2, 3)]);
        let summary = [first_ones.concat(), entry, counted];
        let indexed = file(&[whole, message_index(2, 3)], &summary);
        assert_eq!(rows(&indexed, "/t").await, expected);
    }
    // The same again is no loss.
    let twice = [channel(1, 0, "/t", "json"), channel(1, 0, "/t", "json")].concat();
    let inner = [twice, messages(&[1], 3)].concat();
    let log = file(&[chunk(inner.len() as u64, "", &inner)], &[]);
    assert_eq!(rows(&log, "/t").await, (3, vec![]));
}

#[tokio::test]
async fn frames_of_lz4_behind_each_other_are_one_chunk() {
    let one = [channel(1, 0, "/t", "json"), messages(&[1], 3)].concat();
    let two = messages(&[1], 4);
    let both = [packed("lz4", &one), packed("lz4", &two)].concat();
    let size = (one.len() + two.len()) as u64;
    let log = file(&[chunk(size, "lz4", &both)], &[]);
    assert_eq!(rows(&log, "/t").await, (7, vec![]));
    // Of one that says less, what lies behind is counted.
    let log = file(&[chunk(one.len() as u64, "lz4", &both)], &[]);
    assert_eq!(
        rows(&log, "/t").await,
        (3, vec![(Reason::BadCompression, 1)])
    );
}

#[tokio::test]
async fn frames_of_lz4_that_hold_nothing_are_skipped_and_what_is_no_frame_is_counted() {
    let inner = [channel(1, 0, "/t", "json"), messages(&[1], 3)].concat();
    let frame = packed("lz4", &inner);
    let nothing = [&[0x5A, 0x2A, 0x4D, 0x18, 4, 0, 0, 0][..], b"note"].concat();
    let whole = (3, vec![]);
    let damaged = (3, vec![(Reason::BadCompression, 1)]);
    for (data, expected) in [
        ([&nothing[..], &frame].concat(), &whole),
        ([&frame[..], &nothing].concat(), &whole),
        ([&frame[..], b"more"].concat(), &damaged),
        (frame[..frame.len() - 4].to_vec(), &damaged),
    ] {
        let log = file(&[chunk(inner.len() as u64, "lz4", &data)], &[]);
        assert_eq!(rows(&log, "/t").await, *expected);
    }
}

#[tokio::test]
async fn times_behind_the_last_instant_are_counted() {
    let definition = channel(1, 0, "/t", "json");
    let inner = [
        definition.clone(),
        message(1, 0, b"{}"),
        message_at(1, 1, 1 << 63, b"{}"),
    ]
    .concat();
    let expected = (2, vec![(Reason::Senseless, 1)]);
    let chunked = file(&[chunk(inner.len() as u64, "", &inner)], &[]);
    let loose = file(&[inner], &[]);
    for log in [chunked, loose] {
        assert_eq!(rows(&log, "/t").await, expected);
        assert_eq!(surveyed(&log).await, [Reason::Senseless]);
    }
}

#[tokio::test]
async fn an_entry_that_is_longer_than_its_chunk_hides_nothing() {
    let (whole, length, size) = two_topics();
    let both = [whole.clone(), whole].concat();
    let summary = [
        channel(1, 0, "/a", "json"),
        channel(2, 0, "/b", "json"),
        chunk_index_of((1, 5), first(), 2 * length, size, &[(1, 5), (2, 5)]),
        statistics((1, 5), 2, &[(1, 5), (2, 5)]),
    ];
    let indexes = [message_index(1, 5), message_index(2, 5)].concat();
    let log = file(&[both, indexes], &summary);
    assert_eq!(rows(&log, "/a").await, (5, vec![(Reason::BadIndex, 1)]));
}

/// The chunk that an entry leads into the middle of has none of its own. All of it is read where the records of the file follow each
/// other, and behind one that is damaged what other entries lead to.
#[tokio::test]
async fn an_entry_that_leads_into_a_chunk_hides_no_message() {
    let (whole, length, size) = two_topics();
    let indexes = [message_index(1, 5), message_index(2, 5)].concat();
    let listed = [(1, 5), (2, 5)];
    let next = length + indexes.len() as u64;
    let data = [whole.clone(), indexes.clone()].concat();
    let inside = |number: u64, by: u64| {
        let place = (first() + number * next + by, length - by);
        chunk_index_of((1, 5), place.0, place.1, size, &listed)
    };
    let log = |entries: [(u64, u64); 3], data: &[Vec<u8>]| {
        let all = [(1, 15), (2, 15)];
        let entries = entries.map(|(number, by)| inside(number, by)).concat();
        let definitions = [channel(1, 0, "/a", "json"), channel(2, 0, "/b", "json")];
        let summary = [definitions.concat(), entries, statistics((1, 5), 2, &all)];
        file(data, &summary)
    };
    let chunks = [data.clone(), data.clone(), data.clone()];
    for by in [1, 20, length - 1] {
        for entries in [
            [(0, 0), (1, by), (2, 0)],
            [(0, by), (1, 0), (2, 0)],
            [(0, 0), (1, 0), (2, by)],
            [(0, by), (1, by), (2, by)],
        ] {
            let log = log(entries, &chunks);
            for topic in ["/a", "/b"] {
                assert_eq!(rows(&log, topic).await, (15, vec![]), "{entries:?}");
            }
            assert!(surveyed(&log).await.is_empty());
        }
    }
    let mut damaged = chunks.clone();
    damaged[1][..9].fill(0);
    let log = log([(0, 0), (1, 20), (2, 0)], &damaged);
    let (found, lost) = rows(&log, "/a").await;
    assert_eq!(found, 10);
    assert!(!lost.is_empty());
}

/// A thousand channels of one schema have it once, on disk and in memory.
#[tokio::test]
async fn a_schema_is_kept_once() {
    let text = vec![b' '; 100_000];
    let definitions = (1..=1000).map(|id| channel(id, 1, &format!("/t{id}"), "json"));
    let definitions = definitions.collect::<Vec<_>>().concat();
    let schema = schema(1, "A", "jsonschema", &text);
    let (_, dataset) = opened(&file(&[schema, definitions], &[])).await;
    let kept = serde_json::to_string(&dataset.parts()[0].index).unwrap();
    assert!(kept.len() < 400_000, "{} B", kept.len());
    let again: LogIndex = serde_json::from_str(&kept).unwrap();
    assert_eq!(again, dataset.parts()[0].index);
}

/// Each node repeats what is fixed; only what is said in two ways is counted, however many read at once.
#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_is_fixed_in_two_ways_is_counted() {
    let first = [
        transform(1, 0, ["base", "front"], 1.0),
        transform(1, 1, ["base", "left"], 2.0),
        transform(1, 2, ["base", "right"], 3.0),
        transform(2, 3, ["odom", "base"], 4.0),
    ]
    .concat();
    let agreed = [
        transform(1, 4, ["/base", "/front"], 1.000_000_5),
        transform(1, 5, ["base", "left"], 2.0),
        transform(2, 6, ["map", "base"], 5.0),
    ]
    .concat();
    let otherwise = [
        transform(1, 4, ["base", "front"], 1.0),
        transform(1, 5, ["mast", "left"], 2.0),
        transform(1, 6, ["base", "right"], 3.5),
        transform(1, 7, ["base", "right"], 3.5),
    ]
    .concat();
    let log = |second: &[u8]| {
        let definitions = [
            transforms(1),
            channel(1, 1, "/tf_static", "json"),
            channel(2, 1, "/tf", "json"),
        ];
        let chunks = [&first[..], second].map(|inner| chunk(inner.len() as u64, "", inner));
        file(&[definitions.concat(), chunks.concat()], &[])
    };
    for partitions in [1, 2] {
        let read = async |log: &[u8]| {
            let (context, dataset) = open_in(in_memory(log).await, partitions).await.unwrap();
            // What is read twice is counted once.
            for rows in ["SELECT * FROM transforms", "SELECT child FROM transforms"] {
                count(&context, rows).await;
            }
            dataset.losses.told().into_iter().collect::<Vec<_>>()
        };
        assert_eq!(read(&log(&agreed)).await, []);
        let said = "memory://logs/log.mcap: frames with contradicting fixed transforms on /tf_static: \
             frame `left` is fixed to `base` and to `mast`; \
             frame `right` is fixed to `base` in two ways, 0.5 m and 0° from each other";
        assert_eq!(read(&log(&otherwise)).await, [(said.to_owned(), 2)]);
    }
}

/// Whichever transform comes last, and however often one is read.
#[tokio::test]
async fn frames_that_are_fixed_to_each_other_in_a_circle_are_told() {
    let mounts = [
        ["base", "mast"],
        ["mast", "front"],
        ["front", "base"],
        ["odd", "odd"],
        ["base", "left"],
    ];
    for turn in 0..mounts.len() {
        let mut turned = mounts;
        turned.rotate_left(turn);
        let said: Vec<u8> = (1..)
            .zip(turned)
            .flat_map(|(stamp, frames)| transform(1, stamp, frames, 1.0))
            .collect();
        let definitions = [transforms(1), channel(1, 1, "/tf_static", "json")].concat();
        let log = file(&[definitions, chunk(said.len() as u64, "", &said)], &[]);
        let (context, dataset) = open_in(in_memory(&log).await, 1).await.unwrap();
        for rows in ["SELECT * FROM transforms", "SELECT child FROM transforms"] {
            count(&context, rows).await;
        }
        let told: Vec<_> = dataset.losses.told().into_iter().collect();
        let said = "memory://logs/log.mcap: circles of fixed transforms on /tf_static: \
             `base` is fixed to `front` is fixed to `mast` is fixed to `base`; `odd` is fixed to `odd`";
        assert_eq!(told, [(said.to_owned(), 2)], "{turn}");
    }
}

/// One session cannot be scanned apart: what is said names its schemas, and what can be asked.
#[tokio::test]
async fn a_topic_of_two_types_in_one_session_says_what_can_be_asked() {
    let log = file(
        &[
            schema(1, "a/msg/U", "ros2msg", b"uint8 x\n"),
            schema(2, "a/msg/V", "ros2msg", b"float64 x\n"),
            channel(1, 1, "/t", "cdr"),
            channel(2, 2, "/t", "cdr"),
            message(1, 0, &[0, 1, 0, 0, 7]),
            message(
                2,
                1,
                &[&[0_u8, 1, 0, 0][..], &2.5_f64.to_le_bytes()].concat(),
            ),
        ],
        &[],
    );
    let (context, _) = opened(&log).await;
    let error = match context.sql("SELECT * FROM \"/t\"").await {
        Ok(planned) => planned.collect().await.unwrap_err(),
        Err(error) => error,
    };
    let said = fault_of(&error).to_string();
    for part in [
        "UInt8 and Float64",
        "1 (a/msg/U), 2 (a/msg/V)",
        "by channel",
    ] {
        assert!(said.contains(part), "{said}");
    }
    let by_channel = "SELECT data FROM messages WHERE topic = '/t' AND channel = 2";
    assert_eq!(count(&context, by_channel).await, 1);
}
