#![allow(clippy::unwrap_used)]
use arrow::array::{Array, AsArray};
use arrow::datatypes::Int64Type;

use crate::sql::{Limits, context, read_only};

/// `t` has rows whose `x` is 1, 2, 3 and null; `s` has 1 and null; `u` has 1 and 3; `none` has nothing.
const TABLES: &str = "WITH t (id, x) AS (VALUES (1, 1), (2, 2), (3, 3), (4, NULL)), \
    s (k, y) AS (VALUES (1, 1), (2, NULL)), u (k, z) AS (VALUES (1, 1), (3, 3)), \
    none AS (SELECT z FROM u WHERE z > 7)";

/// The numbers that a query gives, ascending.
async fn numbers(query: &str, limits: Limits) -> Vec<i64> {
    let context = context(limits).unwrap();
    let frame = read_only(&context, &format!("{TABLES} {query}")).await;
    assert!(frame.is_ok(), "{query}: {:?}", frame.err());
    let rows = frame.unwrap().collect().await;
    assert!(rows.is_ok(), "{query}: {:?}", rows.err());
    let mut found = Vec::new();
    for batch in rows.unwrap() {
        let numbers = batch.column(0).as_primitive::<Int64Type>();
        assert_eq!(numbers.null_count(), 0, "{query}");
        found.extend(numbers.values().iter());
    }
    found.sort_unstable();
    found
}

#[tokio::test]
async fn members_of_subqueries_have_three_values_wherever_they_are_asked() {
    let conditions: &[(&str, &[i64])] = &[
        ("x IN (SELECT y FROM s)", &[1]),
        ("x NOT IN (SELECT y FROM s)", &[]),
        ("x NOT IN (SELECT z FROM u)", &[2]),
        ("x NOT IN (SELECT z FROM none)", &[1, 2, 3, 4]),
        ("x NOT IN (SELECT y FROM s) OR id = 3", &[3]),
        ("x NOT IN (SELECT z FROM u) OR id = 3", &[2, 3]),
        ("(x NOT IN (SELECT z FROM none)) IS TRUE", &[1, 2, 3, 4]),
        ("(x IN (SELECT y FROM s)) IS NULL", &[2, 3, 4]),
        ("(x IN (SELECT z FROM u)) IS NULL", &[4]),
        ("(x IN (SELECT z FROM none)) IS NULL", &[]),
        ("coalesce(x NOT IN (SELECT y FROM s), true)", &[2, 3, 4]),
        (
            "CASE WHEN x IN (SELECT y FROM s) THEN false ELSE true END",
            &[2, 3, 4],
        ),
        ("NOT (x IN (SELECT y FROM s) OR id = 3)", &[]),
        ("NOT (NOT (x NOT IN (SELECT z FROM u)))", &[2]),
        // The same table on both sides, and its name.
        ("(x IN (SELECT x FROM t WHERE id < 3)) IS FALSE", &[3]),
        ("x = ANY (SELECT x FROM t WHERE id > 2) OR id = 1", &[1, 3]),
        (
            "(x <> ALL (SELECT x FROM t WHERE id = 2)) OR id = 4",
            &[1, 3, 4],
        ),
        (
            "(x > ALL (SELECT x FROM t WHERE id < 3)) OR id = 1",
            &[1, 3],
        ),
        // No column, or what may be null where its columns are not.
        ("1 NOT IN (SELECT y FROM s)", &[]),
        ("7 NOT IN (SELECT y FROM s)", &[]),
        ("7 NOT IN (SELECT z FROM u)", &[1, 2, 3, 4]),
        ("NULL::BIGINT NOT IN (SELECT z FROM u)", &[]),
        ("nullif(id, 2) NOT IN (SELECT z FROM u)", &[4]),
        // Rows that the query around names.
        ("x NOT IN (SELECT y FROM s WHERE s.k = t.id)", &[3, 4]),
        ("(x IN (SELECT y FROM s WHERE s.k = t.id)) IS NULL", &[2]),
        (
            "x NOT IN (SELECT z FROM u WHERE u.k = t.id) OR id = 9",
            &[2, 4],
        ),
        ("0 IN (SELECT count(*) FROM u WHERE u.k = t.id)", &[2, 4]),
        ("x NOT IN (SELECT max(z) FROM u WHERE u.k = t.id)", &[]),
        (
            "EXISTS (SELECT max(z) FROM u WHERE u.k = t.id)",
            &[1, 2, 3, 4],
        ),
        (
            "EXISTS (SELECT 1 FROM u WHERE u.k = t.id) OR id = 4",
            &[1, 3, 4],
        ),
    ];
    let one = Limits::one_partition();
    for (condition, expected) in conditions {
        let filtered = format!("SELECT id FROM t WHERE {condition}");
        assert_eq!(numbers(&filtered, one).await, *expected, "{filtered}");
        let several = Limits {
            partitions: 3,
            ..one
        };
        assert_eq!(numbers(&filtered, several).await, *expected, "{filtered}");
        let selected =
            format!("SELECT id FROM (SELECT id, {condition} AS is_so FROM t) AS v WHERE is_so");
        if !condition.contains("> ALL") {
            assert_eq!(numbers(&selected, one).await, *expected, "{selected}");
        }
    }
    let grouped =
        "SELECT max(id) FROM t GROUP BY x HAVING max(x) NOT IN (SELECT z FROM u) OR max(id) = 3";
    assert_eq!(numbers(grouped, one).await, [2, 3]);
    let counted =
        "SELECT count(*) FROM t GROUP BY x HAVING x NOT IN (SELECT z FROM u) OR max(id) = 3";
    assert_eq!(numbers(counted, one).await, [1, 1]);
}

#[tokio::test]
async fn a_member_that_is_selected_has_its_name_and_may_be_null() {
    let context = context(Limits::one_partition()).unwrap();
    let query =
        format!("{TABLES} SELECT id IN (SELECT y FROM s) AS found, id IN (SELECT z FROM u) FROM t");
    let frame = read_only(&context, &query).await.unwrap();
    let fields = frame.schema().fields().clone();
    assert!(fields[0].name() == "found" && fields[0].is_nullable());
    assert!(fields[1].name().contains("IN"), "{}", fields[1].name());
    let rows = frame.collect().await.unwrap();
    let nulls = rows.iter().map(|batch| batch.column(0).null_count());
    assert_eq!(nulls.sum::<usize>(), 3);
}

#[tokio::test]
async fn what_cannot_be_counted_is_refused() {
    let context = context(Limits::one_partition()).unwrap();
    for (query, said) in [
        (
            "SELECT id FROM t WHERE x IN (SELECT max(z) FROM u WHERE u.k = t.id GROUP BY k) OR id = 1",
            "not supported: IN (SELECT …) that names columns of the query around it, and groups",
        ),
        (
            "SELECT t.id FROM t LEFT JOIN u ON t.id = u.k AND (x IN (SELECT y FROM s) OR id = 1)",
            "expected IN (SELECT …) in WHERE, found it in the condition of a join",
        ),
        (
            "SELECT count(*) FILTER (WHERE x NOT IN (SELECT y FROM s)) FROM t",
            "in WHERE, HAVING or SELECT, found one in an aggregate",
        ),
        (
            "SELECT x > ALL (SELECT y FROM s) FROM t",
            "not supported: a comparison with ANY or ALL (SELECT …) in SELECT",
        ),
    ] {
        let fault = read_only(&context, &format!("{TABLES} {query}")).await;
        let fault = fault.err().unwrap().to_string();
        assert!(fault.contains(said), "{query}: {fault}");
    }
    let nested = (0..9).fold("SELECT x FROM t".to_owned(), |within, _| {
        format!("SELECT x FROM t WHERE x IN ({within}) OR id = 1")
    });
    let fault = read_only(&context, &format!("{TABLES} {nested}")).await;
    let fault = fault.err().unwrap().to_string();
    assert!(
        fault.contains("a subquery of at most 10000 steps"),
        "{fault}"
    );
}
