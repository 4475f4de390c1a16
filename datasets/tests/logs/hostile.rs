//! Logs that claim what they do not hold, or leave out what they do: nothing is allocated for a claim, nothing is lost
//! without being counted, and what is bad takes nothing else with it.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::sync::Arc;

use crate::common::by_hand::{
    channel, chunk, chunk_index, file, first, message, message_index, record, schema, statistics,
    text,
};
use crate::common::{context, count, in_memory, open_in, packed};
use datafusion::execution::memory_pool::GreedyMemoryPool;
use datafusion::execution::runtime_env::RuntimeEnvBuilder;
use datafusion::prelude::{SessionConfig, SessionContext};
use evermap_datasets::fault::fault_of;
use evermap_datasets::log::index::LogIndex;
use evermap_datasets::{Dataset, Reason};
use evermap_schemas::Kind;
use object_store::ObjectStoreExt;
use object_store::path::Path;
use url::Url;

pub async fn opened(log: &[u8]) -> (SessionContext, Dataset) {
    open_in(in_memory(log).await, 1).await.unwrap()
}

/// Rows of a topic, and how many things of each kind were lost.
pub async fn rows(log: &[u8], topic: &str) -> (usize, Vec<(Reason, u64)>) {
    let (context, dataset) = opened(log).await;
    let rows = count(&context, &format!("SELECT * FROM \"{topic}\"")).await;
    let losses = dataset.losses.losses().into_iter();
    (
        rows,
        losses.map(|(reason, loss)| (reason, loss.count)).collect(),
    )
}

pub fn messages(of: &[u16], count: u32) -> Vec<u8> {
    let each = (0..count).flat_map(|n| of.iter().map(move |channel| message(*channel, n, b"{}")));
    each.collect::<Vec<_>>().concat()
}

#[tokio::test]
async fn records_that_do_not_belong_in_a_chunk_are_counted() {
    let inner = [
        channel(1, 0, "/t", "json"),
        message(1, 0, b"{}"),
        record(5, &[1, 0, 0, 0, 0]),
        record(6, b"a chunk in a chunk"),
        record(0x80, b"somebody's own"),
        message(1, 1, b"{}"),
    ]
    .concat();
    let log = file(&[chunk(inner.len() as u64, "", &inner)], &[]);
    assert_eq!(rows(&log, "/t").await, (2, vec![(Reason::BadRecord, 2)]));
}

#[tokio::test]
async fn what_a_summary_leaves_out_is_found_or_counted() {
    let definitions = [channel(1, 0, "/a", "json"), channel(2, 0, "/b", "json")].concat();
    let inner = [definitions, messages(&[1, 2], 5)].concat();
    let size = inner.len() as u64;
    let whole = chunk(size, "", &inner);
    let length = whole.len() as u64;
    let a = channel(1, 0, "/a", "json");
    let b = channel(2, 0, "/b", "json");
    // Nobody says how many channels there are: the file is read.
    let silent = file(
        std::slice::from_ref(&whole),
        &[a.clone(), chunk_index(first(), length, size, &[])],
    );
    assert_eq!(rows(&silent, "/b").await, (5, vec![]));
    // The chunk's entry leaves out a channel that has messages, by the statistics.
    let unlisted = [
        a.clone(),
        b.clone(),
        chunk_index(first(), length, size, &[(1, 5)]),
        statistics((1, 9), 2, &[(1, 5), (2, 5)]),
    ];
    let indexes = [message_index(1, 5), message_index(2, 5)].concat();
    let log = file(&[whole.clone(), indexes.clone()], &unlisted);
    assert_eq!(rows(&log, "/b").await, (5, vec![]));
    // The statistics are forged, too: whoever reads the chunk finds messages of nobody.
    let forged = [
        a,
        chunk_index(first(), length, size, &[(1, 5)]),
        statistics((1, 9), 1, &[(1, 5)]),
    ];
    let log = file(&[whole, message_index(1, 5)], &forged);
    assert_eq!(
        rows(&log, "/a").await,
        (5, vec![(Reason::UnknownChannel, 5)])
    );
    let (_, dataset) = opened(&log).await;
    let part = dataset.parts().remove(0);
    let found = part.survey().await.unwrap();
    assert_eq!((found.channels.len(), found.message_count()), (2, Some(10)));
    assert!(dataset.losses.losses().contains_key(&Reason::BadSummary));
}

#[tokio::test]
async fn sizes_that_are_only_claimed_cost_nothing() {
    let inner = [channel(1, 0, "/a", "json"), message(1, 0, b"{}")].concat();
    let whole = chunk(inner.len() as u64, "", &inner);
    let length = whole.len() as u64;
    let a = channel(1, 0, "/a", "json");
    // An index of sizes beyond all files.
    let claims = [
        a.clone(),
        chunk_index(first(), length, u64::MAX, &[]),
        chunk_index(u64::MAX, 0, u64::MAX, &[]),
    ];
    assert_eq!(
        rows(&file(std::slice::from_ref(&whole), &claims), "/a").await,
        (1, vec![])
    );
    // A header whose text is longer than any file.
    let header = record(1, &[&[0xFF; 4][..], &[b'x'; 20]].concat());
    let log = file(&[header, whole.clone()], &[]);
    assert_eq!(rows(&log, "/a").await.0, 1);
    // A chunk that claims two gigabytes and holds little, as its index does.
    let packed = zstd::bulk::compress(&inner, 3).unwrap();
    let claiming = chunk(2 << 30, "zstd", &packed);
    let log = file(&[claiming], &[]);
    let (found, losses) = rows(&log, "/a").await;
    assert_eq!((found, losses), (1, vec![(Reason::BadCompression, 1)]));
}

/// A chunk larger than the memory is refused before it is decompressed, however small its index says it is.
#[tokio::test]
async fn chunks_are_reserved_before_they_are_decompressed() {
    let payload = vec![b' '; 64 << 20];
    let inner = [channel(1, 0, "/a", "json"), message(1, 0, &payload)].concat();
    let packed = zstd::bulk::compress(&inner, 3).unwrap();
    assert!(packed.len() < 64 << 10);
    let whole = chunk(inner.len() as u64, "zstd", &packed);
    let modest = chunk_index(first(), whole.len() as u64, 100, &[]);
    let counted = record(
        11,
        &[
            &1_u64.to_le_bytes()[..],
            &[1, 0, 1, 0, 0, 0],
            &[0; 12],
            &[0; 16],
            &text(b""),
        ]
        .concat(),
    );
    let summary = [channel(1, 0, "/a", "json"), modest, counted];
    for log in [
        file(std::slice::from_ref(&whole), &[]),
        file(&[whole], &summary),
    ] {
        let pool = Arc::new(GreedyMemoryPool::new(16 << 20));
        let runtime = RuntimeEnvBuilder::new()
            .with_memory_pool(pool)
            .build_arc()
            .unwrap();
        runtime.register_object_store(&Url::parse("memory://logs").unwrap(), in_memory(&log).await);
        let context = SessionContext::new_with_config_rt(SessionConfig::new(), runtime.clone());
        let paths = ["memory://logs/log.mcap".to_owned()];
        let dataset = Dataset::open(&runtime, &paths, None).await.unwrap();
        dataset.register(&context).unwrap();
        let query = context.sql("SELECT log_time FROM messages").await.unwrap();
        let fault = fault_of(&query.collect().await.unwrap_err());
        assert_eq!(fault.kind, Kind::Resource, "{fault}");
    }
}

/// Of attachments, what is not asked for takes no memory.
#[tokio::test]
async fn attachments_are_listed_in_less_memory_than_they_hold() {
    let size = 24_u64 << 20;
    let attachment = [
        &[0_u8; 16][..],
        &text(b"map.bin"),
        &text(b"application/octet-stream"),
        &size.to_le_bytes(),
        &vec![7; size as usize],
        &[0; 4],
    ]
    .concat();
    let log = file(&[record(9, &attachment), channel(1, 0, "/t", "json")], &[]);
    let pool = Arc::new(GreedyMemoryPool::new(16 << 20));
    let runtime = RuntimeEnvBuilder::new()
        .with_memory_pool(pool)
        .build_arc()
        .unwrap();
    runtime.register_object_store(&Url::parse("memory://logs").unwrap(), in_memory(&log).await);
    let context = SessionContext::new_with_config_rt(SessionConfig::new(), runtime.clone());
    let paths = ["memory://logs/log.mcap".to_owned()];
    let dataset = Dataset::open(&runtime, &paths, None).await.unwrap();
    dataset.register(&context).unwrap();
    let listed = "SELECT name FROM attachments WHERE size = 25165824 AND media_type LIKE '%stream'";
    assert_eq!(count(&context, listed).await, 1);
    let counted = context.sql("SELECT count(*) FROM attachments").await;
    assert_eq!(counted.unwrap().collect().await.unwrap().len(), 1);
    let held = context.sql("SELECT data FROM attachments").await.unwrap();
    let fault = fault_of(&held.collect().await.unwrap_err());
    assert_eq!(fault.kind, Kind::Resource, "{fault}");
    assert!(dataset.losses.is_empty(), "{:?}", dataset.losses.entries());
}

/// Its bytes are good whatever it is called; who lists attachments calls it as who reads it.
#[tokio::test]
async fn attachments_whose_names_are_not_utf_8_have_escapes_in_them() {
    let attachment = |name: &[u8], crc: u32| {
        let body = [
            &[0_u8; 16][..],
            &text(name),
            &text(b"a/b\xff"),
            &3_u64.to_le_bytes(),
            b"map",
            &crc.to_le_bytes(),
        ]
        .concat();
        record(9, &body)
    };
    let records = [attachment(b"caf\xe9.map", 0), attachment(b"torn", 7)];
    let log = file(&records, &[]);
    let (context, dataset) = opened(&log).await;
    let listed = dataset.parts()[0].attachments().await.unwrap();
    let [found] = listed.as_slice() else {
        panic!("{listed:?}");
    };
    let named = ("caf\\xE9.map", "a/b\\xFF");
    assert_eq!((found.name.as_str(), found.media_type.as_str()), named);
    let named = "name = 'caf\\xE9.map' AND media_type = 'a/b\\xFF'";
    for asked in ["size = 3", "data = CAST('map' AS bytea)"] {
        let found = format!("SELECT name FROM attachments WHERE {named} AND {asked}");
        assert_eq!(count(&context, &found).await, 1, "{asked}");
    }
    assert_eq!(count(&context, "SELECT data FROM attachments").await, 1);
    let losses = dataset.losses.losses();
    assert_eq!(losses.keys().collect::<Vec<_>>(), [&Reason::BadAttachment]);
}

/// Who lists metadata says of what is damaged the same as who reads it.
#[tokio::test]
async fn damaged_metadata_is_counted_by_who_lists_it_and_by_who_reads_it() {
    let entries = |texts: &[&[u8]]| {
        let texts = texts.iter().flat_map(|bytes| text(bytes));
        text(&texts.collect::<Vec<u8>>())
    };
    let metadata =
        |name: &[u8], entries: &[u8]| record(12, &[text(name), entries.to_vec()].concat());
    let classes: &[&[u8]] = &[b"1", b"road", b"2", b"car"];
    let good = metadata(b"good", &entries(classes));
    let twice = entries(&[b"1", b"road", b"2", b"car", b"1", b"tree"]);
    let beyond = [&999_u32.to_le_bytes()[..], &entries(&[b"1", b"road"])[4..]].concat();
    for (bad, said) in [
        (
            metadata(b"bad", &twice),
            "expected each key once, found \"1\" twice",
        ),
        (
            metadata(b"bad", &beyond),
            "expected entries of at most 13 B, found a claim of 999 B",
        ),
        (
            metadata(b"b\xff", &entries(classes)),
            "expected a name in UTF-8, found another one behind \"b\"",
        ),
        (
            metadata(b"bad", &entries(&[b"1", b"r\xff"])),
            "expected a value in UTF-8, found another one behind \"r\"",
        ),
    ] {
        let log = file(&[good.clone(), bad], &[]);
        let (context, dataset) = opened(&log).await;
        assert_eq!(count(&context, "SELECT * FROM metadata").await, 1);
        let read = dataset.losses.entries();
        let told: Vec<_> = read.iter().map(|e| (e.reason, &*e.detail)).collect();
        assert_eq!(told, [(Reason::BadAttachment, said)]);
        let (_, dataset) = opened(&log).await;
        let names = dataset.parts()[0].metadata_names().await.unwrap();
        assert_eq!(names, ["good"]);
        assert_eq!(dataset.losses.entries(), read);
    }
}

#[tokio::test]
async fn a_torn_or_damaged_chunk_gives_the_messages_before_the_damage() {
    let mut state = 7_u64;
    let each = (0..40).map(|n| {
        let words = (0..3_000).map(|_| {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            format!("{} ", state >> 40)
        });
        let payload = format!("{{\"x\":\"{}\"}}", words.collect::<String>());
        message(1, n, payload.as_bytes())
    });
    let each = each.collect::<Vec<_>>().concat();
    let inner = [channel(1, 0, "/t", "json"), each].concat();
    for compression in ["", "zstd", "lz4"] {
        let packed = packed(compression, &inner);
        let log = file(&[chunk(inner.len() as u64, compression, &packed)], &[]);
        let body = first() as usize;
        // Messages are of one size, and blocks of zstd and LZ4 no larger than six of them.
        let before = |part: usize| (40 * part / 8).saturating_sub(7);
        for part in [2, 4, 7] {
            let cut = body + packed.len() * part / 8;
            let (found, losses) = rows(&log[..cut], "/t").await;
            assert!(
                (before(part)..40).contains(&found),
                "{compression:?} cut at {cut}: {found} rows"
            );
            assert_eq!(losses, [(Reason::Torn, 1)], "{compression:?}");
        }
        let mut damaged = packed.clone();
        damaged[packed.len() * 5 / 8..][..64].fill(0xFF);
        let log = file(&[chunk(inner.len() as u64, compression, &damaged)], &[]);
        let (found, losses) = rows(&log, "/t").await;
        // Without compression and checksum nothing says that bytes are others.
        let told = compression.is_empty() || !losses.is_empty();
        assert!(
            found >= before(5) && told,
            "{compression:?} damaged: {found} rows, {losses:?}"
        );
    }
}

#[tokio::test]
async fn losses_at_a_hundred_thousand_places_are_told_in_few_lines() {
    let log = file(
        &[channel(1, 0, "/t", "json"), record(5, b"").repeat(100_000)],
        &[],
    );
    let (_, dataset) = opened(&log).await;
    assert_eq!(dataset.losses.losses()[&Reason::BadRecord].count, 100_000);
    assert_eq!(dataset.losses.entries().len(), 1);
}

#[tokio::test]
async fn a_summary_that_is_most_of_a_file_of_zeros_is_no_summary() {
    let mut log = file(&[], &[]);
    let footer = log.split_off(log.len() - 37);
    log.truncate(8);
    log.resize(4 << 20, 0);
    let mut footer = footer;
    footer[9..17].copy_from_slice(&8_u64.to_le_bytes());
    let (_, dataset) = opened(&[log, footer].concat()).await;
    assert_eq!(dataset.losses.losses()[&Reason::Torn].count, 1);
}

/// Records of no bytes, here the entry of a metadata record beyond the file's end, make the whole summary a lie.
#[tokio::test]
async fn a_summary_with_an_entry_of_no_bytes_is_not_believed() {
    let data = [channel(1, 0, "/t", "json"), messages(&[1], 3)];
    let beyond = [(1_u64 << 40).to_le_bytes(), 0_u64.to_le_bytes()].concat();
    let summary = [
        channel(1, 0, "/t", "json"),
        record(13, &[beyond, text(b"calibration")].concat()),
    ];
    let log = file(&data, &summary);
    let store = in_memory(&log).await;
    let meta = store.head(&Path::from("log.mcap")).await.unwrap();
    let index = LogIndex::read(&store, &meta).await.unwrap();
    assert!(index.fits(log.len() as u64) && index.metadata.is_empty());
    assert_eq!(rows(&log, "/t").await, (3, vec![]));
}

/// What has messages is no summary, wherever a footer says that it begins: its messages would be passed over.
#[tokio::test]
async fn a_summary_that_begins_in_the_data_is_not_believed() {
    let mut log = file(&[channel(1, 0, "/t", "json"), messages(&[1], 3)], &[]);
    let says = log.len() - 8 - 20;
    for start in [8, first()] {
        log[says..says + 8].copy_from_slice(&start.to_le_bytes());
        assert_eq!(rows(&log, "/t").await, (3, vec![]));
    }
}

/// A channel that lacks a field has nulls for it, as long as nulls are small.
#[tokio::test]
async fn nulls_of_gigabytes_are_refused() {
    let log = |size: u32| {
        let records = [
            schema(1, "a/msg/X", "ros2msg", b"uint8 x\n"),
            schema(
                2,
                "a/msg/D",
                "ros2msg",
                format!("uint8[{size}] d\n").as_bytes(),
            ),
            channel(1, 1, "/t", "cdr"),
            channel(2, 2, "/t", "cdr"),
            (0..2000)
                .flat_map(|n| message(1, n, &[0, 1, 0, 0, 7]))
                .collect(),
        ];
        file(&records, &[])
    };
    assert_eq!(rows(&log(1000), "/t").await.0, 2000);
    let (context, _) = opened(&log(2_000_000_000)).await;
    let error = context
        .sql("SELECT * FROM \"/t\"")
        .await
        .unwrap()
        .collect()
        .await;
    let fault = fault_of(&error.unwrap_err()).to_string();
    assert!(
        fault.contains("expected a field") && fault.contains("2000000000 B"),
        "{fault}"
    );
    assert_eq!(count(&context, "SELECT data FROM messages").await, 2000);
}

#[tokio::test]
async fn a_bad_schema_loses_its_own_topic_alone_among_twenty_thousand() {
    let mut records = vec![schema(1, "a/msg/X", "ros2msg", b"nonsense[\n")];
    records.push(channel(20_001, 1, "/bad", "cdr"));
    records.extend((1..=20_000).map(|n| channel(n, 0, &format!("/t{n}"), "json")));
    records.push(messages(&[7, 20_001], 3));
    let (context, dataset) = opened(&file(&records, &[])).await;
    assert_eq!(dataset.topics().len(), 20_001);
    assert_eq!(count(&context, "SELECT * FROM \"/t7\"").await, 3);
    let bad = context
        .sql("SELECT * FROM \"/bad\"")
        .await
        .unwrap()
        .collect()
        .await;
    assert!(fault_of(&bad.unwrap_err()).to_string().contains("expected"));
}

#[tokio::test]
async fn a_file_that_is_no_log_is_lost_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let log = file(&[channel(1, 0, "/t", "json"), messages(&[1], 3)], &[]);
    std::fs::write(path("good.mcap"), log).unwrap();
    std::fs::write(path("empty.mcap"), b"").unwrap();
    std::fs::write(path("other.mcap"), b"no log at all").unwrap();
    let context = context(1);
    let runtime = context.runtime_env();
    let all = [path("*.mcap")];
    let dataset = Dataset::open(&runtime, &all, None).await.unwrap();
    dataset.register(&context).unwrap();
    assert_eq!(count(&context, "SELECT * FROM \"/t\"").await, 3);
    assert_eq!(dataset.sessions.len(), 1);
    assert_eq!(dataset.losses.losses()[&Reason::Unreadable].count, 2);
    for bad in ["empty.mcap", "other.mcap"] {
        let fault = Dataset::open(&runtime, &[path(bad)], None)
            .await
            .unwrap_err();
        assert!(
            fault.to_string().contains("expected an MCAP log"),
            "{fault}"
        );
    }
    let bad = [path("empty.mcap"), path("other.mcap")];
    Dataset::open(&runtime, &bad, None).await.unwrap_err();
}

/// What a folder and patterns find: rows of `/t`, and each file that cannot be read.
#[cfg(target_os = "linux")]
async fn found_at(given: &str) -> (usize, Vec<String>) {
    let context = context(1);
    let runtime = context.runtime_env();
    let dataset = Dataset::open(&runtime, &[given.to_owned()], None)
        .await
        .unwrap();
    dataset.register(&context).unwrap();
    let rows = count(&context, "SELECT * FROM \"/t\"").await;
    (rows, dataset.losses.told().into_keys().collect())
}

/// Names that no store has and no line of text says: such a log is counted, and the others are read.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn a_log_of_a_name_that_cannot_be_said_is_lost_alone() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let log = file(&[channel(1, 0, "/t", "json"), messages(&[1], 3)], &[]);
    let said = "expected names in UTF-8 without control characters, found another one";
    for (bad, shown) in [
        (&b"b\xff.mcap"[..], "b\\xFF.mcap"),
        (&b"tab\t.mcap"[..], "tab\\t.mcap"),
        (&b"line\nbreak.mcap"[..], "line\\nbreak.mcap"),
        (&b"one\x01.mcap"[..], "one\\u{1}.mcap"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let text = folder.path().display().to_string();
        let ways = [
            text.clone(),
            format!("{text}/*.mcap"),
            format!("{text}/**/*.mcap"),
        ];
        let good = folder.path().join("good.mcap");
        std::fs::write(&good, &log).unwrap();
        std::fs::write(folder.path().join(OsStr::from_bytes(bad)), &log).unwrap();
        for given in &ways {
            let (rows, told) = found_at(given).await;
            assert_eq!((rows, told.len()), (3, 1), "{given} {shown}: {told:?}");
            let line = told[0].as_str();
            assert!(
                line.starts_with(&format!("{text}/{shown}: files")),
                "{line}"
            );
            assert!(line.contains(said) && line.ends_with("rename it"), "{line}");
            assert!(!line.contains(char::is_control), "{line:?}");
        }
        std::fs::remove_file(good).unwrap();
        for given in ways {
            let runtime = context(1).runtime_env();
            let fault = Dataset::open(&runtime, &[given], None).await.unwrap_err();
            let fault = fault.to_string();
            assert!(fault.contains(said) && fault.contains(shown), "{fault}");
        }
    }
}

/// Names that would be shown as one, and a folder of such a name on the way.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn every_name_that_cannot_be_said_is_counted() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let log = file(&[channel(1, 0, "/t", "json"), messages(&[1], 3)], &[]);
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().display().to_string();
    for (name, inner) in [&b"a"[..], b"d\xfe", b"d\xff"].iter().zip(["a", "b", "c"]) {
        let folder = folder.path().join(OsStr::from_bytes(name));
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join(inner).with_extension("mcap"), &log).unwrap();
    }
    for pattern in ["*/[abc].mcap", "*/*.mcap", "*"] {
        let (rows, told) = found_at(&format!("{text}/{pattern}")).await;
        assert_eq!((rows, told.len()), (3, 2), "{pattern}: {told:?}");
    }
}

#[cfg(unix)]
#[tokio::test]
async fn sockets_are_no_logs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let _socket = std::os::unix::net::UnixListener::bind(&path).unwrap();
    let runtime = context(1).runtime_env();
    for (path, kind) in [
        (path.display().to_string(), "a socket"),
        ("/dev/null".to_owned(), "a device"),
    ] {
        let fault = Dataset::open(&runtime, &[path], None).await.unwrap_err();
        assert!(fault.to_string().contains(kind), "{fault}");
    }
}

/// rosbag2 can compress messages one by one: such a payload does not say what comes out of it.
#[tokio::test]
async fn a_message_that_unpacks_without_end_is_lost_alone() {
    let text = |length: usize| {
        let bytes = [
            &[0, 1, 0, 0][..],
            &(length as u32).to_le_bytes(),
            &vec![b'a'; length],
        ];
        zstd::bulk::compress(&bytes.concat(), 3).unwrap()
    };
    let records = [
        schema(1, "a/msg/X", "ros2msg", b"string x\n"),
        channel(1, 1, "/t", "cdr"),
        message(1, 0, &text(1 << 20)),
        message(1, 1, &text(80 << 20)),
    ];
    let log = file(&records, &[]);
    assert_eq!(rows(&log, "/t").await, (1, vec![(Reason::Undecodable, 1)]));
}
