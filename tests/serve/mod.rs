//! `evermap serve`: what psycopg, JDBC, ADBC and HTTP read is what `evermap sql` prints, also while versions are published,
//! and what must be refused is.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use evermap_tests::asked::{AskedStreet, SMALL};
use evermap_tests::park::{copy, made_once};
use evermap_tests::server::{self, Server, bounded, drive, script};
use evermap_tests::{Finished, command, evermap, rows_of, run_of_site, simulate, text};
use evermap_vision::{Grey, decode_labels};
use serde_json::{Value, json};

/// The driver of JDBC, where Debian has it.
const JDBC: &str = "/usr/share/java/postgresql.jar";

/// A copy, in this folder, of a map of two drives: the tests share it and its logs, which are not to be changed.
fn map(folder: &Path) -> PathBuf {
    static MAP: OnceLock<PathBuf> = OnceLock::new();
    let made = || server::map(&made_once(env!("CARGO_TARGET_TMPDIR"), "serve"));
    copy(MAP.get_or_init(made), folder, "map")
}

fn ended(name: &str, arguments: &[&str]) {
    if let Some(mut script) = script(name, arguments) {
        Finished::from(script.output().unwrap()).expect(0);
    }
}

#[test]
fn programs_read_what_evermap_sql_prints() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let queries = include_str!("queries.sql").split(";\n");
    let queries = queries.filter(|query| !query.trim().is_empty());
    let asked: Vec<Value> = queries
        .map(|query| json!([query, rows_of(&map, query)]))
        .collect();
    assert!(asked.len() >= 60);
    let expected = folder.path().join("expected.json");
    std::fs::write(&expected, Value::from(asked).to_string()).unwrap();
    let server = Server::start(&map, &[]);
    let driver = evermap_test_data::there(JDBC.into(), "`make test` installs it");
    let mut arguments = vec![&server.http, &server.postgres, text(&expected)];
    arguments.extend(driver.as_deref().map(text));
    ended("serve/clients.py", &arguments);
}

#[test]
fn answers_in_arrow_and_parquet_have_the_units_and_frames_that_evermap_sql_writes() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let query = "SELECT stamp AS at, map_from_vehicle, map_from_vehicle['x'] AS east, map_from_vehicle['x'] * 2 AS twice FROM poses";
    let file = folder.path().join("rows.parquet");
    evermap(&["sql", "--map", text(&map), query, "--out", text(&file)]).expect(0);
    let server = Server::start(&map, &[]);
    ended("serve/described.py", &[&server.http, query, text(&file)]);
}

/// Geometries come as from PostGIS, to programs that know it.
#[test]
fn programs_read_geometries_as_from_postgis() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &[]);
    ended("serve/postgis.py", &[&server.postgres]);
    ended("serve/qgis.py", &[&server.postgres]);
    if evermap_test_data::there("/usr/bin/ogr2ogr".into(), "`make test` installs it").is_some() {
        ended("serve/gdal.py", &[&server.postgres]);
    }
}

/// What programs bind is what it would be as a literal, by cursors too.
#[test]
fn programs_bind_values_as_they_do_to_postgres() {
    ended_by_postgres("serve/bound.py");
}

/// A program asks a server of a map by Postgres' protocol.
fn ended_by_postgres(name: &str) {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &[]);
    ended(name, &[&server.postgres]);
}

/// What dashboards ask before they show anything.
#[test]
fn dashboards_learn_what_there_is() {
    ended_by_postgres("serve/questions.py");
}

/// What drivers say around queries.
#[test]
fn drivers_are_understood() {
    ended_by_postgres("serve/drivers.py");
}

/// By asyncpg, which asks for types that it has not heard of, and what is built on it.
#[test]
fn asynchronous_programs_read_a_map() {
    ended_by_postgres("serve/asynchronous.py");
}

/// What psql asks of Postgres' own tables, to list and describe.
#[test]
fn psql_describes_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &[]);
    let (host, port) = server.postgres.split_once(':').unwrap();
    for (asked, said) in [
        ("\\d", "| lanes "),
        ("\\dt+", "| lanes "),
        ("\\d lanes", "length_m "),
        ("\\d lanes", "| geometry "),
        (
            "\\d lanes",
            "\"lanes_pkey\" PRIMARY KEY, btree (site, lane)",
        ),
        ("\\d+ lanes", "length_m "),
        ("\\dp lanes", "| lanes "),
        ("\\dn+", "public "),
        ("\\l", " map "),
        ("\\l+", " map "),
        ("\\conninfo", "database \"map\""),
        ("\\di", "| lanes_pkey "),
        ("\\df", "List of functions"),
        ("\\du", "List of roles"),
        ("\\dT", "List of data types"),
        ("SELECT current_database()", " map"),
    ] {
        let mut psql = std::process::Command::new("psql");
        psql.args(["-X", "-h", host, "-p", port, "-U", "me", "-c", asked, "map"]);
        let told = Finished::from(psql.output().expect("psql")).expect(0);
        assert!(
            told.stdout.contains(said) || told.stderr.contains(said),
            "{asked}: {} {}",
            told.stdout,
            told.stderr
        );
    }
}

/// Each answer is of one version, the newest when it was asked for; many clients at once hold no more and more memory.
#[test]
fn clients_see_versions_whole_while_they_are_published() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &[]);
    let arguments = [server.postgres.as_str(), server.http.as_str()];
    let Some(mut readers) = script("serve/readers.py", &arguments) else {
        return;
    };
    let mut readers = readers
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut begun = [0; 8];
    let said = readers.stdout.as_mut().unwrap().read_exact(&mut begun);
    assert!(said.is_ok() && begun == *b"reading\n", "{begun:?}");
    for (day, width_m) in [("wednesday", 28.0), ("thursday", 34.0), ("friday", 30.0)] {
        drive(folder.path(), &map, day, width_m);
    }
    let held = server.memory();
    drop(readers.stdin.take());
    let ended = Finished::from(readers.wait_with_output().unwrap()).expect(0);
    assert!(
        ended.stdout.contains("versions [2, ") && ended.stdout.contains(", 5]"),
        "{}",
        ended.stdout
    );
    assert!(held < 1 << 30, "{held} bytes");
    let poses = rows_of(&map, "SELECT count(*) AS n FROM poses");
    assert!(
        ended.stdout.contains(&format!("last {}", poses[0]["n"])),
        "{}",
        ended.stdout
    );
}

#[test]
fn a_server_stays_at_the_newest_whole_version_where_the_next_is_torn() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &[]);
    // It has two.
    let whole = std::fs::read(map.join("versions/2.json")).unwrap();
    std::fs::write(map.join("versions/3.json"), &whole[..whole.len() / 2]).unwrap();
    let query = "/sql?format=csv&query=SELECT+count(*)+AS+n+FROM+lanes";
    let lanes = rows_of(&map, "SELECT count(*) AS n FROM lanes");
    let expected = format!("n\n{}\n", lanes[0]["n"]);
    for _ in 0..3 {
        let answer = server.got(query);
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        assert!(answer.ends_with(&expected), "{answer}");
    }
    let said = server.stopped();
    assert_eq!(said.matches("version 3 is ignored: ").count(), 1, "{said}");
}

/// A version whose files `gc` takes is refused, also where its tables were open: none of its rows are left out in silence.
#[test]
fn a_version_that_gc_forgets_meanwhile_is_not_answered_in_part() {
    let folder = tempfile::tempdir().unwrap();
    let map = server::map(folder.path());
    let server = Server::start(&map, &[]);
    let second = || server.got("/layers/lanes?format=csv&version=2");
    assert!(second().starts_with("HTTP/1.1 200"), "{}", second());
    drive(folder.path(), &map, "wednesday", 28.0);
    let lanes = |version: &str| {
        let query = format!("SELECT digest FROM {version}layers WHERE layer = 'lanes'");
        rows_of(&map, &query)
    };
    assert_ne!(lanes("v2."), lanes(""));
    let beside = || asked(&server, "SELECT count(*) AS n FROM v2.lanes");
    assert!(beside().starts_with("HTTP/1.1 200"), "{}", beside());
    evermap(&["gc", "--map", text(&map), "--keep", "1"]).expect(0);
    for (answer, status, says) in [
        (second(), 400, "no version 2 in this map; there are: 3"),
        (beside(), 422, "expected rows of a version, found no file"),
    ] {
        let begins = format!("HTTP/1.1 {status}");
        assert!(
            answer.starts_with(&begins) && answer.contains(says),
            "{answer}"
        );
    }
    let newest = server.got("/layers/lanes?format=csv");
    assert!(newest.starts_with("HTTP/1.1 200"), "{newest}");
}

/// Files that are replaced while a version is open: rows that are not what was written are refused until they are there again,
/// and a log is read as it is.
#[test]
fn files_that_are_replaced_while_a_version_is_open_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let map = server::map(folder.path());
    let server = Server::start(&map, &[]);
    let answer = |query: &str| {
        let answer = asked(&server, query);
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        (head[..12].to_owned(), body.to_owned())
    };
    let lanes = "SELECT count(*) AS n, sum(length_m) AS all_m FROM lanes";
    // What was just looked at is believed for a while: until then Parquet may be what stumbles over it.
    let noticed = |is_meant: &dyn Fn(&(String, String)) -> bool| {
        let end = std::time::Instant::now() + std::time::Duration::from_secs(60);
        loop {
            let answer = answer(lanes);
            if is_meant(&answer) || std::time::Instant::now() > end {
                return answer;
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
    };
    let first = answer(lanes);
    assert_eq!(first.0, "HTTP/1.1 200", "{first:?}");
    let version = std::fs::read(map.join("versions/2.json")).unwrap();
    let version: Value = serde_json::from_slice(&version).unwrap();
    let content = &version["layers"]["lanes"]["artifacts"][0]["content"];
    let path = map.join(format!("artifacts/{}.parquet", content.as_str().unwrap()));
    let whole = std::fs::read(&path).unwrap();
    let mut other = whole.clone();
    other[whole.len() / 2] ^= 0x7f;
    std::fs::write(&path, other).unwrap();
    let refused = noticed(&|answer| answer.1.contains("expected the digest"));
    assert_eq!(refused.0, "HTTP/1.1 422", "{refused:?}");
    assert!(refused.1.contains("expected the digest"), "{refused:?}");
    std::fs::write(&path, whole).unwrap();
    assert_eq!(noticed(&|answer| *answer != refused), first);

    let messages = |day: &str| answer(&format!("SELECT count(*) AS n FROM {day}.messages"));
    let (monday, tuesday) = (messages("monday"), messages("tuesday"));
    assert_ne!(monday, tuesday);
    let log = |day: &str| folder.path().join(format!("{day}.mcap"));
    let size = |day: &str| std::fs::metadata(log(day)).unwrap().len();
    assert!(size("monday") < size("tuesday"));
    std::fs::copy(log("monday"), log("tuesday")).unwrap();
    assert_eq!(messages("tuesday"), monday);
}

/// The same of a statement that is planned once.
#[test]
fn a_prepared_statement_notices_files_that_are_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let map = server::map(folder.path());
    let server = Server::start(&map, &[]);
    let arguments = [server.postgres.as_str(), text(&map), text(folder.path())];
    ended("serve/prepared.py", &arguments);
}

/// By the path that `/maps` gives, and as a schema beside another map's.
#[test]
fn a_map_is_reached_by_its_name_whatever_letters_are_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let made = map(folder.path());
    let named = folder.path().join("kärte #2");
    std::fs::rename(&made, &named).unwrap();
    let server = Server::start(&named, &[]);
    let got = |path: &str| server.got(path);
    let listed = got("/maps");
    let body = listed.split_once("\r\n\r\n").unwrap().1;
    let listed: Value = serde_json::from_str(body).unwrap();
    let path = "/maps/k%C3%A4rte%20%232/";
    assert_eq!(listed, json!([{ "name": "kärte #2", "path": path }]));
    let answer = got(&format!("{path}layers"));
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");

    let other = folder.path().join("other");
    drive(folder.path(), &other, "wednesday", 25.0);
    let query = "SELECT count(DISTINCT session) AS n FROM \"kärte #2\".poses";
    let maps = ["--map", text(&other), "--map", text(&named)];
    let asked = evermap(&[&["sql", "--format", "json", query][..], &maps].concat());
    assert_eq!(asked.expect(0).json(), json!([{ "n": 2 }]));
}

/// As Foxglove does it; those who take nothing cost the server nothing, and others are answered meanwhile.
#[test]
fn a_map_is_watched_live() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &[]);
    ended("serve/live.py", &["watched", &server.http]);
    let before = server.memory();
    let Some(mut viewers) = script("serve/live.py", &["slow", &server.http]) else {
        return;
    };
    let mut viewers = viewers
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut begun = [0; 9];
    let said = viewers.stdout.as_mut().unwrap().read_exact(&mut begun);
    assert!(said.is_ok() && begun == *b"watching\n", "{begun:?}");
    let more = server.memory().saturating_sub(before);
    assert!(more < 256 << 20, "{more} bytes more");
    drop(viewers.stdin.take());
    assert!(viewers.wait().unwrap().success());
}

#[test]
fn one_address_does_not_keep_others_out() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &["--per-address", "2"]);
    ended("serve/crowd.py", &[&server.http, &server.postgres]);
}

#[test]
fn a_server_is_read_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &["--rows", "100000", "--timeout-s", "3"]);
    ended("serve/attack.py", &["open", &server.http, &server.postgres]);
    assert!(server.memory() < 1 << 30, "{} bytes", server.memory());
    let said = server.stopped();
    assert!(!said.contains("panicked"), "{said}");
    evermap(&["verify", "--map", text(&map)]).expect(0);
    assert!(!Path::new("/tmp/evermap-attack.csv").exists());
    assert!(!Path::new("/tmp/evermap-attack.parquet").exists());
}

/// The status line that a query is answered with, and whatever follows.
fn asked(server: &Server, query: &str) -> String {
    let mut stream = std::net::TcpStream::connect(&server.http).unwrap();
    let head = format!(
        "POST /sql HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: {}\r\n\r\n",
        query.len()
    );
    stream.write_all((head + query).as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// It is the server's disk that has no room, and nothing that the client asked.
#[test]
fn a_folder_of_temporary_files_that_is_gone_is_named_and_no_fault_of_who_asks() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let temporary = folder.path().join("temporary");
    std::fs::create_dir(&temporary).unwrap();
    let server = Server::start_in(&temporary, &map, &[]);
    std::fs::remove_dir_all(&temporary).unwrap();
    let query = "SELECT%20sin(value)%20AS%20x%20FROM%20generate_series(1,100000)";
    let answered = |format: &str| server.got(&format!("/sql?format={format}&query={query}"));
    for format in ["json", "csv", "parquet"] {
        let answer = answered(format);
        assert!(answer.starts_with("HTTP/1.1 503 "), "{format}: {answer}");
        for said in [
            text(&temporary),
            "cannot write a temporary file",
            "set TMPDIR",
        ] {
            assert!(answer.contains(said), "{format}: {answer}");
        }
    }
    std::fs::create_dir(&temporary).unwrap();
    assert!(answered("csv").starts_with("HTTP/1.1 200 "));
}

/// Waits until its threads rest, for a minute at most.
fn rests(server: &Server) -> bool {
    let pause = std::time::Duration::from_secs(1);
    (0..60).any(|_| {
        let before = server.computed();
        std::thread::sleep(pause);
        // Hundredths of a second.
        server.computed() - before < 20
    })
}

/// Of rows that take minutes together, and a row that alone does, no thread of a server computes on for nobody.
#[test]
fn a_query_that_only_takes_time_leaves_its_thread_soon_after_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    // Time for a second of work, also where other tests take theirs.
    let server = Server::start(&map, &["--timeout-s", "6"]);
    let texts = "repeat(CAST(value % 10 AS TEXT), 4000), repeat(CAST(value % 7 AS TEXT), 4000)";
    let slow = format!("SELECT max(levenshtein({texts})) AS far FROM generate_series(1, 8192)");
    let before = server.computed();
    let answer = asked(&server, &slow);
    assert!(
        answer.contains(" 503 ") && answer.contains("took longer than 6s"),
        "{answer}"
    );
    assert!(server.computed() - before > 100, "nothing was computed");
    assert!(rests(&server), "a thread computes on after the deadline");

    // A client's end is noticed long before the time of its query.
    let patient = Server::start(&map, &["--timeout-s", "3600"]);
    let before = patient.computed();
    let mut gone = std::net::TcpStream::connect(&patient.postgres).unwrap();
    let start = said("", b"\0\x03\0\0user\0me\0database\0map\0\0");
    let query = said("Q", format!("{slow}\0").as_bytes());
    gone.write_all(&[start, query].concat()).unwrap();
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert!(patient.computed() > before, "nothing was computed");
    drop(gone);
    assert!(
        rests(&patient),
        "a thread computes on for a client that is gone"
    );
    let told = patient.got("/metrics");
    assert!(told.contains("evermap_queries_free 32\n"), "{told}");
    drop(patient);

    let answer = asked(
        &server,
        "SELECT levenshtein(repeat('a', 200000), repeat('b', 200000)) AS far",
    );
    assert!(
        answer.contains(" 503 ") && answer.contains("would take 40000000000 steps for one row"),
        "{answer}"
    );
    assert!(rests(&server), "a row that takes too long was begun");
}

#[test]
fn who_reads_nothing_keeps_nobody_else_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &["--queries", "1", "--timeout-s", "3"]);
    ended("serve/attack.py", &["slow", &server.http, &server.postgres]);
}

/// A message of the protocol of Postgres.
fn said(kind: &str, body: &[u8]) -> Vec<u8> {
    let size = u32::try_from(body.len() + 4).unwrap().to_be_bytes();
    [kind.as_bytes(), &size, body].concat()
}

/// Of an answer that is larger than the memory there are the rows that are being sent, and no others.
#[test]
fn rows_wait_for_their_reader_outside_of_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &["--memory", "256MiB"]);
    let rows = "SELECT repeat('a', 20000) || CAST(value AS TEXT) FROM generate_series(1, 200000)\0";
    let start = said("", b"\0\x03\0\0user\0me\0database\0map\0\0");
    let prepared = [
        said("P", &[b"\0", rows.as_bytes(), b"\0\0"].concat()),
        said("B", b"\0\0\0\0\0\0\0\0"),
        said("E", b"\0\0\0\0\0"),
    ];
    let cursor = [
        said("Q", format!("DECLARE mine CURSOR FOR {rows}").as_bytes()),
        said("Q", b"FETCH ALL FROM mine\0"),
    ];
    let before = server.memory();
    let asked = [prepared.concat(), cursor.concat()].map(|messages| {
        let mut stream = std::net::TcpStream::connect(&server.postgres).unwrap();
        stream
            .write_all(&[start.clone(), messages].concat())
            .unwrap();
        // What comes first tells that rows do.
        stream.read_exact(&mut [0; 100_000]).unwrap();
        stream
    });
    std::thread::sleep(std::time::Duration::from_secs(8));
    let more = server.memory().saturating_sub(before);
    assert!(more < 512 << 20, "{more} bytes more");
    drop(asked);
}

/// What waits for many who read nothing has one memory together, and who finds none is refused.
#[test]
fn rows_that_wait_for_many_readers_are_counted_in_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &["--memory", "64MiB"]);
    let rows = "SELECT+repeat('x',7000000)+AS+t+FROM+generate_series(1,1000)";
    let request = format!("GET /sql?format=arrow&query={rows} HTTP/1.1\r\nHost: localhost\r\n\r\n");
    let before = server.memory();
    let silent = [(); 32].map(|()| {
        let mut stream = std::net::TcpStream::connect(&server.http).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        stream
    });
    // Each makes its first rows, waits or is refused: then there is no more than what waits.
    let (mut more, mut seconds) = (0, 0);
    for _ in 0..90 {
        std::thread::sleep(std::time::Duration::from_secs(1));
        more = server.memory().saturating_sub(before);
        seconds = if more < 256 << 20 { seconds + 1 } else { 0 };
        if seconds == 10 {
            break;
        }
    }
    assert_eq!(seconds, 10, "{more} bytes more");
    drop(silent);
    let answer = asked(&server, "SELECT count(*) AS n FROM lanes");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    let said = server.stopped();
    assert!(
        said.contains("an answer that is being read needs"),
        "nobody was refused: {said}"
    );
}

/// What is made before it is sent waits for who reads nothing on the disk.
#[test]
fn answers_that_are_made_before_they_are_sent_wait_outside_of_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &["--queries", "2"]);
    let rows = "SELECT+repeat('x',1000000)+AS+t+FROM+generate_series(1,40)";
    let before = server.memory();
    let silent: Vec<_> = (0..12)
        .map(|number| {
            let format = ["json", "csv"][number % 2];
            let mut stream = std::net::TcpStream::connect(&server.http).unwrap();
            let request = format!(
                "GET /sql?format={format}&query={rows} HTTP/1.1\r\nHost: localhost\r\n\r\n"
            );
            stream.write_all(request.as_bytes()).unwrap();
            let mut begun = [0; 15];
            stream.read_exact(&mut begun).unwrap();
            assert_eq!(&begun, b"HTTP/1.1 200 OK");
            stream
        })
        .collect();
    // What making them took is given back soon.
    std::thread::sleep(std::time::Duration::from_secs(5));
    let more = server.memory().saturating_sub(before);
    assert!(more < 256 << 20, "{more} bytes more");
    drop(silent);
}

/// A thing that is clicked on the page is followed back to the messages of its log.
#[test]
fn the_page_tells_what_a_row_was_made_from() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let labels = folder.path().join("labels");
    let server = Server::start(&map, &["--teach", text(&labels)]);
    ended("serve/lineage.py", &[&server.http]);
}

/// What is said is on the disk before it is answered, also where somebody took the log away that was written until then.
#[test]
fn what_is_said_after_a_log_is_removed_is_in_another_one() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let labels = folder.path().join("labels");
    let server = Server::start(&map, &["--teach", text(&labels)]);
    let log = labels.join("map/lot/lot_ada.mcap");
    let says = |word: &str| String::from_utf8_lossy(&std::fs::read(&log).unwrap()).contains(word);
    ended("serve/teach.py", &["dawn", &server.http]);
    assert!(says("dawn"));
    std::fs::remove_file(&log).unwrap();
    ended("serve/teach.py", &["dusk", &server.http]);
    assert!(says("dusk") && !says("dawn"));
    std::fs::remove_dir_all(&labels).unwrap();
    ended("serve/teach.py", &["dusk", &server.http]);
    assert!(says("dusk"));
    let told = server.stopped();
    let gone = format!("{} is no longer there", text(&log));
    assert_eq!(told.matches(&gone).count(), 2, "{told}");
}

/// What people say is written as who they are, before it is answered, and nothing else is written by anybody.
#[test]
fn people_teach_by_http_and_everything_else_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let labels = folder.path().join("labels");
    let server = Server::start(&map, &[]);
    ended("serve/teach.py", &["read-only", &server.http]);
    drop(server);
    let server = Server::start(&map, &["--teach", text(&labels)]);
    ended("serve/teach.py", &["taught", &server.http]);
    let logs = || {
        let logs = std::fs::read_dir(labels.join("map/lot")).unwrap();
        let names = logs.map(|log| log.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = names.collect();
        names.sort();
        names
    };
    assert_eq!(logs(), ["lot_ada.mcap", "lot_bob.mcap"]);

    // A version that has the logs: what is said then is in the next part.
    let log = |name: &str| labels.join("map/lot").join(name);
    let said = ["lot_ada.mcap", "lot_bob.mcap"].map(log);
    let sessions = ["--sessions", text(&said[0]), text(&said[1])];
    let plan = folder.path().join("taught.yaml");
    let taught = "plan: taught\nextends: trajectory\nsteps:\n  said: { sql: SELECT * FROM annotations }\nwrite: [said]\n";
    std::fs::write(&plan, taught).unwrap();
    run_of_site(text(&plan), &map, "lot", &sessions).expect(3);
    // What cannot be read among them is told, as the end of a command tells it.
    let junk = log("junk.mcap");
    std::fs::write(&junk, "no log at all").unwrap();
    ended("serve/teach.py", &["later", &server.http]);
    std::fs::remove_file(&junk).unwrap();
    assert_eq!(logs().len(), 3, "{:?}", logs());
    let told = server.stopped();
    let unread = format!("       1  {}: files that cannot be read", text(&junk));
    let unread = told.lines().filter(|line| line.contains(&unread)).count();
    assert!(
        unread == 1 && told.contains("what was said of lot: "),
        "{told}"
    );
    for part in &said {
        let (map, part) = (text(&map), text(part));
        let command = format!("evermap run PLAN --map {map} --site lot --sessions {part}");
        assert!(told.contains(&command), "{command}: {told}");
    }
    let export = folder.path().join("labels.geojson");
    let log = log("lot_ada.mcap");
    let annotate = [
        "annotate",
        "--map",
        text(&map),
        "--out",
        text(&log),
        "--export",
        text(&export),
    ];
    let ended = evermap(&annotate);
    assert!([0, 3].contains(&ended.code), "{}", ended.stderr);
    let export: Value = serde_json::from_slice(&std::fs::read(export).unwrap()).unwrap();
    let labels = export["features"].as_array().unwrap().iter();
    let mut found: Vec<String> = labels
        .map(|one| {
            format!(
                "{} {}",
                one["properties"]["kind"], one["properties"]["author"]
            )
        })
        .collect();
    found.sort();
    assert_eq!(
        found,
        [
            "\"crossing\" \"bob\"",
            "\"late\" \"ada\"",
            "\"spot\" \"ada\""
        ]
    );
}

/// The labels of a layer: classes, width and pixels of each image, by stamp.
fn label_images(map: &Path, layer: &str) -> BTreeMap<i64, (Vec<String>, Grey)> {
    let query = format!(
        "SELECT CAST(stamp AS BIGINT) AS at, classes, encode(png, 'hex') AS png FROM {layer}"
    );
    let image = |row: &Value| {
        let hex = row["png"].as_str().unwrap();
        let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
        let png: Vec<u8> = (0..hex.len()).step_by(2).map(byte).collect();
        let classes = serde_json::from_value(row["classes"].clone()).unwrap();
        (
            row["at"].as_i64().unwrap(),
            (classes, decode_labels(&png).unwrap()),
        )
    };
    let rows = rows_of(map, &query);
    rows.as_array().unwrap().iter().map(image).collect()
}

/// As if the street's log had no labels of its own.
const UNLABELLED: &str = "\
plan: unlabelled
extends: scene_labels
steps:
  nothing: { sql: SELECT * FROM label_frames WHERE stamp IS NULL }
  recorded: { in: { labels: nothing } }
";

/// Nobody has labelled the street: what people paint on three of its images labels all of them in the next run.
#[test]
fn people_paint_on_images_and_the_next_run_has_learnt_from_it() {
    let folder = tempfile::tempdir().unwrap();
    let [map, labels, street] = ["map", "labels", "street"].map(|name| folder.path().join(name));
    simulate("street", &street, &SMALL);
    let log = street.join("visit_a/visit_a.mcap");
    let plan = folder.path().join("unlabelled.yaml");
    std::fs::write(&plan, UNLABELLED).unwrap();
    let run = |sessions: &[&str]| {
        let mut more = sessions.to_vec();
        for setting in [
            "samples.samples=400",
            "samples.backbone_areas_px=[43200]",
            "pixel_network.least_steps=500",
            "crf_settings.trials=1",
            "crf_settings.images=1",
        ] {
            more.extend(["--set", setting]);
        }
        run_of_site(text(&plan), &map, "street", &more)
    };
    let first = run(&["--sessions", text(&log)]).expect(3);
    assert!(
        first.stderr.contains("site has no classifier"),
        "{}",
        first.stderr
    );
    let count =
        |layer: &str| rows_of(&map, &format!("SELECT count(*) AS n FROM {layer}"))[0]["n"].as_u64();
    let images = count("pictures").unwrap();
    assert!(images >= 8 && count("label_images") == Some(0));

    let server = Server::start(&map, &["--teach", text(&labels)]);
    ended("serve/teach.py", &["painted", &server.http]);
    ended("serve/teach.py", &["page", &server.http]);
    drop(server);
    let logs = std::fs::read_dir(labels.join("map/street")).unwrap();
    let mut logs: Vec<_> = logs.map(|log| log.unwrap().path()).collect();
    logs.sort();
    let mut sessions = vec!["--sessions"];
    sessions.extend(logs.iter().map(|log| text(log)));
    // The server was killed: its logs have no end.
    run(&sessions).expect(3);

    let painted = label_images(&map, "taught_labels");
    let first = painted.values().next().unwrap();
    assert_eq!(first.0, ["sky", "ground"]);
    assert_eq!(
        [10, 42, 60].map(|row| first.1.data[row * 256 + 7]),
        [0, 255, 1]
    );
    let found = label_images(&map, "label_images");
    assert_eq!(found.len() as u64, images);
    let mut right = [0_usize; 2];
    for (classes, labels) in found.values() {
        let is = |row: usize, class: &str| {
            let of_row = &labels.data[row * 256..][..256];
            let named = |value: &&u8| {
                classes
                    .get(usize::from(**value))
                    .is_some_and(|name| name == class)
            };
            of_row.iter().filter(named).count()
        };
        right[0] += is(5, "sky");
        right[1] += is(78, "ground");
    }
    let all = 256 * found.len();
    assert!(
        right.iter().all(|right| *right > all * 4 / 5),
        "{right:?} of {all}"
    );

    // What the map has learnt is accepted where it is right.
    let server = Server::start(&map, &["--teach", text(&labels)]);
    ended("serve/teach.py", &["accepted", &server.http]);
}

/// Questions about people are answered by HTTP and on the page, and the next run ties each answer to its image.
#[test]
fn people_answer_for_who_is_seen_in_images() {
    let street = AskedStreet::new();
    let (map, labels) = (street.map(), street.path("labels"));
    let server = Server::start(&map, &["--teach", text(&labels)]);
    ended("serve/teach.py", &["people", &server.http]);
    ended("serve/teach.py", &["answered", &server.http]);
    drop(server);
    let logs = std::fs::read_dir(labels.join("map/street")).unwrap();
    let mut logs: Vec<_> = logs.map(|log| log.unwrap().path()).collect();
    logs.sort();
    let mut sessions = vec!["--sessions"];
    sessions.extend(logs.iter().map(|log| text(log)));
    // The server was killed: its logs have no end.
    street.run(&sessions).expect(3);

    let tied = rows_of(
        &map,
        "SELECT l.standing, p.nth, round(l.anchor['vehicle_from_label']['x'], 3) AS x,
           round(l.anchor['vehicle_from_label']['y'], 3) AS y
         FROM placed_labels l
         JOIN (SELECT *, row_number() OVER (ORDER BY stamp) AS nth FROM pictures) p
           ON p.session = l.anchor['session'] AND p.stamp = l.anchor['stamp'] AND p.camera = l.anchor['camera']
         WHERE l.kind = 'person' ORDER BY p.nth",
    );
    let answer =
        |nth: u64, standing: &str| json!({ "standing": standing, "nth": nth, "x": 3.0, "y": 0.5 });
    let expected = [
        (1, "accepted"),
        (2, "rejected"),
        (3, "accepted"),
        (5, "rejected"),
    ];
    assert_eq!(
        tied,
        json!(expected.map(|(nth, standing)| answer(nth, standing)))
    );

    std::fs::remove_file(street.log()).unwrap();
    let server = Server::start(&map, &["--teach", text(&labels)]);
    ended("serve/teach.py", &["blind", &server.http]);
}

/// What answers teach, as the plan `people` has it, of the pictures of a street.
const LEARNT: &str = "\
plan: learnt
extends: asked.yaml
steps:
  answered_images:
    sql: >
      SELECT said.site, said.session, said.stamp, said.camera, p.image
      FROM (SELECT DISTINCT site, anchor['session'] AS session, anchor['stamp'] AS stamp, anchor['camera'] AS camera
            FROM placed_labels WHERE kind = 'person' AND anchor['camera'] IS NOT NULL) said
      LEFT JOIN pictures p
        ON p.site = said.site AND p.session = said.session AND p.stamp = said.stamp AND p.camera = said.camera
  person_examples:
    op: person_examples
    in: { images: answered_images, labels: placed_labels, calibration: cameras, transforms: mounts }
write: [pictures, poses, cameras, mounts, said, label_anchors, placed_labels, person_questions, person_examples]
";

/// Who was missed is drawn on a whole image, by HTTP and on the page; the act is in the author's log, and the next run has
/// learnt from it.
#[test]
fn people_who_were_missed_are_drawn_on_images_and_the_next_run_learns_from_it() {
    let street = AskedStreet::new();
    let (map, labels) = (street.map(), street.path("labels"));
    let server = Server::start(&map, &["--teach", text(&labels)]);
    ended("serve/teach.py", &["missed", &server.http]);
    ended("serve/teach.py", &["drawn", &server.http]);
    drop(server);
    let logs = std::fs::read_dir(labels.join("map/street")).unwrap();
    let mut logs: Vec<_> = logs.map(|log| log.unwrap().path()).collect();
    logs.sort();
    let plan = street.path("learnt.yaml");
    std::fs::write(&plan, LEARNT).unwrap();
    let mut sessions = vec!["--sessions"];
    sessions.extend(logs.iter().map(|log| text(log)));
    // The server was killed: its logs have no end.
    run_of_site(text(&plan), &map, "street", &sessions).expect(3);

    let pictures = "(SELECT *, row_number() OVER (ORDER BY stamp) AS nth FROM pictures)";
    let said = format!(
        "SELECT p.nth, a.act, count(*) AS n FROM said a JOIN {pictures} p
           ON p.session = a.anchor['session'] AND p.stamp = a.anchor['stamp'] AND p.camera = a.anchor['camera']
         WHERE a.kind = 'person' GROUP BY p.nth, a.act ORDER BY p.nth, a.act"
    );
    let act = |nth: u64, act: &str, n: u64| json!({ "nth": nth, "act": act, "n": n });
    // Two were drawn, taken back, and drawn again.
    let expected = json!([
        act(1, "drawn", 2),
        act(2, "drawn", 2),
        act(6, "accepted", 1)
    ]);
    assert_eq!(rows_of(&map, &said), expected);

    let examples = format!(
        "SELECT p.nth, e.standing, e.x, e.y FROM person_examples e JOIN {pictures} p USING (session, stamp, camera)
         WHERE e.standing = 'drawn' ORDER BY p.nth"
    );
    let examples = rows_of(&map, &examples);
    let examples = examples.as_array().unwrap();
    let of_images: Vec<_> = examples.iter().map(|row| row["nth"].as_u64()).collect();
    assert_eq!(of_images, [Some(1), Some(2)]);
    for row in examples {
        let [x, y] = ["x", "y"].map(|name| row[name].as_f64().unwrap());
        // As far as a box of six columns says, and where the image speaks for somebody nearby.
        assert!((x - 5.0).hypot(y) < 2.5, "{row}");
    }

    let server = Server::start(&map, &["--teach", text(&labels)]);
    ended("serve/teach.py", &["learnt", &server.http]);
}

/// What Chromium makes of the page, once its scripts have done their work; `None` where it is not installed.
fn page(address: &str, picture: Option<&Path>) -> Option<String> {
    let chromium = Path::new("/usr/bin/chromium");
    evermap_test_data::there(chromium.into(), "`make test` installs it")?;
    let profile = tempfile::tempdir().unwrap();
    let mut browser = bounded(chromium);
    browser
        .args(["--headless", "--no-sandbox", "--disable-gpu"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .args(["--window-size=1400,900", "--virtual-time-budget=30000"]);
    match picture {
        Some(picture) => browser.arg(format!("--screenshot={}", picture.display())),
        None => browser.arg("--dump-dom"),
    };
    let ended = Finished::from(browser.arg(address).output().unwrap()).expect(0);
    Some(ended.stdout)
}

/// The text of elements with an id, as far as their first end tag.
fn element<'p>(page: &'p str, id: &str) -> &'p str {
    let behind = page.split_once(&format!("id=\"{id}\"")).unwrap().1;
    let inner = behind.split_once('>').unwrap().1;
    inner.split_once("</").unwrap().0
}

#[test]
fn the_page_shows_a_map_and_answers_queries() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &[]);
    let poses = rows_of(
        &map,
        "SELECT count(*) AS n FROM poses WHERE session = 'monday'",
    );
    let query = "SELECT+*+FROM+poses+WHERE+session+%3D+'monday'";
    let shown = format!("http://{}/#query={query}", server.http);
    let Some(text) = page(&shown, None) else {
        return;
    };
    assert_eq!(element(&text, "version-name"), "2 of 2");
    assert!(element(&text, "version-about").contains("monday, tuesday"));
    assert!(text.contains("<option value=\"lot\">"), "no site");
    for layer in ["poses", "lanes", "intersections"] {
        assert!(
            text.contains(&format!("id=\"layer-{layer}\"")),
            "{layer} is not offered"
        );
    }
    assert!(!text.contains("id=\"layer-landmarks\""), "the map has none");
    let n = &poses[0]["n"];
    let title = element(&text, "drawer-title");
    assert!(
        title.starts_with(&format!("{n} drawn: {n} rows")),
        "{title}"
    );
    assert_eq!(element(&text, "fault"), "");
    let moved = element(&text, "moved");
    assert!(moved.ends_with("poses"), "{moved}");

    let before = format!(
        "http://{}/maps/map/#version=1&query=SELECT+nothing+FROM+poses",
        server.http
    );
    let text = page(&before, None).unwrap();
    assert_eq!(element(&text, "version-name"), "1 of 2");
    assert!(element(&text, "fault").contains("No field named nothing"));

    let look = std::env::var("EVERMAP_LOOK").ok();
    let place = look.map_or_else(|| folder.path().to_owned(), Into::into);
    let picture = place.join("page.png");
    page(&shown, Some(&picture));
    assert!(std::fs::metadata(&picture).unwrap().len() > 10_000);
}

/// A file that only its owner reads.
fn private(path: &Path, written: &str) {
    std::fs::write(path, written).unwrap();
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(path, mode).unwrap();
}

const USERS: &str =
    "users:\n- {name: ada, password: byron-1815}\n- {name: robot, token: t0ken-t0ken}\n";

#[test]
fn nobody_comes_in_without_a_password_where_there_are_users() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let users = folder.path().join("users.yaml");
    private(&users, USERS);
    let server = Server::start(&map, &["--users", text(&users)]);
    ended(
        "serve/attack.py",
        &["closed", &server.http, &server.postgres],
    );
    ended("serve/live.py", &["closed", &server.http]);
    let said = server.stopped();
    assert!(!said.contains("panicked"), "{said}");

    let (certificate, key) = (folder.path().join("it.pem"), folder.path().join("key.pem"));
    let made = std::process::Command::new("openssl")
        .args([
            "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2",
        ])
        .args([
            "-subj",
            "/CN=localhost",
            "-addext",
            "subjectAltName=DNS:localhost",
        ])
        .args(["-keyout", text(&key), "-out", text(&certificate)])
        .output();
    Finished::from(made.unwrap()).expect(0);
    let tls = ["--certificate", text(&certificate), "--key", text(&key)];
    let server = Server::start(&map, &[&["--users", text(&users)], &tls[..]].concat());
    let arguments = [
        "private",
        &server.http,
        &server.postgres,
        text(&certificate),
    ];
    ended("serve/attack.py", &arguments);
    let arguments = ["private", &server.http, text(&certificate)];
    ended("serve/live.py", &arguments);
}

#[test]
fn a_door_that_would_stand_open_is_not_opened() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let users = folder.path().join("users.yaml");
    std::fs::write(&users, USERS).unwrap();
    let nowhere = folder.path().join("nowhere");
    for (arguments, says) in [
        (
            vec!["--http", "0.0.0.0:0"],
            "expected --users, --certificate and --key",
        ),
        (vec!["--postgres", "[::]:0"], "reached from other machines"),
        (vec!["--users", text(&users)], "that only its owner reads"),
        (vec!["--users", text(&nowhere)], "cannot read it"),
        (
            vec!["--certificate", text(&users), "--key", text(&users)],
            "expected PEM",
        ),
        (vec!["--map", text(&nowhere)], "nowhere"),
        (vec!["--map", text(&map)], "two maps are called map"),
    ] {
        let mut serve = command(&["serve", "--map", text(&map), "--postgres", "127.0.0.1:0"]);
        if arguments[0] != "--http" {
            serve.args(["--http", "127.0.0.1:0"]);
        }
        if arguments[0] == "--postgres" {
            serve = command(&["serve", "--map", text(&map), "--http", "127.0.0.1:0"]);
        }
        let ended = Finished::from(serve.args(&arguments).output().unwrap()).expect(1);
        assert!(
            ended.stderr.contains(says),
            "{arguments:?}: {}",
            ended.stderr
        );
    }
}
