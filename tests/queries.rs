//! SQL over layers and logs, as text files in `tests/sql` (sqllogictest). Run with `EVERMAP_BLESS=1` to complete them.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use datafusion::arrow::datatypes::SchemaRef;
use datafusion::arrow::util::display::{ArrayFormatter, FormatOptions};
use datafusion::prelude::SessionContext;
use evermap_engine::map::Map;
use evermap_engine::sql::{Limits, context, read_only};
use evermap_tests::{
    BESIDE_MIB, Finished, command, evermap, rectangle, repository, rows_of, run, run_of_site, text,
    watched, write_drive,
};
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
        let frame = read_only(&self.0, query).await;
        let frame = frame.map_err(|fault| refused(&fault))?;
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
    run("trajectory", &map, &[&drives[0], &drives[1]], &[]).expect(0);
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
    check("logs.slt", context.clone());
    check("integers.slt", context.clone());
    check("floats.slt", context);
}

/// A small map, with the folder that holds it.
fn mapped() -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let (drives, map) = (drives(folder.path()), folder.path().join("map"));
    run("trajectory", &map, &[&drives[0]], &[]).expect(0);
    (folder, map)
}

/// The columns of a Parquet file, as programs see them that know nothing of evermap.
fn columns(file: &Path) -> SchemaRef {
    let rows = ParquetRecordBatchReaderBuilder::try_new(File::open(file).unwrap());
    rows.unwrap().schema().clone()
}

/// What a column says of itself.
fn known(columns: &SchemaRef, name: &str) -> HashMap<String, String> {
    columns.field_with_name(name).unwrap().metadata().clone()
}

fn said(notes: &[(&str, &str)]) -> HashMap<String, String> {
    let notes = notes.iter();
    let notes = notes.map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
    notes.collect()
}

/// Layers of queries that pass columns on, of layers that are stored, of one that is not, of one another and of logs.
const PASSED_ON: &str = "
plan: passed_on
steps:
  keyframes: { op: keyframes, in: { odometry: odometry } }
  lanes: { op: road_network, in: { keyframes: keyframes } }
  speeds: { op: speeds }
  poses:
    sql: SELECT site, session, stamp, odom_from_vehicle AS map_from_vehicle FROM keyframes
  passed:
    sql: >
      SELECT site, session, stamp AS at, distance_m, odom_from_vehicle, odom_from_vehicle AS map_from_vehicle,
             odom_from_vehicle['x'] AS x, distance_m * 1000 AS distance_mm, CAST(stamp AS BIGINT) AS instant
      FROM keyframes
  again:
    sql: SELECT site, session, at, distance_m AS path, odom_from_vehicle['y'] AS y FROM passed
  spots:
    sql: >
      SELECT site, lane, geometry, point, st_length(geometry) AS length
      FROM (SELECT site, lane, geometry, unnest(points) AS point FROM lanes)
  slow:
    sql: SELECT site, session, speed_mps, CAST(stamp AS BIGINT) AS instant FROM speeds
  logged:
    sql: SELECT site, session, stamp, speed_mps, -speed_mps AS backward FROM odometry
write: [keyframes, lanes, poses, passed, again, spots, slow, logged]
";

#[test]
fn layers_of_queries_have_the_units_and_frames_of_what_they_pass_on() {
    let folder = tempfile::tempdir().unwrap();
    let (drive, plan) = (
        folder.path().join("a.mcap"),
        folder.path().join("plan.yaml"),
    );
    let map = folder.path().join("map");
    write_drive(&drive, rectangle(20.0, 10.0, 1.0));
    std::fs::write(&plan, PASSED_ON).unwrap();
    run_of_site(text(&plan), &map, "lot", &["--sessions", text(&drive)]).expect(0);
    let layer = |name: &str| {
        let mut files = std::fs::read_dir(map.join("newest").join(name)).unwrap();
        columns(&files.next().unwrap().unwrap().path())
    };
    let [keyframes, lanes, poses, passed, again, spots, slow, logged] = [
        "keyframes",
        "lanes",
        "poses",
        "passed",
        "again",
        "spots",
        "slow",
        "logged",
    ]
    .map(layer);

    let metres = [("x.unit", "m"), ("y.unit", "m"), ("z.unit", "m")];
    let in_odom = said(&[&metres[..], &[("frame", "odom")]].concat());
    assert_eq!(known(&keyframes, "odom_from_vehicle"), in_odom);
    for (found, of, origin) in [
        (known(&passed, "at"), &keyframes, "stamp"),
        (known(&passed, "distance_m"), &keyframes, "distance_m"),
        (
            known(&passed, "odom_from_vehicle"),
            &keyframes,
            "odom_from_vehicle",
        ),
        (known(&again, "at"), &keyframes, "stamp"),
        (known(&again, "path"), &keyframes, "distance_m"),
        (known(&spots, "point"), &lanes, "points"),
        (known(&spots, "geometry"), &lanes, "geometry"),
    ] {
        assert!(
            found.contains_key("unit") || found.contains_key("frame"),
            "{origin}"
        );
        assert_eq!(found, known(of, origin), "{origin}");
    }
    // Members, rows of logs, and those of a layer that is not stored.
    let metre = said(&[("unit", "m")]);
    assert_eq!(known(&passed, "x"), metre);
    assert_eq!(known(&again, "y"), metre);
    let speed = said(&[("unit", "m/s"), ("frame", "vehicle")]);
    assert_eq!(known(&logged, "speed_mps"), speed);
    assert_eq!(known(&slow, "speed_mps"), said(&[("unit", "m/s")]));
    // What is computed has none, and what is said to be in another frame is not in its own.
    for (columns, computed) in [
        (&passed, "distance_mm"),
        (&passed, "instant"),
        (&spots, "length"),
        (&slow, "instant"),
        (&logged, "backward"),
    ] {
        assert_eq!(known(columns, computed), said(&[]), "{computed}");
    }
    assert_eq!(known(&passed, "map_from_vehicle"), said(&metres));
    let in_map = said(&[&metres[..], &[("frame", "map")]].concat());
    assert_eq!(
        known(&poses, "map_from_vehicle"),
        in_map,
        "it is the layer poses"
    );
    assert!(keyframes.metadata().contains_key("evermap.layer"));
    for columns in [&passed, &slow, &logged] {
        assert!(!columns.metadata().contains_key("evermap.layer"));
    }
    assert!(spots.metadata().contains_key("geo"));
    assert!(!passed.metadata().contains_key("geo"));

    // Whoever reads the map is told the same.
    let told = rows_of(
        &map,
        "SELECT \"column\", unit, frame FROM columns WHERE layer = 'passed' AND (unit <> '' OR frame <> '') ORDER BY 1",
    );
    let line = |line: &serde_json::Value| {
        ["column", "unit", "frame"].map(|key| line[key].as_str().unwrap().to_owned())
    };
    let told: Vec<[String; 3]> = told.as_array().unwrap().iter().map(line).collect();
    assert_eq!(
        told,
        [
            ["at", "ns", ""],
            ["distance_m", "m", ""],
            ["map_from_vehicle.x", "m", ""],
            ["map_from_vehicle.y", "m", ""],
            ["map_from_vehicle.z", "m", ""],
            ["odom_from_vehicle", "", "odom"],
            ["odom_from_vehicle.x", "m", ""],
            ["odom_from_vehicle.y", "m", ""],
            ["odom_from_vehicle.z", "m", ""],
            ["x", "m", ""],
        ]
    );
    let file = folder.path().join("out.parquet");
    let written = |arguments: &[&str]| {
        let to = [
            "--map",
            text(&map),
            "--format",
            "parquet",
            "--out",
            text(&file),
        ];
        evermap(&[&arguments[..1], &to[..], &arguments[1..]].concat()).expect(0);
        columns(&file)
    };
    let exported = written(&["export", "passed"]);
    for name in [
        "at",
        "odom_from_vehicle",
        "map_from_vehicle",
        "x",
        "distance_mm",
    ] {
        assert_eq!(known(&exported, name), known(&passed, name), "{name}");
    }
    let answer = written(&[
        "sql",
        "SELECT p.at, p.x AS east, p.x + 1 AS further, f.odom_from_vehicle_y AS north, p.odom_from_vehicle['z'] AS up
         FROM passed p JOIN keyframes_flat f ON p.at = f.stamp",
    ]);
    assert_eq!(known(&answer, "at"), said(&[("unit", "ns")]));
    for name in ["east", "north", "up"] {
        assert_eq!(known(&answer, name), metre, "{name}");
    }
    assert_eq!(known(&answer, "further"), said(&[]));
}

/// Numbers one in ten of which is 1, the others NaN; as they are, and within columns.
const NOT_A_NUMBER: &str = "
plan: not_a_number
steps:
  speeds: { op: speeds, in: { odometry: odometry } }
  made:
    sql: >
      SELECT site, session, stamp, v, CAST(v AS REAL) AS single, named_struct('v', v) AS pair, make_array(v) AS list,
             2.5 AS constant
      FROM (SELECT *, CASE row_number() OVER (ORDER BY stamp) % 10 WHEN 0 THEN 1.0 ELSE CAST('NaN' AS DOUBLE) END AS v
            FROM speeds)
write: [made]
";

/// Parquet's least and greatest value are those of numbers alone.
#[test]
fn what_is_not_a_number_is_read_back_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let drive = folder.path().join("a.mcap");
    let (plan, map) = (folder.path().join("plan.yaml"), folder.path().join("map"));
    write_drive(&drive, rectangle(20.0, 10.0, 1.0));
    std::fs::write(&plan, NOT_A_NUMBER).unwrap();
    run_of_site(text(&plan), &map, "lot", &["--sessions", text(&drive)]).expect(0);
    let answer = |query: &str| {
        let asked = ["sql", "--map", text(&map), "--format", "csv", query];
        let rows = evermap(&asked).expect(0).stdout;
        rows.lines().skip(1).collect::<Vec<_>>().join(" ")
    };
    let rows: usize = answer("SELECT count(*) FROM made").parse().unwrap();
    let ones = rows / 10;
    let (others, all) = ((rows - ones).to_string(), rows.to_string());
    assert!(ones > 10);
    for column in ["v", "single", "pair['v']", "list[1]"] {
        let counted = format!("SELECT {column} AS v, count(*) FROM made GROUP BY 1 ORDER BY 2");
        assert_eq!(answer(&counted), format!("1.0,{ones} NaN,{others}"));
        for (asked, expected) in [
            (format!("count(*) FROM made WHERE {column} > 2"), &others),
            (format!("count(*) FROM made WHERE isnan({column})"), &others),
            (format!("max({column}) FROM made"), &"NaN".to_owned()),
        ] {
            assert_eq!(&answer(&format!("SELECT {asked}")), expected, "{asked}");
        }
    }
    for (asked, expected) in [
        ("min(constant), max(constant) FROM made", "2.5,2.5"),
        ("count(*) FROM made WHERE constant > 2", all.as_str()),
        ("count(*) FROM made WHERE constant > 3", "0"),
    ] {
        assert_eq!(answer(&format!("SELECT {asked}")), expected, "{asked}");
    }
}

#[test]
fn queries_compare_several_maps() {
    let (folder, map) = mapped();
    let other = folder.path().join("other");
    let drive = folder.path().join("a.mcap");
    run("trajectory", &other, &[&drive], &[]).expect(0);
    let named = format!("second={}", text(&other));
    let ask = |maps: &[&str], query: &str| {
        let maps = maps.iter().flat_map(|map| ["--map", map]);
        let words: Vec<&str> = ["sql"].into_iter().chain(maps).collect();
        evermap(&[&words[..], &["--format", "csv", query]].concat())
    };
    let joined = "SELECT count(*) AS n FROM poses JOIN other.poses AS o ON poses.session = o.session AND poses.stamp = o.stamp";
    let both = [text(&map), text(&other)];
    assert_eq!(ask(&both, joined).expect(0).stdout, "n\n301\n");
    for (query, n) in [
        ("SELECT count(*) AS n FROM second.poses", "301"),
        ("SELECT count(*) AS n FROM second.v1.poses", "301"),
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
    let at = known(&columns(&file), "at");
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
    let plan_of = |query: &str| {
        let plan = folder.path().join("nested.yaml");
        let lines = format!("plan: nested\nsteps:\n  t: {{ sql: '{query}' }}\nwrite: [t]\n");
        std::fs::write(&plan, lines).unwrap();
        evermap(&["check", text(&plan)])
    };
    for query in nested([2_000, 700, 700]) {
        evermap(&["sql", "--map", text(&map), &query]).expect(0);
        let checked = plan_of(&query);
        assert!(
            checked.code >= 0,
            "a signal ended the check: {}",
            checked.stderr
        );
    }
    for query in nested([11_000, 2_600, 1_200]) {
        let refused = evermap(&["sql", "--map", text(&map), &query]).expect(1);
        assert!(
            refused.stderr.contains("words and operators"),
            "{}",
            refused.stderr
        );
        let refused = plan_of(&query).expect(1);
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
        std::thread::sleep(Duration::from_millis(50));
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
    let endless = "SELECT sum(value % 2) FROM generate_series(1, 9223372036854775807)";
    // No pair of rows makes one, so nothing comes between which it could pause.
    let fruitless = "SELECT count(*) FROM generate_series(1, 1000000) a JOIN generate_series(1, 1000000) b \
         ON a.value * b.value < 0";
    for query in [counting, fruitless, endless, &planning] {
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
        let interrupted = Instant::now();
        let ended: evermap_tests::Finished = asked.wait_with_output().unwrap().into();
        let waited = interrupted.elapsed();
        // A second, on a machine that does nothing else.
        assert!(waited < Duration::from_secs(5), "{waited:?}: {query:.60}");
        let ended = ended.expect(1);
        assert!(ended.stderr.contains("stopped"), "{}", ended.stderr);
    }
}

/// MiB that a query may have.
const MEMORY_MIB: u64 = 64;

#[test]
fn sorts_windows_groups_and_joins_larger_than_memory_are_answered_from_disk() {
    let (folder, map) = mapped();
    let out = folder.path().join("answer.csv");
    let limit = format!("{MEMORY_MIB}MiB");
    let ask = |query: &str| {
        let mut asked = command(&["sql", "--map", text(&map), "--memory", &limit]);
        asked.args(["--format", "csv", "--out", text(&out), query]);
        let (ended, most) = watched(asked);
        assert!(most > 0, "nobody looked while it ran: {query}");
        assert!(
            most <= MEMORY_MIB + BESIDE_MIB,
            "{query}: {most} MiB resident"
        );
        ended
    };
    // 500 MB of texts each time.
    let texts =
        "(SELECT value AS n, repeat('a', 1000) || value AS t FROM generate_series(1, 500000))";
    let numbers = "generate_series(1, 3000000)";
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
        (
            format!("SELECT count(*) FROM {numbers} a JOIN {numbers} b ON a.value = b.value"),
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
    for whole in ["length(string_agg(t, ''))", "array_length(array_agg(t))"] {
        let refused = ask(&format!("SELECT {whole} FROM {texts}")).expect(1);
        assert!(refused.stderr.contains("resource: "), "{}", refused.stderr);
    }
}

/// A list of 150 MB fits into the memory, and what CSV, JSON, a table or Parquet make of it does not.
#[test]
fn rows_that_are_too_heavy_to_be_written_are_refused() {
    const LIMIT_MIB: u64 = 256;
    let (folder, map) = mapped();
    let limit = format!("{LIMIT_MIB}MiB");
    let ask = |format: &str, values: u32| {
        let out = folder.path().join(format!("answer.{format}"));
        let query = format!(
            "SELECT array_agg(repeat('x', 100000) || value) FROM generate_series(1, {values})"
        );
        let mut asked = command(&["sql", "--map", text(&map), "--memory", &limit]);
        asked.args(["--format", format, "--out", text(&out), &query]);
        let (ended, most) = watched(asked);
        assert!(most > 0, "nobody looked while it ran: {format}");
        assert!(
            most <= LIMIT_MIB + BESIDE_MIB,
            "{format}: {most} MiB resident"
        );
        (ended, out)
    };
    for format in ["csv", "json", "table", "parquet"] {
        let (refused, out) = ask(format, 1500);
        let refused = refused.expect(1).stderr;
        assert!(refused.contains("a row on its way out needs"), "{refused}");
        assert!(refused.contains("--format arrow") && !out.exists());
        ask(format, 200).0.expect(0);
    }
    ask("arrow", 1500).0.expect(0);
}

/// Little memory has them joined by merging, as there may be no room for a side.
#[test]
fn joins_with_little_memory_answer_as_those_with_much() {
    let (_folder, map) = mapped();
    let instants = |numbers: &str| {
        format!(
            "(SELECT arrow_cast(value, 'Timestamp(ns, \"UTC\")') AS t FROM generate_series({numbers}))"
        )
    };
    let numbers = |numbers: &str, part: u32| {
        format!(
            "(SELECT value AS i, coalesce(value % {part}, 0) AS k FROM generate_series({numbers}))"
        )
    };
    let (many, even) = (instants("1, 30000"), instants("2, 60000, 2"));
    let (left, right) = (numbers("1, 30000", 7), numbers("2, 60000, 2", 5));
    let outer = |kind: &str| {
        format!(
            "SELECT count(*), count(a.k), count(b.k), sum(a.k), sum(b.k) FROM {left} a {kind} JOIN {right} b ON a.i = b.i AND a.k < b.k"
        )
    };
    let mut queries = vec![
        format!("SELECT count(*) FROM {many} a WHERE t IN (SELECT t FROM {even})"),
        format!("SELECT count(*) FROM {many} a WHERE t NOT IN (SELECT t FROM {even})"),
        format!(
            "SELECT count(*) FROM {many} a WHERE NOT EXISTS (SELECT 1 FROM {even} b WHERE b.t = a.t)"
        ),
        format!("SELECT count(*) FROM (SELECT t FROM {many} INTERSECT SELECT t FROM {even})"),
        format!("SELECT count(*) FROM (SELECT t FROM {many} EXCEPT SELECT t FROM {even})"),
        format!("SELECT count(*) FROM {many} a JOIN {even} b ON a.t = b.t"),
        format!(
            "SELECT count(*) FROM {many} a WHERE (t - TIMESTAMP '1970-01-01T00:00:00Z') IN (SELECT t - TIMESTAMP '1970-01-01T00:00:00Z' FROM {even})"
        ),
    ];
    queries.extend(["LEFT", "RIGHT", "FULL", "INNER"].map(outer));
    // Keys of which many are equal, so that groups of them go on from batch to batch.
    for key in [
        "CASE WHEN value % 3 = 0 THEN CAST('NaN' AS DOUBLE) ELSE value % 5 END",
        "named_struct('x', CASE WHEN value % 3 = 0 THEN 0.5 ELSE value % 5 END)",
        "make_array(value % 3, NULL)",
        "arrow_cast(value % 7, 'Time64(ns)')",
        "CASE value % 4 WHEN 0 THEN INTERVAL '1 day' WHEN 1 THEN INTERVAL '24 hours' ELSE INTERVAL '1 month' END",
        "CASE WHEN value % 3 = 0 THEN NULL ELSE arrow_cast(value % 5, 'Timestamp(ns, \"UTC\")') END",
    ] {
        let keys = |numbers: &str| format!("(SELECT {key} AS k FROM generate_series({numbers}))");
        let (many, others) = (keys("1, 30000"), keys("2, 60000, 6"));
        queries.push(format!(
            "SELECT count(*) FROM {many} a WHERE k IN (SELECT k FROM {others})"
        ));
        queries.push(format!(
            "SELECT count(*) FROM (SELECT k FROM {many} INTERSECT SELECT k FROM {others})"
        ));
    }
    for query in &queries {
        let [little, much] = ["64MiB", "4GiB"].map(|memory| {
            let map = text(&map);
            let asked = [
                "sql", "--map", map, "--memory", memory, "--format", "csv", query,
            ];
            evermap(&asked).expect(0).stdout
        });
        assert_eq!(little, much, "{query}");
        assert!(!little.contains("\n0\n"), "{query}: {little}");
    }
}

#[test]
fn what_a_killed_query_put_aside_goes_with_the_next_that_puts_something_aside() {
    let ((_folder, map), temporary) = (mapped(), tempfile::tempdir().unwrap());
    let sorted =
        "SELECT repeat('a', 1000) || value AS t FROM generate_series(1, 200000) ORDER BY t DESC";
    let ask = || {
        let mut asked = command(&["sql", "--map", text(&map), "--memory", "32MiB", sorted]);
        asked.env("TMPDIR", temporary.path()).stdout(Stdio::null());
        asked.spawn().unwrap()
    };
    let left = || std::fs::read_dir(temporary.path()).unwrap().count();
    // Who is killed before its folder has a lock leaves one for a day, as of a process that just begins.
    let is_put_aside = || {
        let mut entries = std::fs::read_dir(temporary.path()).unwrap().flatten();
        entries.any(|entry| entry.path().join("lock").exists())
    };
    let begun = Instant::now();
    let mut killed = ask();
    while !is_put_aside() {
        assert!(
            begun.elapsed() < Duration::from_secs(60),
            "nothing is put aside"
        );
        std::thread::sleep(Duration::from_millis(10));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert_eq!(left(), 1);
    assert!(ask().wait().unwrap().success());
    assert_eq!(left(), 0);
}

/// A log of 2,000 messages of 400 kB, a few kilobytes when packed.
fn log_of_heavy_rows(path: &Path) {
    let chunks = mcap::WriteOptions::new().chunk_size(Some(1_600_000));
    let mut log = chunks.create(File::create(path).unwrap()).unwrap();
    let fields = b"uint32 n\nuint8[] data\n";
    let schema = log.add_schema("a/msg/Heavy", "ros2msg", fields).unwrap();
    let topic = log.add_channel(schema, "/heavy", "cdr", &BTreeMap::new());
    let mut header = mcap::records::MessageHeader {
        channel_id: topic.unwrap(),
        sequence: 0,
        log_time: 0,
        publish_time: 0,
    };
    for n in 0..2000_u32 {
        (header.sequence, header.log_time) = (n, n.into());
        let data = [[0, 1, 0, 0], n.to_le_bytes(), 400_000_u32.to_le_bytes()].concat();
        let data = [data, vec![0; 400_000]].concat();
        log.write_to_known_channel(&header, &data).unwrap();
    }
    log.finish().unwrap();
}

/// Filters, and what deals rows out to the cores, put them together: a thousand of these have 400 MB.
#[test]
fn queries_of_heavy_rows_need_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let (log, out) = (
        folder.path().join("log.mcap"),
        folder.path().join("answer.csv"),
    );
    log_of_heavy_rows(&log);
    let limit = format!("{MEMORY_MIB}MiB");
    for (query, lines) in [
        ("SELECT octet_length(data) AS bytes FROM \"/heavy\"", 2001),
        (
            "SELECT n, octet_length(data) AS bytes FROM \"/heavy\" WHERE n % 2 = 0",
            1001,
        ),
        (
            "SELECT data FROM \"/heavy\" WHERE octet_length(data) > 5 AND n % 100 = 0",
            21,
        ),
        (
            "SELECT sum(octet_length(data)) FROM messages WHERE sequence > 3",
            2,
        ),
        (
            "SELECT h.n, octet_length(h.data) AS bytes FROM \"/heavy\" h \
             JOIN (SELECT DISTINCT n FROM \"/heavy\" WHERE n % 2 = 0) o ON h.n = o.n",
            1001,
        ),
        (
            "SELECT h.n, octet_length(h.data) AS bytes FROM \"/heavy\" h \
             JOIN (VALUES (10.5), (1500.5)) v(x) ON h.n > v.x AND h.n < v.x + 400",
            801,
        ),
        (
            "SELECT octet_length(h.data) AS bytes FROM (VALUES (1), (2)) v(x) CROSS JOIN \"/heavy\" h",
            4001,
        ),
        (
            "SELECT n % 4 AS part, max(octet_length(data)) FROM \"/heavy\" GROUP BY n % 4",
            5,
        ),
    ] {
        let mut asked = command(&["sql", "--sessions", text(&log), "--memory", &limit]);
        asked.args(["--format", "csv", "--out", text(&out), query]);
        let (ended, most) = watched(asked);
        ended.expect(0);
        let answer = std::fs::read(&out).unwrap();
        let found = answer.iter().filter(|byte| **byte == b'\n').count();
        assert_eq!(found, lines, "{query}");
        assert!(
            most <= MEMORY_MIB + BESIDE_MIB,
            "{query}: {most} MiB resident"
        );
    }
}

/// What a map's versions are made of, by path.
fn stored(map: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let folders = ["versions", "artifacts", "receipts", "runs"];
    let entries = folders.map(|folder| std::fs::read_dir(map.join(folder)).unwrap());
    let paths = entries.into_iter().flatten();
    let paths = paths.map(|entry| entry.unwrap().path());
    let files = paths.filter(|path| path.is_file());
    files
        .map(|path| (path.clone(), std::fs::read(&path).unwrap()))
        .collect()
}

#[test]
fn queries_change_nothing_and_read_no_other_file() {
    let (folder, map) = mapped();
    let before = stored(&map);
    assert!(before.len() > 5);
    let (other, made) = (
        folder.path().join("other.csv"),
        folder.path().join("made.json"),
    );
    std::fs::write(&other, "a\nsecret\n").unwrap();
    let (other, version) = (text(&other), map.join("versions/1.json"));
    let copy = |to: &Path| format!("COPY (SELECT 1 AS a) TO '{}'", text(to));
    for query in [
        copy(&made),
        copy(&version),
        format!("EXPLAIN ANALYZE {}", copy(&made)),
        format!("CREATE EXTERNAL TABLE t (a TEXT) STORED AS CSV LOCATION '{other}'"),
        "INSERT INTO poses SELECT * FROM poses".to_owned(),
        "DELETE FROM poses".to_owned(),
        "DROP TABLE poses".to_owned(),
        "SET datafusion.runtime.memory_limit = '1T'".to_owned(),
        format!("SELECT * FROM '{other}'"),
        format!("SELECT * FROM \"{other}\""),
    ] {
        let refused = evermap(&["sql", "--map", text(&map), &query]).expect(1);
        let said = format!("{}{}", refused.stdout, refused.stderr);
        assert!(!said.contains("secret"), "{query}: {said}");
        let reason = ["only reads", "there is no table"];
        assert!(
            reason.iter().any(|reason| said.contains(reason)),
            "{query}: {said}"
        );
    }
    assert!(!made.exists(), "a query has written");
    assert!(stored(&map) == before, "a query has changed the map");
}
