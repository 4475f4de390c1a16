//! Maps to be served, and the server.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};

use crate::{command, memory, python, rectangle, repository, run_of_site, text, write_drive};

/// A server of a map, stopped when it is dropped.
pub struct Server {
    program: Child,
    /// What it says when it serves.
    said: BufReader<ChildStderr>,
    /// Address of HTTP and Flight SQL.
    pub http: String,
    /// Address of Postgres' protocol.
    pub postgres: String,
}

impl Server {
    /// Starts it on ports that are free.
    pub fn start(map: &Path, more: &[&str]) -> Self {
        Self::start_in(&std::env::temp_dir(), map, more)
    }

    /// As [`Server::start`], with its temporary files in a folder.
    pub fn start_in(temporary: &Path, map: &Path, more: &[&str]) -> Self {
        let mut serve = command(&["serve", "--map", text(map)]);
        serve.env("TMPDIR", temporary);
        serve.args(["--http", "127.0.0.1:0", "--postgres", "127.0.0.1:0"]);
        let started = serve.args(more).stderr(Stdio::piped()).spawn();
        let mut program = started.unwrap();
        let mut said = BufReader::new(program.stderr.take().unwrap());
        let mut text = String::new();
        while !text.contains("Postgres:") {
            let read = said.read_line(&mut text).unwrap();
            assert!(read > 0, "the server ended: {text}");
        }
        let address = |before: &str| {
            let behind = text.split_once(before).unwrap().1;
            let address = behind.split_once("://").unwrap().1;
            address.split(['/', '\n']).next().unwrap().to_owned()
        };
        Self {
            http: address("page and HTTP:"),
            postgres: address("Postgres:"),
            program,
            said,
        }
    }

    /// What `GET` is answered.
    pub fn got(&self, address: &str) -> String {
        let mut stream = TcpStream::connect(&self.http).unwrap();
        let request =
            format!("GET {address} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    /// Stops it; what it has said since it serves.
    pub fn stopped(mut self) -> String {
        self.program.kill().unwrap();
        let mut text = String::new();
        self.said.read_to_string(&mut text).unwrap();
        text
    }

    /// Hundredths of a second that its threads have computed.
    pub fn computed(&self) -> u64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.program.id())).unwrap();
        // In user and in system code, counted behind the name.
        let fields = stat.rsplit(')').next().unwrap().split_whitespace();
        let times = fields.skip(11).take(2);
        times.map(|field| field.parse::<u64>().unwrap()).sum()
    }

    /// Bytes of memory that the server holds.
    pub fn memory(&self) -> u64 {
        memory(self.program.id(), "VmRSS:").expect("the server runs")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.program.kill().unwrap();
        self.program.wait().unwrap();
    }
}

/// A map of two drives, `monday` and `tuesday`, two versions.
pub fn map(folder: &Path) -> PathBuf {
    let map = folder.join("map");
    for (day, width_m) in [("monday", 30.0), ("tuesday", 32.0)] {
        drive(folder, &map, day, width_m);
    }
    map
}

/// Adds a version with one more drive.
pub fn drive(folder: &Path, map: &Path, day: &str, width_m: f64) {
    let log = folder.join(format!("{day}.mcap"));
    write_drive(&log, rectangle(width_m, 20.0, 1.0));
    run_of_site("trajectory", map, "lot", &["--sessions", text(&log)]).expect(0);
}

/// A Python script beside the tests, with the programs that people have; `None` where they are not installed.
pub fn script(name: &str, arguments: &[&str]) -> Option<Command> {
    let mut script = bounded(&python()?);
    script.arg(repository().join("tests").join(name));
    script.args(arguments);
    Some(script)
}

/// A program of others that is ended, with all that it began, where it does not end: the test fails then, and not the suite.
pub fn bounded(program: &Path) -> Command {
    let mut bounded = Command::new("timeout");
    bounded.args(["--kill-after=10s", "15m"]).arg(program);
    bounded
}
