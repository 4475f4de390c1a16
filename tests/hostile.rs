//! The program on logs that were made to break it: it says what was expected, what was found and where, within its
//! memory, and ends with the exit code that fits.
//!
//! The logs are made by a script that lies beside the repository, and are no part of it. The script has to be there.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use evermap_tests::{BESIDE_MIB, Finished, program, shared, text, watched_for};

/// Bytes of memory that `inspect` may map to write to.
const INSPECT: u64 = 256 << 20;
/// Bytes of addresses that queries and plans may use.
const QUERY: u64 = 4 << 30;
/// After which a run counts as one that never ends. Those here take less than a tenth.
const FOR_EVER: Duration = Duration::from_secs(300);
/// A log of which a column grows to most of a gigabyte: how many addresses are reserved meanwhile differs from run to run by as
/// much.
const GROWING: &str = "18_protobuf_absent_fields";

/// Makes the logs.
fn logs(folder: &Path) {
    let script = shared("hostile/make.py").expect("the script is there");
    let made = Command::new("python3").arg(script).arg(folder).output();
    let made: Finished = made.expect("python3 starts").into();
    made.expect(0);
}

/// Runs the plan `trajectory` on a log, or a folder of them.
fn trajectory(map: &Path, sessions: &str) -> Finished {
    let to = ["run", "trajectory", "--map", text(map)];
    let from = ["--progress", "none", "--sessions", sessions];
    limited("as", QUERY, &[to, from].concat())
}

/// The allocator reserves addresses by the gigabyte, ahead of need; by 64 MiB (65536 KiB) they tell what is used.
const RESERVE: (&str, &str) = ("MIMALLOC_ARENA_RESERVE", "65536");

/// Runs the program under a limit of `prlimit`.
fn limited(limit: &str, bytes: u64, arguments: &[&str]) -> Finished {
    let mut command = Command::new("timeout");
    command.arg(FOR_EVER.as_secs().to_string());
    command.args(["prlimit", &format!("--{limit}={bytes}")]);
    command.env(RESERVE.0, RESERVE.1);
    command.arg(program()).args(arguments);
    let ended: Finished = command.output().expect("prlimit starts").into();
    in_order(&ended, arguments);
    ended
}

/// Asks a query of a log, which holds no more than it may.
fn asked_within(memory_mib: u64, log: &str, query: &str) -> Finished {
    let memory = format!("{memory_mib}MiB");
    let arguments = ["sql", "--memory", &memory, "--sessions", log, "--", query];
    let addresses = match log.contains(GROWING) {
        true => 2 * QUERY,
        false => QUERY,
    };
    let mut command = Command::new("prlimit");
    command.env(RESERVE.0, RESERVE.1);
    command.arg(format!("--as={addresses}")).arg(program());
    command.args(arguments);
    let (ended, most) = watched_for(FOR_EVER, command);
    in_order(&ended, &arguments);
    assert!(
        most <= memory_mib + BESIDE_MIB,
        "{log}: {most} MiB resident"
    );
    ended
}

/// Nothing ended in a way that nobody meant.
fn in_order(ended: &Finished, arguments: &[&str]) {
    assert!(
        !ended.stderr.contains("panicked") && !ended.stderr.contains("bug:"),
        "{arguments:?}: {}",
        ended.stderr
    );
}

/// A log, what `inspect` and a query of all of a topic end with, and words that they say.
struct Case {
    log: &'static str,
    inspect: (i32, &'static str),
    topic: &'static str,
    query: (i32, &'static str),
}

const fn case(
    log: &'static str,
    inspect: (i32, &'static str),
    topic: &'static str,
    query: (i32, &'static str),
) -> Case {
    Case {
        log,
        inspect,
        topic,
        query,
    }
}

const UNFOLDED: (i32, &str) = (3, "messages that do not fit their schema");

const CASES: [Case; 19] = [
    case("01_protobuf_editions", (0, "protobuf"), "/t", (0, "\n1")),
    case(
        "02_protobuf_public_self_import",
        (0, "protobuf"),
        "/t",
        (0, "\n1"),
    ),
    case(
        "03_protobuf_redefined_options",
        (0, "protobuf"),
        "/t",
        (0, "\n1"),
    ),
    case(
        "04_ros2msg_array_of_doubling_structs",
        (3, "expected at most 20000 columns, found"),
        "/t",
        (
            1,
            "schema of 'a/msg/R': expected at most 20000 columns, found",
        ),
    ),
    case(
        "05_ros1_elements_without_bytes",
        (0, "ros1"),
        "/t",
        UNFOLDED,
    ),
    case(
        "06_null_column_of_2GB_cells",
        (0, "cdr"),
        "/t",
        (
            1,
            "expected a field of at most 65536 B where some channels lack it, found d of 2000000000 B",
        ),
    ),
    case("07_json_absent_properties", (0, "json"), "/t", UNFOLDED),
    case("08_json_400MB_of_zeros", (0, "json"), "/t", (0, "1")),
    case(
        "09_zstd_chunk_of_2GiB",
        (0, "zstd"),
        "/t",
        (1, "resource: "),
    ),
    case(
        "10_idl_long_scopes",
        (3, "expected a definition that is resolved in"),
        "/t",
        (1, "expected a definition that is resolved in"),
    ),
    case(
        "11_ros2msg_400k_members",
        (
            3,
            "expected a definition of at most 1048576 B, found 5200000 B",
        ),
        "/t",
        (
            1,
            "expected a definition of at most 1048576 B, found 5200000 B",
        ),
    ),
    case("12_65534_topics", (0, "/t65534"), "/t5", (0, "0")),
    case(
        "13_short_message_in_chunk",
        (3, "1 records that are cut or out of place"),
        "/t",
        (3, "records that are cut or out of place"),
    ),
    case("14_summary_leaves_a_channel_out", (0, "/b"), "/b", (0, "5")),
    case(
        "15_sparse_64GiB_summary_at_8",
        (3, "at byte 8: 1 logs without an end"),
        "/t",
        (1, "the logs are torn or damaged"),
    ),
    case(
        "16_header_claims_4GiB_string",
        (3, "at byte 8: 1 records that are cut or out of place"),
        "/t",
        (1, "the logs are torn or damaged"),
    ),
    case(
        "17_8M_messages_without_body",
        (3, "8000000 records that are cut or out of place"),
        "/t",
        (3, "8000000"),
    ),
    case(GROWING, (0, "protobuf"), "/t", UNFOLDED),
    case("19_index_of_huge_sizes", (0, "/a"), "/a", (0, "1")),
];

fn check(what: &str, case: &Case, ended: Finished, (code, words): (i32, &str)) {
    let said = format!("{}\n{}", ended.stdout, ended.stderr);
    let start: String = said.chars().take(2_000).collect();
    assert_eq!(ended.code, code, "{what} {}: {start}", case.log);
    assert!(
        said.contains(words),
        "{what} {}: expected {words:?}, found {start}",
        case.log
    );
}

/// Counting rows decodes none; these have a value each that is known.
fn protobuf_is_read_by_value(folder: &Path) {
    for log in [
        "01_protobuf_editions",
        "02_protobuf_public_self_import",
        "03_protobuf_redefined_options",
    ] {
        let log = folder.join(log).with_extension("mcap");
        let query = "SELECT x FROM \"/t\"";
        let asked = ["sql", "--format", "csv", "--sessions", text(&log), "--"];
        let asked = limited("as", QUERY, &[&asked[..], &[query]].concat());
        assert_eq!(asked.expect(0).stdout, "x\n1\n", "{}", log.display());
    }
}

#[test]
fn hostile_logs_are_read_counted_or_refused_within_memory() {
    let folder = tempfile::tempdir().unwrap();
    logs(folder.path());
    protobuf_is_read_by_value(folder.path());
    for case in &CASES {
        let log = folder.path().join(case.log).with_extension("mcap");
        let log = text(&log);
        let inspected = limited("data", INSPECT, &["inspect", log]);
        check("inspect", case, inspected, case.inspect);
        // Every column is decoded, and printed short.
        let query = format!("SELECT * FROM \"{}\"", case.topic);
        let counted = format!("SELECT count(*) AS n FROM ({query})");
        let asked = match case.query.0 {
            0 => limited(
                "as",
                QUERY,
                &["sql", "--format", "csv", "--sessions", log, "--", &counted],
            ),
            _ => asked_within(1024, log, &query),
        };
        check("sql", case, asked, case.query);
        if case.log.contains("64GiB") {
            // A run begins with the digest of every byte.
            continue;
        }
        let map = folder.path().join("map").join(case.log);
        let ran = trajectory(&map, log);
        assert!(
            [0, 1, 3].contains(&ran.code),
            "run {}: {} {}",
            case.log,
            ran.code,
            ran.stderr
        );
    }
}

/// What a log may have very many of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Many {
    /// Topics, each with a definition of its own and a message.
    Topics,
    /// Chunks of one message.
    Chunks,
    /// Messages outside chunks, the last one first.
    Messages,
    Attachments,
    Metadata,
}

/// A log of so many.
fn log_of(many: Many, count: u16, each: u64) -> Vec<u8> {
    let chunked = many == Many::Chunks;
    let options = mcap::WriteOptions::new().compression(None);
    let options = options.use_chunks(chunked).chunk_size(chunked.then_some(1));
    let mut log = options.create(Cursor::new(Vec::new())).unwrap();
    let none = BTreeMap::new();
    let any = log.add_channel(0, "/any", "json", &none).unwrap();
    let message = |channel_id, time| mcap::records::MessageHeader {
        channel_id,
        sequence: 0,
        log_time: time,
        publish_time: time,
    };
    for number in 0..u64::from(count) * each {
        let name = format!("n{number}");
        match many {
            Many::Topics => {
                let (schema, text) = (format!("a/msg/N{number}"), format!("uint8 {name}\n"));
                let schema = log.add_schema(&schema, "ros2msg", text.as_bytes()).unwrap();
                let channel = log.add_channel(schema, &name, "cdr", &none).unwrap();
                log.write_to_known_channel(&message(channel, number), &[0, 1, 0, 0, 7])
                    .unwrap();
            }
            Many::Chunks => log
                .write_to_known_channel(&message(any, number), b"{}")
                .unwrap(),
            Many::Messages => log
                .write_to_known_channel(&message(any, u64::from(u32::MAX) - number), b"{}")
                .unwrap(),
            Many::Attachments => log
                .attach(&mcap::Attachment {
                    log_time: number,
                    create_time: number,
                    name,
                    media_type: String::new(),
                    data: Cow::Borrowed(b"few"),
                })
                .unwrap(),
            Many::Metadata => log
                .write_metadata(&mcap::records::Metadata {
                    name,
                    metadata: none.clone(),
                })
                .unwrap(),
        }
    }
    log.finish().unwrap();
    log.into_inner().into_inner()
}

/// Seconds of a processor that `inspect` takes, within its memory; what else the machine does counts little.
fn inspected_s(log: &Path) -> f64 {
    let limit = format!("prlimit --data={INSPECT} \"$0\" inspect \"$1\" >/dev/null");
    let mut bash = Command::new("bash");
    bash.args(["-c", &format!("TIMEFORMAT=%U; time {limit}")]);
    bash.arg(program()).arg(log).env("LC_ALL", "C");
    bash.env("MIMALLOC_ARENA_RESERVE", "65536");
    let ended: Finished = bash.output().expect("bash starts").into();
    let said = ended.expect(0).stderr;
    let taken = said
        .lines()
        .next_back()
        .and_then(|taken| taken.parse().ok());
    taken.unwrap_or_else(|| panic!("expected a time, found {said}"))
}

/// Four times as much takes four times as long, and not sixteen.
#[test]
fn inspect_takes_time_in_proportion_to_a_file_within_memory() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("many.mcap");
    for (many, count) in [
        (Many::Topics, 15_000),
        (Many::Chunks, 8_000),
        (Many::Messages, 60_000),
        (Many::Attachments, 20_000),
        (Many::Metadata, 20_000),
    ] {
        let [few, many_more] = [1, 4].map(|each| {
            std::fs::write(&log, log_of(many, count, each)).unwrap();
            inspected_s(&log).min(inspected_s(&log))
        });
        assert!(
            many_more < 8.0 * few.max(0.1),
            "{many:?}: {few} s of {count}, {many_more} s of four times as many"
        );
    }
}

#[test]
fn a_run_counts_the_file_that_it_cannot_read() {
    let folder = tempfile::tempdir().unwrap();
    let logs = folder.path().join("logs");
    std::fs::create_dir(&logs).unwrap();
    evermap_tests::write_drive(
        &logs.join("good.mcap"),
        evermap_tests::rectangle(30.0, 20.0, 1.0),
    );
    std::fs::write(logs.join("bad.mcap"), "no log at all").unwrap();
    let map = folder.path().join("map");
    let ran = trajectory(&map, text(&logs));
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    assert!(
        ran.stderr.contains("bad.mcap: files that cannot be read"),
        "{}",
        ran.stderr
    );
}

/// A server has 16 threads, which plan queries, each with 256 MiB of addresses to go deep.
#[test]
fn a_server_that_gets_no_threads_says_so() {
    let ended = limited("as", 3 << 30, &["serve", "--map", "nowhere"]).expect(1);
    assert!(
        ended.stderr.contains("resource: cannot start 16 threads"),
        "{}",
        ended.stderr
    );
}
