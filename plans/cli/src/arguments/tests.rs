#![allow(clippy::unwrap_used, clippy::panic)]
use super::*;
use clap::CommandFactory;

#[cfg(feature = "cluster")]
mod documented;

fn read(line: &str) -> Result<Command, clap::Error> {
    Arguments::try_parse_from(line.split_whitespace()).map(|arguments| arguments.command)
}

#[test]
fn the_command_line_is_sound() {
    Arguments::command().debug_assert();
}

#[test]
fn sessions_and_settings_are_lists() {
    let line = "evermap run car_park --map m --sessions a.mcap b.mcap --set x.y=1 --set x.z=2 --jobs 3 --memory 2GiB";
    let Ok(Command::Run(args)) = read(line) else {
        panic!("{line}")
    };
    assert_eq!(args.input.sessions.sessions, ["a.mcap", "b.mcap"]);
    assert_eq!(args.input.set, ["x.y=1", "x.z=2"]);
    assert_eq!((args.limits.jobs, args.limits.memory), (Some(3), 2 << 30));
}

#[test]
fn a_query_stands_apart_from_sessions() {
    let query = "SELECT 1";
    let lines: [&[&str]; 5] = [
        &["--sessions", "a", "b", "--format", "json", "-q", query],
        &[query, "--sessions", "a", "b"],
        &["--sessions", "a", "b", "--", query],
        &["--sessions", "a", "b", query],
        &["--sessions", "a", "b", query, "--format", "json"],
    ];
    for line in lines {
        let arguments = ["evermap", "sql"].iter().chain(line);
        let Command::Sql(args) = Arguments::try_parse_from(arguments).unwrap().command else {
            panic!("{line:?}")
        };
        let (sessions, found) = args.split();
        assert_eq!(sessions.sessions, ["a", "b"], "{line:?}");
        assert_eq!(found.as_deref(), Some(query), "{line:?}");
    }
    let Ok(Command::Sql(args)) = read("evermap sql --sessions a.mcap select.mcap") else {
        panic!()
    };
    assert_eq!(args.split().1, None);
}

#[test]
fn rows_are_written_as_their_file_ends_unless_it_is_said_otherwise() {
    let written = |rest: &str| {
        let Ok(Command::Sql(args)) = read(&format!("evermap sql --map m {rest} -q q")) else {
            panic!("{rest}")
        };
        args.written()
    };
    for (rest, format) in [
        ("", Format::Table),
        ("--out a.parquet", Format::Parquet),
        ("--out a.CSV", Format::Csv),
        ("--out a.b.json", Format::Json),
        ("--out a.arrow", Format::Arrow),
        ("--out a.txt", Format::Table),
        ("--out csv", Format::Table),
        ("--out a.txt --format csv", Format::Csv),
        ("--out a.parquet --format parquet", Format::Parquet),
    ] {
        assert_eq!(written(rest).unwrap(), format, "{rest}");
    }
    let fault = written("--out a.parquet --format csv").unwrap_err();
    let said = "user: expected a file that ends in .csv, found a.parquet; leave --format out, or say --format parquet";
    assert_eq!(fault.to_string(), said);
}

#[test]
fn what_makes_no_sense_is_wrong_usage() {
    let lines = [
        "evermap",
        "evermap run p",
        "evermap sql SELECT",
        "evermap sql --sessions s --version 3",
        "evermap render --map m --out m.bmp",
        "evermap render --map m --out m.png --width-px 5",
        "evermap run p --map m --memory lots",
        "evermap run p --map m --jobs 0",
        "evermap simulate moon --out d",
        "evermap simulate street --out d --visits 2 --revisits 1",
        "evermap export lanes --map m --format dxf --out f",
    ];
    for line in lines {
        assert_eq!(read(line).map(|_| ()).unwrap_err().exit_code(), 2, "{line}");
    }
}

/// Runs throw away what nobody said, and what marks nothing.
#[test]
fn authors_and_kinds_are_not_empty() {
    let annotate = "evermap annotate --map m --import f.json --out a.mcap";
    let with = |name: &str, text: &str| {
        let more = [name, text];
        Arguments::try_parse_from(annotate.split_whitespace().chain(more))
    };
    for name in ["--author", "--kind"] {
        assert!(with(name, "a b").is_ok(), "{name}");
        for text in ["", "  "] {
            let error = with(name, text).map(|_| ()).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{name} {text:?}");
            let said = error.to_string();
            assert!(said.contains("expected a name or a word"), "{said}");
        }
    }
}

#[test]
fn a_program_takes_the_memory_that_a_library_does() {
    let limits = evermap_engine::sql::Limits::default();
    assert_eq!(quantity::bytes(MEMORY), Ok(limits.memory_bytes));
}
