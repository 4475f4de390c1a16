#![allow(clippy::unwrap_used)]
use arrow::util::display::array_value_to_string;

use crate::sql::{Limits, context, read_only};

/// NaN with a sign and without, both zeros, and numbers; intervals of which some are equal.
const TABLES: &str = "WITH t AS (SELECT * FROM (VALUES (1, CAST('NaN' AS DOUBLE)), (2, -CAST('NaN' AS DOUBLE)), (3, 0.0), \
    (4, -CAST(0.0 AS DOUBLE)), (5, 1.0), (6, NULL)) t (i, x)), \
    s AS (SELECT * FROM (VALUES (1, INTERVAL '1 day'), (2, INTERVAL '24 hours'), (3, INTERVAL '1 month'), \
    (4, INTERVAL '30 days'), (5, INTERVAL '1 hour'), (6, NULL)) s (i, s)) ";

async fn all_answer(expected: &[(&str, &str)]) {
    for partitions in [1, 3] {
        let limits = Limits {
            partitions,
            ..Limits::default()
        };
        let context = context(limits).unwrap();
        for (query, expected) in expected {
            let frame = read_only(&context, &format!("{TABLES}{query}")).await;
            assert!(frame.is_ok(), "{query}: {:?}", frame.err());
            let mut rows = Vec::new();
            for batch in frame.unwrap().collect().await.unwrap() {
                for row in 0..batch.num_rows() {
                    let values = batch.columns().iter();
                    let values = values.map(|column| array_value_to_string(column, row).unwrap());
                    rows.push(values.collect::<Vec<_>>().join("|"));
                }
            }
            assert_eq!(rows.join(", "), *expected, "{query}");
        }
    }
}

#[tokio::test]
async fn nan_is_one_value_whatever_its_sign() {
    all_answer(&[
        (
            "SELECT 0.0 / 0.0 = CAST('NaN' AS DOUBLE), -CAST('NaN' AS DOUBLE) <> CAST('NaN' AS DOUBLE)",
            "true|false",
        ),
        (
            "SELECT a.i, b.i FROM t a, t b WHERE a.i < b.i AND a.x = b.x ORDER BY 1, 2",
            "1|2, 3|4",
        ),
        (
            "SELECT a.i, b.i FROM t a, t b WHERE a.i = 2 AND a.x >= b.x ORDER BY 1, 2",
            "2|1, 2|2, 2|3, 2|4, 2|5",
        ),
        (
            "SELECT a.i, b.i FROM t a JOIN t b USING (x) WHERE a.i < b.i ORDER BY 1, 2",
            "1|2, 3|4",
        ),
        (
            "SELECT a.i FROM t a LEFT JOIN t b ON a.x IS NOT DISTINCT FROM b.x AND a.i < b.i WHERE b.i IS NULL ORDER BY 1",
            "2, 4, 5, 6",
        ),
        (
            "SELECT x, count(*), min(i) FROM t GROUP BY x ORDER BY 3",
            "NaN|2|1, 0.0|2|3, 1.0|1|5, |1|6",
        ),
        (
            "SELECT x + 1, count(*) FROM t GROUP BY x + 1 HAVING count(*) > 1 ORDER BY x + 1 DESC",
            "NaN|2, 1.0|2",
        ),
        (
            "SELECT x, grouping(x), count(*) FROM t GROUP BY ROLLUP (x) ORDER BY 3, 1 NULLS LAST",
            "1.0|0|1, |0|1, 0.0|0|2, NaN|0|2, |1|6",
        ),
        ("SELECT count(*) FROM (SELECT DISTINCT x FROM t) d", "4"),
        (
            "SELECT count(*) FROM (SELECT x FROM t WHERE i = 1 INTERSECT SELECT x FROM t WHERE i = 2) d",
            "1",
        ),
        (
            "SELECT i FROM t WHERE x IN (SELECT x FROM t WHERE i = 1) ORDER BY i",
            "1, 2",
        ),
        (
            "SELECT i FROM t WHERE x NOT IN (SELECT x FROM t WHERE i = 1) ORDER BY i",
            "3, 4, 5",
        ),
        (
            "SELECT greatest(x, 2.0), least(x, -1.0), greatest(x, NULL) FROM t WHERE i IN (2, 5, 6) ORDER BY i",
            "NaN|-1.0|NaN, 2.0|-1.0|1.0, 2.0|-1.0|",
        ),
        // A subquery that names a column of the query around it.
        (
            "SELECT (SELECT count(*) FROM t b WHERE b.x = a.x) FROM t a WHERE a.i = 5",
            "1",
        ),
    ])
    .await;
}

#[tokio::test]
async fn intervals_of_one_length_are_one_value() {
    all_answer(&[
        (
            "SELECT count(DISTINCT s), count(DISTINCT s) FILTER (WHERE i < 3) FROM s",
            "3|1",
        ),
        // Each group shows an interval that it has.
        (
            "SELECT s, count(*) FROM s GROUP BY s ORDER BY s",
            "1 hours|1, 24 hours|2, 30 days|2, |1",
        ),
        (
            "SELECT s + INTERVAL '1 hour', count(*) FROM s WHERE i < 3 GROUP BY s + INTERVAL '1 hour'",
            "25 hours|2",
        ),
        (
            "SELECT s, count(*) FROM s WHERE i > 2 AND i < 5 GROUP BY ROLLUP (s) ORDER BY s NULLS LAST",
            "30 days|2, |2",
        ),
        ("SELECT DISTINCT s FROM s WHERE i IN (3, 5) ORDER BY s", "1 hours, 1 mons"),
        (
            "SELECT i, count(*) OVER (PARTITION BY s), rank() OVER (ORDER BY s), row_number() OVER (ORDER BY s, i) FROM s ORDER BY i",
            "1|2|2|2, 2|2|2|3, 3|2|4|4, 4|2|4|5, 5|1|1|1, 6|1|6|6",
        ),
        (
            "SELECT i, count(*) OVER (ORDER BY s RANGE BETWEEN INTERVAL '23 hours' PRECEDING AND CURRENT ROW) FROM s WHERE i <> 6 ORDER BY i",
            "1|3, 2|3, 3|2, 4|2, 5|1",
        ),
        (
            "SELECT i, sum(i) OVER (ORDER BY stamp - TIMESTAMP '2026-01-01' RANGE BETWEEN INTERVAL '1 second' PRECEDING AND CURRENT ROW) \
             FROM (VALUES (1, TIMESTAMP '2026-01-01'), (2, TIMESTAMP '2026-01-01 00:00:01'), (3, TIMESTAMP '2026-01-02')) v (i, stamp) ORDER BY i",
            "1|1, 2|3, 3|3",
        ),
        (
            "SELECT greatest(s, INTERVAL '29 days'), least(s, INTERVAL '40 days') FROM s WHERE i > 2 ORDER BY i",
            "1 mons|1 mons, 30 days|30 days, 29 days|1 hours, 29 days|40 days",
        ),
        (
            "SELECT nullif(s, INTERVAL '24 hours') FROM s WHERE i < 4 ORDER BY i",
            ", , 1 mons",
        ),
        (
            "SELECT a.i, b.i FROM s a JOIN s b USING (s) WHERE a.i < b.i ORDER BY 1, 2",
            "1|2, 3|4",
        ),
        (
            "SELECT i FROM s WHERE s IN (SELECT INTERVAL '1 day') ORDER BY i",
            "1, 2",
        ),
        ("SELECT count(*) FROM (SELECT s FROM s UNION SELECT INTERVAL '1440 minutes') d", "4"),
    ])
    .await;
}

#[tokio::test]
async fn what_is_no_interval_bounds_no_range_of_them() {
    let context = context(Limits::one_partition()).unwrap();
    let query = "SELECT count(*) OVER (ORDER BY s RANGE BETWEEN INTERVAL 'much' PRECEDING AND CURRENT ROW) FROM s";
    let frame = read_only(&context, &format!("{TABLES}{query}"))
        .await
        .unwrap();
    let fault = frame.create_physical_plan().await.err().unwrap();
    let said =
        "expected an interval as a bound of RANGE, found much; write INTERVAL '1 day' PRECEDING";
    assert!(fault.to_string().contains(said), "{fault}");
}
