//! `evermap serve`: what psycopg, ADBC and HTTP read is what `evermap sql` prints, also while versions are published,
//! and what must be refused is.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod server;

use std::path::Path;

use evermap_tests::{Finished, command, evermap, text};
use serde_json::{Value, json};

use server::{Server, drive, map, script};

fn ended(name: &str, arguments: &[&str]) {
    if let Some(mut script) = script(name, arguments) {
        Finished::from(script.output().unwrap()).expect(0);
    }
}

fn sql(map: &Path, query: &str) -> Value {
    evermap(&["sql", "--map", text(map), "--format", "json", query])
        .expect(0)
        .json()
}

#[test]
fn programs_read_what_evermap_sql_prints() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let queries = include_str!("queries.sql").split(";\n");
    let queries = queries.filter(|query| !query.trim().is_empty());
    let asked: Vec<Value> = queries
        .map(|query| json!([query, sql(&map, query)]))
        .collect();
    assert!(asked.len() >= 60);
    let expected = folder.path().join("expected.json");
    std::fs::write(&expected, Value::from(asked).to_string()).unwrap();
    let server = Server::start(&map, &[]);
    ended(
        "clients.py",
        &[&server.http, &server.postgres, text(&expected)],
    );
}

/// Each answer is of one version, the newest when it was asked for; many clients at once hold no more and more memory.
#[test]
fn clients_see_versions_whole_while_they_are_published() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &[]);
    let arguments = [server.postgres.as_str(), server.http.as_str()];
    let Some(mut readers) = script("readers.py", &arguments) else {
        return;
    };
    let mut readers = readers
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
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
    let poses = sql(&map, "SELECT count(*) AS n FROM poses");
    assert!(
        ended.stdout.contains(&format!("last {}", poses[0]["n"])),
        "{}",
        ended.stdout
    );
}

#[test]
fn a_server_is_read_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let server = Server::start(&map, &["--rows", "100000", "--timeout-s", "3"]);
    ended("attack.py", &["open", &server.http, &server.postgres]);
    assert!(server.memory() < 1 << 30, "{} bytes", server.memory());
    drop(server);
    evermap(&["verify", "--map", text(&map)]).expect(0);
    assert!(!Path::new("/tmp/evermap-attack.csv").exists());
    assert!(!Path::new("/tmp/evermap-attack.parquet").exists());
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
    ended("attack.py", &["closed", &server.http, &server.postgres]);
    drop(server);

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
    ended("attack.py", &arguments);
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
