#![allow(clippy::unwrap_used)]
use arrow::util::display::array_value_to_string;
use datafusion::prelude::SessionContext;
use evermap_schemas::Fault;

use crate::error::OrFault;
use crate::sql::{Limits, STACK_BYTES, context};

/// Tables: one row of the largest integer and one of a small one; the same in unsigned; stamps in ns; two durations of 230
/// years, and intervals.
const TABLES: &str = "WITH t AS (SELECT * FROM (VALUES (9223372036854775807, 1), (1, 2)) t (x, g)), \
    u AS (SELECT CAST(x AS BIGINT UNSIGNED) AS x FROM (VALUES (1), (2)) u (x)), \
    s AS (SELECT 1700000000000000000 + n AS stamp, n FROM (SELECT unnest(range(0, 8)) AS n)), \
    d AS (SELECT TIMESTAMP '2200-01-01' - TIMESTAMP '1970-01-01' AS d, INTERVAL '2000000000 months' AS i, g FROM t) ";

fn at(partitions: usize) -> SessionContext {
    let limits = Limits {
        partitions,
        ..Limits::default()
    };
    context(limits).unwrap()
}

/// The rows of a query, each with `|` between its values.
async fn rows(context: &SessionContext, query: &str) -> Result<Vec<String>, Fault> {
    let frame = context.sql(&format!("{TABLES}{query}")).await.or_fault()?;
    let batches = frame.collect().await.or_fault()?;
    let mut rows = Vec::new();
    for batch in &batches {
        for row in 0..batch.num_rows() {
            let values = batch.columns().iter();
            let values = values.map(|column| array_value_to_string(column, row).unwrap());
            rows.push(values.collect::<Vec<_>>().join("|"));
        }
    }
    Ok(rows)
}

#[tokio::test]
async fn integers_that_do_not_fit_are_an_error_wherever_a_query_has_them() {
    for partitions in [1, 3] {
        let context = at(partitions);
        for query in [
            "SELECT x + 1 FROM t",
            "SELECT x * 2 FROM t",
            "SELECT -x - 2 FROM t",
            "SELECT 0 - x - 2 FROM t",
            "SELECT -(-x - 1) FROM t",
            "SELECT x - CAST(3 AS BIGINT UNSIGNED) FROM u",
            "SELECT CAST(g AS TINYINT) * CAST(100 AS TINYINT) FROM t",
            "SELECT g FROM t WHERE x + 1 > 0",
            "SELECT g FROM t ORDER BY x + 1",
            "SELECT x + 1, count(*) FROM t GROUP BY x + 1",
            "SELECT max(x * 2) FROM t",
            "SELECT count(*) FILTER (WHERE x + g > 0) FROM t",
            "SELECT max(x + 1) OVER (ORDER BY g) FROM t",
            "SELECT * FROM t a JOIN t b ON a.x + 1 = b.x",
            "SELECT * FROM t a JOIN t b ON a.x + b.x > 0",
            "SELECT (SELECT max(x + 1) FROM t)",
            "SELECT CASE WHEN g = 1 THEN x + 1 ELSE 0 END FROM t",
            // Constants, which are folded while the query is planned.
            "SELECT 9223372036854775807 + 1",
            "SELECT 4611686018427387904 * 2",
            "SELECT -9223372036854775807 - 2",
            "SELECT abs(-9223372036854775807) + 1",
            "SELECT x + 1 FROM (SELECT 9223372036854775807 AS x)",
            "SELECT * FROM (VALUES (9223372036854775807 + 1))",
            "SELECT g FROM t WHERE x > 9223372036854775807 + 1",
            "SELECT sum(x) FROM t",
            "SELECT sum(CAST(stamp AS BIGINT)) / count(*) FROM s",
            "SELECT sum(stamp) FROM s GROUP BY n % 1",
            "SELECT sum(DISTINCT x) FROM t",
            "SELECT sum(DISTINCT x), count(DISTINCT g) FROM t",
            "SELECT sum(x) FILTER (WHERE g < 3) FROM t",
            "SELECT sum(x) OVER () FROM t",
            "SELECT sum(x) OVER (ORDER BY g) FROM t",
            "SELECT sum(stamp) OVER (ORDER BY n ROWS BETWEEN 5 PRECEDING AND CURRENT ROW) FROM s",
            "SELECT sum(x + 1) FROM t",
            "SELECT sum(v) FROM (VALUES (-9223372036854775807), (-2)) t (v)",
            "SELECT sum(x * CAST(9223372036854775807 AS BIGINT UNSIGNED)) FROM u",
            // Durations and intervals.
            "SELECT sum(d) FROM d",
            "SELECT sum(d) FROM d GROUP BY g % 1",
            "SELECT sum(d) OVER () FROM d",
            "SELECT sum(d) OVER (ORDER BY g) FROM d",
            "SELECT d + d FROM d",
            "SELECT TIMESTAMP '2200-01-01' + d FROM d",
            "SELECT TIMESTAMP '1700-01-01' - d FROM d",
            "SELECT sum(i) FROM d",
            "SELECT sum(i) FROM d GROUP BY g % 1",
            "SELECT sum(i) OVER (ORDER BY g) FROM d",
            "SELECT i + i FROM d",
        ] {
            let fault = rows(&context, query).await.unwrap_err().to_string();
            assert!(fault.contains("verflow"), "{query}: {fault}");
        }
    }
}

#[tokio::test]
async fn what_does_not_fit_is_told_with_what_to_write_instead() {
    let context = at(1);
    for (query, said) in [
        (
            "SELECT a.k - b.k FROM (SELECT CAST(41 AS INT UNSIGNED) AS k FROM t) a, (SELECT CAST(179 AS INT UNSIGNED) AS k FROM t) b",
            "user: Arithmetic overflow: expected a difference that fits u32, found 41 - 179; u32 has nothing below zero: write CAST(… AS BIGINT) - …",
        ),
        (
            "SELECT x + 1 FROM t WHERE g = 1",
            "user: Arithmetic overflow: expected a sum that fits i64, found 9223372036854775807 + 1; compute with CAST(… AS DECIMAL(38, 0)) or DOUBLE",
        ),
        (
            "SELECT CAST(g AS TINYINT) * CAST(100 AS TINYINT) FROM t WHERE g = 2",
            "user: Arithmetic overflow: expected a product that fits i8, found 2 * 100; compute with CAST(… AS BIGINT)",
        ),
        (
            "SELECT sum(x) FROM t",
            "user: Arithmetic overflow: expected a sum that fits i64, found 9223372036854775808; add up CAST(… AS DECIMAL(38, 0)) or DOUBLE instead",
        ),
    ] {
        let fault = rows(&context, query).await.unwrap_err();
        assert_eq!(fault.to_string(), said, "{query}");
    }
}

#[tokio::test]
async fn what_fits_is_as_it_was() {
    let expected: &[(&str, &[&str])] = &[
        (
            "SELECT x - 1, x + 0, -x, g * 3 - 1 + 2, 7 / g % 2 FROM t ORDER BY g",
            &[
                "9223372036854775806|9223372036854775807|-9223372036854775807|4|1",
                "0|1|-1|7|1",
            ],
        ),
        (
            "SELECT 1 + 2 * 3 - 4 AS a, (1 + 2) * (3 - 4) AS b, 1 - (2 - 3) AS c, -9223372036854775808 AS d",
            &["3|-3|2|-9223372036854775808"],
        ),
        (
            "SELECT 1 + NULL, g + NULL, -CAST(NULL AS BIGINT) FROM t WHERE g = 1",
            &["||"],
        ),
        (
            "SELECT 1 + 1.5, 2 * 0.25, DATE '2026-01-02' - DATE '2026-01-01', 1 + CAST(1 AS SMALLINT)",
            &["2.5|0.5|1|2"],
        ),
        (
            "SELECT TIMESTAMP '2026-01-01' + INTERVAL '1 day'",
            &["2026-01-02T00:00:00"],
        ),
        (
            "SELECT CASE WHEN g > 5 THEN 9223372036854775807 + g ELSE g END FROM t ORDER BY g",
            &["1", "2"],
        ),
        (
            "SELECT n FROM s WHERE n + 1 > 6 ORDER BY n + 1 DESC LIMIT 1 + 1",
            &["7", "6"],
        ),
        // A sum may pass beyond, as long as it comes back.
        (
            "SELECT sum(v), sum(DISTINCT v), count(*) FROM (VALUES (9223372036854775807), (1), (-1), (-1)) t (v)",
            &["9223372036854775806|9223372036854775807|4"],
        ),
        (
            "SELECT g, sum(v) FROM (VALUES (1, 9223372036854775807), (1, 1), (1, -1), (2, NULL)) t (g, v) GROUP BY g ORDER BY g",
            &["1|9223372036854775807", "2|"],
        ),
        (
            "SELECT sum(n), sum(n) FILTER (WHERE n > 5), sum(DISTINCT n / 2), sum(n + 1), avg(n) FROM s",
            &["28|13|6|36|3.5"],
        ),
        (
            "SELECT avg(CAST(stamp AS BIGINT)) > 1.69e18 FROM s",
            &["true"],
        ),
        (
            "SELECT sum(n) OVER (ORDER BY n ROWS BETWEEN 1 PRECEDING AND CURRENT ROW) AS w FROM s ORDER BY n",
            &["0", "1", "3", "5", "7", "9", "11", "13"],
        ),
        (
            "SELECT sum(stamp) OVER (ORDER BY n ROWS BETWEEN 1 PRECEDING AND CURRENT ROW) AS w FROM s WHERE n < 3 ORDER BY n",
            &[
                "1700000000000000000",
                "3400000000000000001",
                "3400000000000000003",
            ],
        ),
        (
            "SELECT sum(DISTINCT n % 2) OVER (ORDER BY n ROWS BETWEEN 1 PRECEDING AND CURRENT ROW) AS w FROM s WHERE n < 3 ORDER BY n",
            &["0", "1", "1"],
        ),
        ("SELECT sum(x), arrow_typeof(sum(x)) FROM u", &["3|UInt64"]),
        (
            "SELECT sum(CAST(9223372036854775807 AS BIGINT UNSIGNED)) FROM u",
            &["18446744073709551614"],
        ),
        (
            "SELECT arrow_typeof(sum(CAST(x AS SMALLINT))), sum(1.5), sum(CAST(1 AS DECIMAL(5, 1))) FROM u",
            &["Int64|3.0|2.0"],
        ),
        ("SELECT sum(x) FROM t WHERE g > 5", &[""]),
        ("SELECT sum(d), avg(d), sum(i) FROM d WHERE g > 5", &["||"]),
        (
            "SELECT sum(d) = TIMESTAMP '2200-01-01' - TIMESTAMP '1970-01-01', sum(i) = INTERVAL '2000000000 months' FROM d GROUP BY g",
            &["true|true", "true|true"],
        ),
        (
            "SELECT sum(d - d) = d - d, sum(i - i) = i - i FROM d GROUP BY d, i",
            &["true|true"],
        ),
        // A sum of both would not fit, and their mean does.
        (
            "SELECT avg(d) = TIMESTAMP '2200-01-01' - TIMESTAMP '1970-01-01' FROM d",
            &["true"],
        ),
        (
            "SELECT avg(d) = TIMESTAMP '2200-01-01' - TIMESTAMP '1970-01-01' FROM d GROUP BY g % 1",
            &["true"],
        ),
        (
            "SELECT sum(d) OVER (ORDER BY g ROWS BETWEEN CURRENT ROW AND CURRENT ROW) = d, avg(d) OVER () = d FROM d",
            &["true|true", "true|true"],
        ),
        (
            "SELECT sum(i) OVER (ORDER BY g ROWS BETWEEN CURRENT ROW AND CURRENT ROW) = i FROM d",
            &["true", "true"],
        ),
        (
            "SELECT sum(DISTINCT d) = TIMESTAMP '2200-01-01' - TIMESTAMP '1970-01-01', count(DISTINCT g) FROM d",
            &["true|2"],
        ),
        (
            "SELECT arrow_typeof(sum(d)), arrow_typeof(avg(d)) FROM d GROUP BY g HAVING g = 1",
            &["Duration(ns)|Duration(ns)"],
        ),
    ];
    for partitions in [1, 3] {
        let context = at(partitions);
        for (query, expected) in expected {
            let found = rows(&context, query).await;
            let found = found.map_err(|fault| format!("{query}: {fault}")).unwrap();
            assert_eq!(found, *expected, "{query}");
        }
    }
}

#[tokio::test]
async fn columns_are_called_as_they_were() {
    let ours = at(1);
    let plain = SessionContext::new();
    for query in [
        "SELECT x + 1, -x, x * g - 1, sum(x) OVER (ORDER BY g + 1) FROM t",
        "SELECT sum(x - 1), sum(DISTINCT g), sum(x) FILTER (WHERE g > 1) FROM t GROUP BY g + 1",
        "SELECT -(-(x - 1) * 2 - -g) + 1 - abs(x * 2) * 3, CAST(-g AS INT) - 1 FROM t",
        "SELECT g + 1, count(*) FROM t GROUP BY g + 1 HAVING sum(g) + 1 > 0",
    ] {
        let query = format!("{TABLES}{query}");
        let mut fields = Vec::new();
        for context in [&ours, &plain] {
            let frame = context.sql(&query).await.unwrap();
            let plan = frame.create_physical_plan().await.unwrap();
            fields.push(plan.schema().fields().clone());
        }
        assert_eq!(fields[0], fields[1], "{query}");
    }
}

#[test]
fn a_sum_of_many_terms_is_planned_and_right() {
    let planned = || {
        let runtime = tokio::runtime::Runtime::new().unwrap();
        runtime.block_on(async {
            let context = at(1);
            let terms = vec!["g"; 500].join(" + ");
            let query = format!("SELECT {terms} FROM t ORDER BY g");
            let found = rows(&context, &query).await.unwrap();
            assert_eq!(found, ["500", "1000"]);
            let query = format!("SELECT {terms} + x FROM t");
            let fault = rows(&context, &query).await.unwrap_err().to_string();
            assert!(fault.contains("verflow"), "{fault}");
        });
    };
    let thread = std::thread::Builder::new().stack_size(STACK_BYTES);
    thread.spawn(planned).unwrap().join().unwrap();
}
