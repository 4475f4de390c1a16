//! SQL over layers and logs, as text files in `tests/sql` (sqllogictest). Run with `EVERMAP_BLESS=1` to complete them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::Write;
use std::path::Path;
use std::process::Stdio;

use datafusion::arrow::util::display::{ArrayFormatter, FormatOptions};
use datafusion::prelude::SessionContext;
use evermap_engine::map::Map;
use evermap_engine::sql::{Limits, context};
use evermap_tests::{Finished, command, evermap, rectangle, repository, text, write_drive};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use sqllogictest::{AsyncDB, DBOutput, DefaultColumnType, Runner};

struct Database(SessionContext);

#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Refused(String);

#[async_trait::async_trait]
impl AsyncDB for Database {
    type Error = Refused;
    type ColumnType = DefaultColumnType;

    async fn run(&mut self, query: &str) -> Result<DBOutput<DefaultColumnType>, Refused> {
        let refused = |error: &dyn std::fmt::Display| {
            Refused(error.to_string().lines().next().unwrap_or_default().into())
        };
        let frame = self.0.sql(query).await.map_err(|error| refused(&error))?;
        let batches = frame.collect().await.map_err(|error| refused(&error))?;
        let options = FormatOptions::default().with_null("NULL");
        let mut rows = Vec::new();
        let mut types = Vec::new();
        for batch in &batches {
            let columns: Vec<_> = batch
                .columns()
                .iter()
                .map(|column| ArrayFormatter::try_new(column, &options).unwrap())
                .collect();
            types = vec![DefaultColumnType::Any; columns.len()];
            rows.extend((0..batch.num_rows()).map(|row| {
                columns
                    .iter()
                    .map(|column| column.value(row).to_string())
                    .collect::<Vec<_>>()
            }));
        }
        Ok(DBOutput::Rows { types, rows })
    }

    async fn shutdown(&mut self) {}
}

fn check(file: &str, context: SessionContext) {
    let path = repository().join("tests/sql").join(file);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let mut runner = Runner::new(move || {
            let context = context.clone();
            async move { Ok(Database(context)) }
        });
        if std::env::var_os("EVERMAP_BLESS").is_some() {
            let compare = sqllogictest::default_column_validator;
            let validate = sqllogictest::default_validator;
            let normalise = sqllogictest::default_normalizer;
            runner
                .update_test_file(&path, "\t", validate, normalise, compare)
                .await
                .unwrap();
        } else {
            runner.run_file_async(&path).await.unwrap();
        }
    });
}

fn drives(folder: &Path) -> Vec<std::path::PathBuf> {
    let (a, b) = (folder.join("a.mcap"), folder.join("b.mcap"));
    write_drive(&a, rectangle(20.0, 10.0, 1.0));
    write_drive(&b, rectangle(30.0, 15.0, 1.0));
    vec![a, b]
}

#[test]
fn layers_of_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let (drives, map) = (drives(folder.path()), folder.path().join("map"));
    let sessions = [text(&drives[0]), text(&drives[1])];
    evermap(&[
        "run",
        "trajectory",
        "--map",
        text(&map),
        "--sessions",
        sessions[0],
        sessions[1],
    ])
    .expect(0);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let context = runtime.block_on(async {
        let map = Map::open(text(&map), None).await.unwrap();
        let limits = Limits {
            partitions: 1,
            ..Limits::default()
        };
        map.context(context(limits).unwrap(), &evermap_catalog::registry())
            .unwrap()
    });
    check("layers.slt", context);
}

#[test]
fn tables_of_logs() {
    let folder = tempfile::tempdir().unwrap();
    let paths: Vec<String> = drives(folder.path())
        .iter()
        .map(|path| text(path).to_owned())
        .collect();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let context = runtime.block_on(async {
        let context = context(Limits {
            partitions: 1,
            ..Limits::default()
        })
        .unwrap();
        let dataset = evermap_datasets::Dataset::open(&context.runtime_env(), &paths, None)
            .await
            .unwrap();
        dataset.register(&context).unwrap();
        context
    });
    check("logs.slt", context);
}

/// A small map, with the folder that holds it.
fn mapped() -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let (drives, map) = (drives(folder.path()), folder.path().join("map"));
    let run = [
        "run",
        "trajectory",
        "--map",
        text(&map),
        "--sessions",
        text(&drives[0]),
    ];
    evermap(&run).expect(0);
    (folder, map)
}

#[test]
fn queries_compare_several_maps() {
    let (folder, map) = mapped();
    let other = folder.path().join("other");
    let drive = folder.path().join("a.mcap");
    let run = [
        "run",
        "trajectory",
        "--map",
        text(&other),
        "--sessions",
        text(&drive),
    ];
    evermap(&run).expect(0);
    let named = format!("second={}", text(&other));
    let ask = |maps: &[&str], query: &str| {
        let maps = maps.iter().flat_map(|map| ["--map", map]);
        let words: Vec<&str> = ["sql"].into_iter().chain(maps).collect();
        evermap(&[&words[..], &["--format", "csv", query]].concat())
    };
    let joined = "SELECT count(*) AS n FROM poses JOIN other.poses AS o ON poses.session = o.session AND poses.stamp = o.stamp";
    let both = [text(&map), text(&other)];
    assert_eq!(ask(&both, joined).expect(0).stdout, "n\n300\n");
    for (query, n) in [
        ("SELECT count(*) AS n FROM second.poses", "300"),
        ("SELECT count(*) AS n FROM second.v1.poses", "300"),
        ("SELECT count(*) > 0 AS n FROM second.a.\"/odom\"", "true"),
        ("SELECT max(version) AS n FROM second.versions", "1"),
    ] {
        let found = ask(&[text(&map), &named], query).expect(0).stdout;
        assert_eq!(found, format!("n\n{n}\n"), "{query}");
    }
    let twice = ask(&[text(&map), text(&other), text(&other)], joined)
        .expect(1)
        .stderr;
    assert!(
        twice.contains("`other` is the name of several maps"),
        "{twice}"
    );
}

#[test]
fn maps_and_logs_are_asked_together_from_a_folder_beside_them() {
    let (folder, map) = mapped();
    let beside = folder.path().join("beside");
    std::fs::create_dir(&beside).unwrap();
    let drive = folder.path().join("b.mcap");
    let ask = |arguments: &[&str], typed: &str| {
        let mut sql = command(&["sql", "--format", "csv"]);
        sql.args(arguments).current_dir(&beside);
        sql.stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut sql = sql.spawn().unwrap();
        let mut stdin = sql.stdin.take().unwrap();
        stdin.write_all(typed.as_bytes()).unwrap();
        drop(stdin);
        Finished::from(sql.wait_with_output().unwrap())
    };
    let name = map.file_name().unwrap().to_str().unwrap();
    let relative = format!("first=../{name}");
    let log = ["--map", &relative, "--sessions", text(&drive)];
    let counted = "SELECT (SELECT count(*) FROM first.poses) > 0 AND (SELECT count(*) FROM b.odometry) > 0 AS both;\n";
    assert_eq!(ask(&log, counted).expect(0).stdout, "both\ntrue\n");
    // A topic of a session is described by the name that it is read by.
    let described = ask(&log, "DESCRIBE b.\"/odom\";\n").expect(0).stdout;
    assert!(described.contains("\nb./odom,pose,"), "{described}");
    let described = ask(&log, "\\d b.\"/odom\"\n").expect(0).stdout;
    assert!(described.contains("b./odom"), "{described}");
    let fault = ask(&log, "DESCRIBE b.\"/odm\";\n").expect(1).stderr;
    assert!(fault.contains("did you mean `b.\"/odom\"`?"), "{fault}");
    // What a prompt knows, and what comes behind it.
    let told = ask(
        &["--map", &relative],
        "\\d poses\nDESCRIBE poses;\n\\q\nSELECT 7;",
    )
    .expect(0)
    .stdout;
    let told: Vec<&str> = told
        .lines()
        .filter(|line| line.contains("map_from_vehicle.x"))
        .collect();
    assert!(
        matches!(told[..], [table, csv] if table.contains("| m ") && csv.contains(",m,,")),
        "{told:?}"
    );
    let fault = ask(&["--map", &relative], "SELECT site\nFROM posess@1")
        .expect(1)
        .stderr;
    assert!(
        fault.contains("did you mean `v1.poses`") && fault.contains("line 2, column 6"),
        "{fault}"
    );
    let file = beside.join("rows.parquet");
    let out = ["--format", "parquet", "--out", text(&file)];
    let asked = [
        &["sql", "--map", text(&map)],
        &out[..],
        &["SELECT map_from_vehicle AS at FROM poses"],
    ];
    evermap(&asked.concat()).expect(0);
    let rows =
        ParquetRecordBatchReaderBuilder::try_new(std::fs::File::open(&file).unwrap()).unwrap();
    let at = rows.schema().field(0).metadata().clone();
    assert_eq!(at.get("frame").map(String::as_str), Some("map"), "{at:?}");
    let refused = ask(
        &["--map", &relative],
        "SELECT * FROM poses TABLESAMPLE (10)",
    )
    .expect(1)
    .stderr;
    assert!(refused.contains("TABLESAMPLE"), "{refused}");
}

/// Queries that nest by these many terms, for each way to nest without brackets: sums, unions, tables of tables.
fn nested([sums, unions, tables]: [usize; 3]) -> [String; 3] {
    let unions = (0..unions).map(|n| format!("SELECT {n} AS a"));
    let chain = (1..tables).map(|n| format!("c{n} AS (SELECT a + 1 AS a FROM c{})", n - 1));
    let chain = chain.collect::<Vec<_>>().join(", ");
    [
        format!("SELECT {} AS a", vec!["1"; sums].join(" + ")),
        unions.collect::<Vec<_>>().join(" UNION ALL "),
        format!(
            "WITH c0 AS (SELECT 1 AS a), {chain} SELECT a FROM c{}",
            tables - 1
        ),
    ]
}

#[test]
fn queries_of_many_terms_are_answered_and_larger_ones_refused_in_plans_too() {
    let (folder, map) = mapped();
    for query in nested([700, 700, 700]) {
        evermap(&["sql", "--map", text(&map), &query]).expect(0);
    }
    for query in nested([11_000, 2_600, 1_200]) {
        let refused = evermap(&["sql", "--map", text(&map), &query]).expect(1);
        assert!(
            refused.stderr.contains("words and operators"),
            "{}",
            refused.stderr
        );
        let plan = folder.path().join("large.yaml");
        let lines = format!("plan: large\nsteps:\n  t: {{ sql: '{query}' }}\nwrite: [t]\n");
        std::fs::write(&plan, lines).unwrap();
        let refused = evermap(&["check", text(&plan)]).expect(1);
        assert!(
            refused.stderr.contains("words and operators"),
            "{}",
            refused.stderr
        );
    }
}

/// Waits until a process has computed for a second, so that it is at work and no more beginning.
#[cfg(target_os = "linux")]
fn computes(process: &std::process::Child) {
    let stat = format!("/proc/{}/stat", process.id());
    loop {
        let stat = std::fs::read_to_string(&stat).unwrap();
        let fields: Vec<&str> = stat
            .rsplit(')')
            .next()
            .unwrap()
            .split_whitespace()
            .collect();
        // Hundredths of a second in user code, counted behind the name.
        if fields[11].parse::<u64>().unwrap() > 100 {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn queries_are_interrupted_while_they_run_and_while_they_are_planned() {
    let (_folder, map) = mapped();
    let counting =
        "SELECT count(*) FROM generate_series(1, 1000000) a, generate_series(1, 1000000) b";
    let joined = (1..800).map(|n| format!("JOIN poses p{n} ON p0.stamp = p{n}.stamp"));
    let joined = joined.collect::<Vec<_>>().join(" ");
    let planning = format!("SELECT count(*) FROM poses p0 {joined}");
    for query in [counting, &planning] {
        let mut asked = evermap_tests::command(&["sql", "--map", text(&map), query]);
        let asked = asked.stderr(std::process::Stdio::piped()).spawn().unwrap();
        computes(&asked);
        let interrupt = ["-INT", &asked.id().to_string()];
        assert!(
            std::process::Command::new("kill")
                .args(interrupt)
                .status()
                .unwrap()
                .success()
        );
        let ended: evermap_tests::Finished = asked.wait_with_output().unwrap().into();
        let ended = ended.expect(1);
        assert!(ended.stderr.contains("stopped"), "{}", ended.stderr);
    }
}

#[test]
fn sorts_windows_and_groups_larger_than_memory_are_answered_from_disk() {
    let (folder, map) = mapped();
    let out = folder.path().join("answer.csv");
    let ask = |query: &str| {
        let small = [
            "sql",
            "--map",
            text(&map),
            "--memory",
            "64MiB",
            "--format",
            "csv",
        ];
        evermap(&[&small[..], &["--out", text(&out), query]].concat())
    };
    // 500 MB of texts each time.
    let texts =
        "(SELECT value AS n, repeat('a', 1000) || value AS t FROM generate_series(1, 500000))";
    for (query, lines) in [
        (format!("SELECT t FROM {texts} ORDER BY t DESC"), 500_001),
        (
            format!("SELECT lag(t) OVER (PARTITION BY n % 10 ORDER BY n) FROM {texts}"),
            500_001,
        ),
        (
            format!("SELECT count(*) FROM (SELECT t, count(*) FROM {texts} GROUP BY t)"),
            2,
        ),
    ] {
        ask(&query).expect(0);
        let answer = std::fs::read(&out).unwrap();
        assert_eq!(
            answer.iter().filter(|byte| **byte == b'\n').count(),
            lines,
            "{query}"
        );
    }
    let refused = ask(&format!("SELECT length(string_agg(t, '')) FROM {texts}")).expect(1);
    assert!(refused.stderr.contains("resource: "), "{}", refused.stderr);
}
