#![allow(clippy::unwrap_used)]
use std::time::{Duration, Instant};

use arrow::util::display::array_value_to_string;
use evermap_schemas::Fault;

use crate::error::OrFault;
use crate::sql::{Limits, Term, context, read_only};

#[tokio::test]
async fn what_an_argument_makes_larger_than_memory_is_refused_and_the_rest_is_as_it_was() {
    let limits = Limits {
        memory_bytes: 1 << 20,
        ..Limits::one_partition()
    };
    let context = context(limits).unwrap();
    let run = async |query: &str| {
        let frame = context.sql(query).await.or_fault()?;
        frame.collect().await.or_fault()
    };
    for query in [
        "SELECT repeat('a', 2000000000)",
        "SELECT length(repeat('ab', n * 1000000)) FROM (VALUES (1), (2)) t (n)",
        "SELECT lpad('a', 2000000000)",
        "SELECT rpad('a', 2000000000, 'b')",
        "SELECT array_repeat(1, 2000000000)",
        "SELECT list_repeat(1, 2000000000)",
        "SELECT range(0, 2000000000)",
        "SELECT range(2000000000)",
        "SELECT generate_series(2000000000, 0, -1)",
        "SELECT replace(repeat('a', 10000), 'a', repeat('b', 10000))",
        "SELECT regexp_replace(repeat('a', 10000), 'a', repeat('b', 10000), 'g')",
        "SELECT max(regexp_replace(repeat('ab', 100) || value, 'a', repeat('c', 100), 'g')) FROM generate_series(1, 100)",
        "SELECT regexp_replace(repeat('a', 10000), '.*', repeat('\\0', 20))",
        "SELECT array_repeat(array_repeat(array_repeat(1, 100), 100), 100)",
        "SELECT range(TIMESTAMP '1970-01-01', TIMESTAMP '1970-01-02', INTERVAL '1 microsecond')",
        "SELECT array_resize([1], 2000000000, 0)",
        "SELECT array_to_string(range(0, 1000), repeat('x', 10000))",
        "SELECT concat_ws(repeat('x', 50000), 'a', 'b', 'c', 'd')",
        "SELECT concat(repeat('x', 70000), repeat('y', 70000))",
        "SELECT x || x FROM (SELECT repeat('x', 60000) || n AS x FROM (VALUES (1), (2)) t (n))",
        "WITH a AS (SELECT repeat('a', 1000) AS x), b AS (SELECT x || x || x || x AS x FROM a), \
         c AS (SELECT x || x || x || x AS x FROM b), d AS (SELECT x || x || x || x AS x FROM c), \
         e AS (SELECT x || x || x || x AS x FROM d) SELECT length(x) FROM e",
        "SELECT array_concat(range(0, 10000), range(0, 10000))",
        "SELECT range(0, 10000) || range(0, 10000)",
        "SELECT [repeat('x', 70000), repeat('y', 70000)]",
        "SELECT array_append(range(0, 16000), 1) || 2 || 3 || range(0, 1000)",
        "SELECT array_replace_all(array_repeat('a', 1000), 'a', repeat('b', 1000))",
        "SELECT unnest(range(0, 100000000000))",
        // The text is one for all rows, until it is put together with them.
        "SELECT concat(repeat('x', 50000), CAST(n AS TEXT)) FROM (VALUES (1), (2), (3)) t (n)",
    ] {
        let fault = run(query).await.unwrap_err().to_string();
        assert!(fault.contains("the limit is 131072"), "{query}: {fault}");
    }
    for query in [
        "SELECT approx_percentile_cont(n, 0.5, 9000000000) FROM (VALUES (1), (2)) t (n)",
        "SELECT approx_percentile_cont(0.5, 2000000000) WITHIN GROUP (ORDER BY n) FROM (VALUES (1)) t (n)",
        "SELECT approx_percentile_cont_with_weight(n, n, 0.5, 0) FROM (VALUES (1)) t (n)",
    ] {
        let fault = run(query).await.unwrap_err().to_string();
        assert!(
            fault.contains("expected 1 to 10000 centroids"),
            "{query}: {fault}"
        );
    }
    // Each makes twice of what it is given.
    let nested = (0..6).fold("repeat('a', 60000)".to_owned(), |text, _| {
        format!("encode({text}, 'hex')")
    });
    let fault = run(&format!("SELECT length({nested})")).await.unwrap_err();
    let fault = fault.to_string();
    assert!(fault.contains("half of the memory"), "{fault}");
    for (query, expected) in [
        (
            "SELECT length(regexp_replace(repeat('a', 10000), 'a', repeat('b', 10000)))",
            "19999",
        ),
        (
            "SELECT length(regexp_replace(repeat('a', 10000), '(.*)', '<\\1\\1>'))",
            "20002",
        ),
        // What matches is little: it is found a few rows at a time.
        (
            "SELECT sum(length(regexp_replace(repeat('ab', 100) || value, 'x|9', repeat('c', 100), 'g'))) FROM generate_series(10, 99)",
            "20061",
        ),
    ] {
        let answer = run(query).await.unwrap();
        let found = array_value_to_string(answer[0].column(0), 0).unwrap();
        assert_eq!(found, expected, "{query}");
    }
    run("SELECT approx_percentile_cont(n, 0.5, 200) FROM (VALUES (1), (2)) t (n)")
        .await
        .unwrap();
    let answers = run(
        "SELECT repeat('a', 3), lpad('a', 3, '-'), array_repeat(1, 2), range(3), \
         generate_series(1, 2), replace('aba', 'a', 'cc'), repeat(NULL, 3), repeat('a', -1), \
         regexp_replace('ab', '(b)', '\\1\\1'), array_length(range(DATE '2026-01-01', DATE '2026-02-01', INTERVAL '1 day')), \
         array_resize([1], 2, 7), array_to_string([1, 2], '-'), concat_ws('-', 'a', NULL, 'b')",
    );
    let answers = answers.await.unwrap();
    let answers: Vec<String> = answers[0]
        .columns()
        .iter()
        .map(|column| array_value_to_string(column, 0).unwrap())
        .collect();
    let expected = [
        "aaa",
        "--a",
        "[1, 1]",
        "[0, 1, 2]",
        "[1, 2]",
        "ccbcc",
        "",
        "",
        "abb",
        "31",
        "[1, 7]",
        "1-2",
        "a-b",
    ];
    assert_eq!(answers, expected);
}

#[tokio::test]
async fn operators_are_what_they_were() {
    let context = context(Limits::one_partition()).unwrap();
    let query = "SELECT t.a || '-' || t.b || t.n, t.a || NULL AS none, 1 || t.a AS one, [t.n, 2] || 3 AS list, \
         CAST(t.a AS BYTEA) || CAST(t.b AS BYTEA) AS bytes \
         FROM (VALUES ('x', 'y', 1), ('x', NULL, 2)) AS t (a, b, n) \
         WHERE t.a || 'y' = 'xy' ORDER BY t.a || t.n DESC";
    let frame = read_only(&context, query).await.unwrap();
    let planned = frame.schema().as_arrow().clone();
    let batches = frame.collect().await.unwrap();
    // A column is called as it is written.
    let (name, schema) = (planned.field(0).name(), batches[0].schema());
    assert!(name.contains("||"), "{name}");
    assert_eq!(schema.field(0).name(), name);
    let shown = |row: usize| {
        let columns = batches[0].columns().iter();
        columns
            .map(|column| array_value_to_string(column, row).unwrap())
            .collect::<Vec<_>>()
    };
    assert_eq!(shown(0), ["", "", "1x", "[2, 2, 3]", ""]);
    assert_eq!(shown(1), ["x-y1", "", "1x", "[1, 2, 3]", "7879"]);
    let long = vec!["'a'"; 200].join(" || ");
    let answer = context
        .sql(&format!("SELECT length({long})"))
        .await
        .unwrap();
    let answer = answer.collect().await.unwrap();
    assert_eq!(
        array_value_to_string(answer[0].column(0), 0).unwrap(),
        "200"
    );
}

#[tokio::test]
async fn what_one_row_alone_takes_too_long_for_is_refused_before_it_is_begun() {
    let context = context(Limits::one_partition()).unwrap();
    let line = "st_geomfromtext('LINESTRING(' || repeat('0 0, ', 60000) || '1 ' || n || ')')";
    for (call, says) in [
        (
            "levenshtein(repeat('a', 200000), repeat('b', 200000))".to_owned(),
            "levenshtein would take 40000000000 steps for one row, of 200000 and 200000 bytes; the limit is 10000000000",
        ),
        (
            "trim(BOTH repeat('b', 199999) || n FROM repeat('a', 200000))".to_owned(),
            "btrim would take",
        ),
        (
            "strpos(repeat('a', 1000000) || n, repeat('a', 500000) || 'b')".to_owned(),
            "strpos would take",
        ),
        (
            "array_has_all(range(0, 100000 + n), range(0, 100000))".to_owned(),
            "array_has_all would take",
        ),
        (format!("st_distance({line}, {line})"), "cut the geometries"),
    ] {
        let query = format!("SELECT {call} FROM (VALUES (1)) t (n)");
        let begun = Instant::now();
        let frame = read_only(&context, &query).await.unwrap();
        let fault = frame.collect().await.or_fault().unwrap_err().to_string();
        let is_refused = fault.starts_with("resource: ") && fault.contains(says);
        assert!(is_refused, "{call}: {fault}");
        // It would compute for minutes.
        assert!(begun.elapsed() < Duration::from_secs(30), "{call}");
    }
}

#[tokio::test]
async fn rows_that_are_computed_slice_by_slice_are_what_they_were() {
    let context = context(Limits::one_partition()).unwrap();
    // Texts that are a slice each, though what is asked of them takes no time.
    for (call, expected) in [
        (
            "length(btrim(repeat('a', 20000) || n, repeat('b', 20000)))",
            ["20001", "", "20002"],
        ),
        (
            "regexp_count(repeat('a', 120000) || n, '[0-9]')",
            ["1", "", "2"],
        ),
        (
            "length(regexp_replace(repeat('a', 120000) || n, '^a*', 'b', 'g'))",
            ["2", "", "3"],
        ),
    ] {
        let query = format!("SELECT {call} FROM (VALUES (1), (NULL), (12)) t (n)");
        let frame = read_only(&context, &query).await.unwrap();
        let batches = frame.collect().await.unwrap();
        let found: Vec<String> = batches
            .iter()
            .flat_map(|batch| {
                let column = batch.column(0);
                (0..batch.num_rows()).map(|row| array_value_to_string(column, row).unwrap())
            })
            .collect();
        assert_eq!(found, expected, "{call}");
    }
}

/// A batch of thousands of rows that takes minutes, at least.
const SLOW: &str = "SELECT max(levenshtein(repeat(CAST(value % 10 AS TEXT), 4000), repeat(CAST(value % 7 AS TEXT), 4000))) \
                    FROM generate_series(1, 8192)";

/// A query of a text in which an expression looks to the end from every place.
fn places(call: &str) -> String {
    let texts = "SELECT repeat('a', 1000000) || n AS text FROM (VALUES (1)) t (n)";
    format!("SELECT {call} FROM ({texts})")
}

#[tokio::test]
async fn slow_functions_end_with_their_query_in_all_its_tasks() {
    for (partitions, query) in [
        (1, SLOW.to_owned()),
        (2, SLOW.to_owned()),
        (1, places("length(regexp_replace(text, '.*b|a', 'c', 'g'))")),
        (
            1,
            places("length(regexp_replace(text, '.*b|(a)', '<\\1>', 'g'))"),
        ),
        (1, places("regexp_count(text, '.*b|a')")),
        (1, places("regexp_instr(text, '.*b|a', 1, 1000000)")),
    ] {
        let limits = Limits {
            partitions,
            ..Limits::default()
        };
        let context = context(limits).unwrap();
        let ask = async || {
            let frame = read_only(&context, &query).await?;
            frame.collect().await.or_fault()
        };
        let begun = Instant::now();
        let late = Fault::resource("the time is over");
        let at = Term::until(begun + Duration::from_millis(500), late.clone());
        assert_eq!(at.of(ask()).await.unwrap_err(), late);

        let stopped = Term::default();
        let stopping = std::thread::spawn({
            let stopped = stopped.clone();
            move || {
                std::thread::sleep(Duration::from_millis(500));
                stopped.end();
            }
        });
        let told = stopped.of(ask()).await.unwrap_err();
        stopping.join().unwrap();
        assert_eq!(told, Fault::user("stopped"));
        assert!(
            begun.elapsed() < Duration::from_secs(100),
            "{query} in {partitions}: {:?}",
            begun.elapsed()
        );
    }
}
