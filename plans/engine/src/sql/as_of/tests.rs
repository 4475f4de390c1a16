#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use arrow::array::{ArrayRef, Int64Array, RecordBatch, StringArray, TimestampNanosecondArray};
use arrow::datatypes::{DataType, Field, Schema, TimeUnit};
use arrow::util::display::array_value_to_string;
use datafusion::datasource::MemTable;
use datafusion::prelude::SessionContext;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::sql::{Limits, context_with, read_only};

/// A row: key, time, number. A key or a time may be unknown.
type Row = (Option<String>, Option<i64>, i64);

fn schema() -> Arc<Schema> {
    Arc::new(Schema::new(vec![
        Field::new("key", DataType::Utf8, true),
        Field::new("t", DataType::Timestamp(TimeUnit::Nanosecond, None), true),
        Field::new("n", DataType::Int64, false),
    ]))
}

fn batch(rows: &[Row]) -> RecordBatch {
    let keys: StringArray = rows.iter().map(|row| row.0.clone()).collect();
    let times: TimestampNanosecondArray = rows.iter().map(|row| row.1).collect();
    let numbers: Int64Array = rows.iter().map(|row| Some(row.2)).collect();
    let columns: Vec<ArrayRef> = vec![Arc::new(keys), Arc::new(times), Arc::new(numbers)];
    RecordBatch::try_new(schema(), columns).unwrap()
}

fn rows(random: &mut ChaCha8Rng, count: usize, keys: usize, longest: i64) -> Vec<Row> {
    let row = |number| {
        let key = random.random_range(0..=keys);
        let time = random.random_range(0..=longest);
        let key = (key > 0).then(|| format!("k{key}"));
        (key, (time > 0).then_some(time), number as i64)
    };
    let mut rows: Vec<Row> = (0..count).map(row).collect();
    // Which of two rows of one time comes is not said.
    rows.sort_by_key(|row| (row.0.clone(), row.1));
    rows.dedup_by_key(|row| (row.0.clone(), row.1));
    rows.sort_by_key(|row| (row.2 * 7919) % 1009);
    rows
}

/// Tables `l` and `r`, in batches and partitions of any size.
fn tables(left: &[Row], right: &[Row], random: &mut ChaCha8Rng) -> SessionContext {
    let limits = Limits {
        partitions: random.random_range(1..5),
        ..Limits::default()
    };
    let context = context_with(limits, random.random_range(1..40)).unwrap();
    for (name, rows) in [("l", left), ("r", right)] {
        let parts = random.random_range(1..4);
        let size = random.random_range(1..30);
        let chunks = rows.chunks(rows.len().div_ceil(parts).max(1));
        let mut parts: Vec<Vec<RecordBatch>> = chunks
            .map(|rows| rows.chunks(size).map(batch).collect())
            .collect();
        parts.resize_with(parts.len().max(1), Vec::new);
        let table = MemTable::try_new(schema(), parts).unwrap();
        context.register_table(name, Arc::new(table)).unwrap();
    }
    context
}

async fn asked(context: &SessionContext, query: &str) -> Vec<String> {
    let batches = read_only(context, query)
        .await
        .unwrap()
        .collect()
        .await
        .unwrap();
    let mut found = Vec::new();
    for batch in batches {
        found.extend((0..batch.num_rows()).map(|row| {
            let cells = batch.columns().iter();
            let cells = cells.map(|column| array_value_to_string(column, row).unwrap());
            cells.collect::<Vec<_>>().join(",")
        }));
    }
    found
}

/// The number of the row that matches, by looking at all.
fn nearest(row: &Row, right: &[Row], op: &str, keyed: bool, within: Option<i64>) -> Option<i64> {
    let (key, time) = (row.0.as_ref(), row.1?);
    if keyed {
        key?;
    }
    let fits = |other: &&Row| {
        let Some(of) = other.1 else { return false };
        let same = !keyed || other.0.as_ref() == key;
        same && match op {
            ">=" => time >= of,
            ">" => time > of,
            "<=" => time <= of,
            _ => time < of,
        }
    };
    let all = right.iter().filter(fits);
    let best = match op {
        ">=" | ">" => all.max_by_key(|other| other.1),
        _ => all.min_by_key(|other| other.1),
    }?;
    let gap = (time - best.1?).abs();
    within.is_none_or(|within| gap < within).then_some(best.2)
}

#[tokio::test]
async fn rows_that_match_are_those_found_by_looking_at_all() {
    let mut random = ChaCha8Rng::seed_from_u64(evermap_test_data::seed());
    for round in 0..200 {
        let keys = random.random_range(1..4);
        let longest = random.random_range(1..60);
        let mut table = |most| {
            let count = random.random_range(0..most);
            rows(&mut random, count, keys, longest)
        };
        let (left, mut right) = (table(80), table(120));
        let keyed = random.random_bool(0.7);
        if !keyed {
            right.sort_by_key(|row| row.1);
            right.dedup_by_key(|row| row.1);
        }
        let op = [">=", ">", "<=", "<"][random.random_range(0..4)];
        let within = random.random_bool(0.5).then(|| random.random_range(1..20));
        let on = if keyed { "ON r.key = l.key" } else { "" };
        let gap = if op.starts_with('>') {
            "l.t - r.t"
        } else {
            "r.t - l.t"
        };
        let limit = within.map_or(String::new(), |within| {
            format!("AND {gap} < INTERVAL '{within} nanoseconds'")
        });
        let query = format!(
            "SELECT l.n, r.n FROM l ASOF JOIN r MATCH_CONDITION (l.t {op} r.t {limit}) {on} ORDER BY l.n"
        );
        let context = tables(&left, &right, &mut random);
        let mut expected: Vec<(i64, Option<i64>)> = left
            .iter()
            .map(|row| (row.2, nearest(row, &right, op, keyed, within)))
            .collect();
        expected.sort_unstable();
        let expected: Vec<String> = expected
            .iter()
            .map(|(left, right)| {
                format!("{left},{}", right.map_or(String::new(), |n| n.to_string()))
            })
            .collect();
        assert_eq!(
            asked(&context, &query).await,
            expected,
            "round {round}: {query}"
        );
    }
}

/// Two keys, times 1 to 4.
fn small() -> SessionContext {
    let row = |key: &str, time, number| (Some(key.to_owned()), Some(time), number);
    let left = [row("a", 2, 1), row("a", 4, 2), row("b", 1, 3)];
    let right = [row("a", 1, 10), row("a", 3, 30), row("b", 2, 20)];
    tables(&left, &right, &mut ChaCha8Rng::seed_from_u64(1))
}

#[tokio::test]
async fn as_of_joins_stand_among_other_joins_subqueries_and_unions() {
    let context = small();
    let on = "MATCH_CONDITION (l.t >= r.t) ON l.key = r.key";
    for (query, expected) in [
        (format!("SELECT l.n, r.n FROM l ASOF JOIN r {on} ORDER BY l.n"), "1,10 2,30 3,"),
        (format!("SELECT count(*) FROM l ASOF JOIN r {on}"), "3"),
        (format!("SELECT sum(r.n) FROM l ASOF JOIN r {on} WHERE l.key = 'a'"), "40"),
        (format!("SELECT l.n, o.n FROM l ASOF JOIN r {on} JOIN l AS o ON o.n = l.n + 1 ORDER BY 1"), "1,2 2,3"),
        (format!("SELECT l.n, r.n FROM l AS o JOIN l ON o.n = l.n ASOF JOIN r {on} ORDER BY 1"), "1,10 2,30 3,"),
        (format!("WITH m AS (SELECT l.n AS a, r.n AS b FROM l ASOF JOIN r {on}) SELECT a FROM m WHERE b > 10"), "2"),
        (format!("SELECT n FROM (SELECT r.n FROM l ASOF JOIN r {on} UNION ALL SELECT 1) AS u WHERE n < 20 ORDER BY n"), "1 10"),
        ("SELECT l.n, r.n FROM l ASOF JOIN r MATCH_CONDITION (r.t <= l.t) ON l.key = r.key ORDER BY l.n".to_owned(), "1,10 2,30 3,"),
    ] {
        assert_eq!(asked(&context, &query).await.join(" "), expected, "{query}");
    }
}

#[tokio::test]
async fn faults_of_as_of_joins_say_what_was_expected() {
    let context = small();
    for (query, expected) in [
        (
            "SELECT 1 FROM l ASOF JOIN r MATCH_CONDITION (l.t = r.t)",
            "expected a MATCH_CONDITION that compares times of both tables (left >= right), found l.t = r.t",
        ),
        (
            "SELECT 1 FROM l ASOF JOIN r MATCH_CONDITION (l.t >= r.t) ON l.n > r.n",
            "expected ON with columns of both tables that are equal, found l.n > r.n",
        ),
        (
            "SELECT 1 FROM l ASOF JOIN r MATCH_CONDITION (l.t >= r.t) USING (key)",
            "expected ON left = right, found USING (key); write ON l.key = r.key",
        ),
        (
            "SELECT 1 FROM l ASOF LEFT JOIN r ON l.key = r.key AND l.t >= r.t",
            "write a join by time as a ASOF JOIN b MATCH_CONDITION (a.time >= b.time) ON a.key = b.key",
        ),
        (
            "SELECT 1 FROM l ASOF JOIN r ON l.key = r.key AND l.t >= r.t",
            "Expected: MATCH_CONDITION, found: ON (at line 1, column 29 of the query); write a join by time",
        ),
    ] {
        let fault = read_only(&context, query).await.err().unwrap().to_string();
        assert!(fault.contains(expected), "{query}: {fault}");
    }
}
