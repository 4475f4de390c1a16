#![allow(clippy::unwrap_used)]
use arrow::datatypes::IntervalMonthDayNano;
use arrow::util::display::array_value_to_string;

use crate::error::OrFault;
use crate::sql::lengths::length::{length, plain};
use crate::sql::{Limits, context, read_only};

/// Intervals whose order by months, days and nanoseconds is another one.
const TABLE: &str = "WITH t AS (SELECT * FROM (VALUES (INTERVAL '1 month', 'month', 1), (INTERVAL '40 days', 'days', 1), \
    (INTERVAL '29 days 25 hours', 'hours', 1), (NULL, 'none', 2), (INTERVAL '720 hours', 'same', 3)) t (i, name, g)) ";

/// The rows of a query, one after the other.
async fn answer(partitions: usize, query: &str) -> String {
    let limits = Limits {
        partitions,
        ..Limits::default()
    };
    let context = context(limits).unwrap();
    let frame = read_only(&context, &format!("{TABLE}{query}")).await;
    let batches = frame.unwrap().collect().await.or_fault().unwrap();
    let mut rows = Vec::new();
    for batch in &batches {
        for row in 0..batch.num_rows() {
            let values = batch.columns().iter();
            let values = values.map(|column| array_value_to_string(column, row).unwrap());
            rows.push(values.collect::<Vec<_>>().join(" "));
        }
    }
    rows.join(", ")
}

#[tokio::test]
async fn intervals_are_compared_by_their_lengths() {
    for partitions in [1, 3] {
        for (query, expected) in [
            ("SELECT INTERVAL '1 month' > INTERVAL '40 days'", "false"),
            ("SELECT INTERVAL '1 day' = INTERVAL '24 hours'", "true"),
            ("SELECT INTERVAL '1 day' <> INTERVAL '24 hours'", "false"),
            ("SELECT INTERVAL '1 year' <= INTERVAL '360 days'", "true"),
            (
                "SELECT INTERVAL '1 day' IS DISTINCT FROM INTERVAL '24 hours', INTERVAL '1 day' IS DISTINCT FROM NULL",
                "false true",
            ),
            (
                "SELECT INTERVAL '-1 day' < INTERVAL '-23 hours', NULL > INTERVAL '1 day'",
                "true ",
            ),
            (
                "SELECT INTERVAL '178000000 years' > INTERVAL '2000000000 days'",
                "true",
            ),
            // A duration becomes an interval of nanoseconds.
            (
                "SELECT TIMESTAMP '2026-01-02 01:00:00' - TIMESTAMP '2026-01-01' > INTERVAL '1 day'",
                "true",
            ),
            (
                "SELECT name FROM t WHERE i = INTERVAL '30 days' ORDER BY name",
                "month, same",
            ),
            (
                "SELECT name FROM t WHERE i BETWEEN INTERVAL '721 hours' AND INTERVAL '2 months' ORDER BY name",
                "days, hours",
            ),
            (
                "SELECT name FROM t WHERE i IN (INTERVAL '30 days', INTERVAL '960 hours') ORDER BY name",
                "days, month, same",
            ),
            (
                "SELECT CASE i WHEN INTERVAL '30 days' THEN 'thirty' ELSE name END AS x FROM t WHERE g = 1 ORDER BY x",
                "days, hours, thirty",
            ),
            (
                "SELECT a.name, b.name FROM t a JOIN t b ON a.i = b.i AND a.name < b.name",
                "month same",
            ),
        ] {
            assert_eq!(answer(partitions, query).await, expected, "{query}");
        }
    }
}

#[tokio::test]
async fn rows_are_ordered_by_the_lengths_of_intervals() {
    for partitions in [1, 3] {
        for (query, expected) in [
            (
                "SELECT name FROM t WHERE g < 3 ORDER BY i",
                "month, hours, days, none",
            ),
            (
                "SELECT name FROM t ORDER BY i DESC NULLS LAST, name LIMIT 3",
                "days, hours, month",
            ),
            (
                "SELECT array_agg(name ORDER BY i) FROM t WHERE g = 1",
                "[month, hours, days]",
            ),
            (
                "SELECT name, count(*) OVER (ORDER BY i ROWS UNBOUNDED PRECEDING) AS n FROM t WHERE g = 1 ORDER BY n",
                "month 1, hours 2, days 3",
            ),
        ] {
            assert_eq!(answer(partitions, query).await, expected, "{query}");
        }
    }
}

#[tokio::test]
async fn the_shortest_and_the_longest_interval_are_found() {
    for partitions in [1, 3] {
        for (query, expected) in [
            (
                "SELECT min(i) = INTERVAL '30 days', max(i) = INTERVAL '40 days' FROM t",
                "true true",
            ),
            (
                "SELECT g, max(i) = INTERVAL '40 days' AS is_so FROM t GROUP BY g ORDER BY g",
                "1 true, 2 , 3 false",
            ),
            (
                "SELECT max(DISTINCT i) FILTER (WHERE name <> 'days') = INTERVAL '721 hours' FROM t",
                "true",
            ),
            (
                "SELECT name FROM (SELECT name, i, max(i) OVER () AS longest FROM t) WHERE i = longest",
                "days",
            ),
            (
                "SELECT max(i) OVER w = INTERVAL '40 days', min(i) OVER w = INTERVAL '30 days' FROM t WHERE g = 1 \
                 WINDOW w AS (ORDER BY name ROWS BETWEEN 1 PRECEDING AND CURRENT ROW) ORDER BY name",
                "true false, true false, false true",
            ),
            (
                "SELECT x = INTERVAL '960 hours' FROM (SELECT max(i) FROM t) longest (x) WHERE x > INTERVAL '39 days'",
                "true",
            ),
        ] {
            assert_eq!(answer(partitions, query).await, expected, "{query}");
        }
    }
}

#[test]
fn plain_intervals_are_as_long_and_ordered_by_their_parts() {
    let mut intervals = Vec::new();
    for months in [i32::MIN, -13, 0, 1, i32::MAX] {
        for days in [i32::MIN, -31, 0, 30, i32::MAX] {
            for nanoseconds in [i64::MIN, -1, 0, 86_400_000_000_000, i64::MAX] {
                intervals.push(IntervalMonthDayNano::new(months, days, nanoseconds));
            }
        }
    }
    for left in &intervals {
        assert_eq!(length(plain(*left)), length(*left), "{left:?}");
        for right in &intervals {
            let by_parts = plain(*left).cmp(&plain(*right));
            let by_length = length(*left).cmp(&length(*right));
            assert_eq!(by_parts, by_length, "{left:?}, {right:?}");
        }
    }
}
