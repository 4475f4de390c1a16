#![allow(clippy::unwrap_used)]

use arrow::array::{AsArray, RecordBatch};
use bytes::Bytes;
use datafusion::prelude::{DataFrame, SessionContext};
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::parser::Parser;
use evermap_engine::sql::{Limits, context, planned};

use super::*;

#[test]
fn types_that_a_client_says_are_written_into_the_query() {
    let types = [
        Some(Type::INT2),
        None,
        Some(Type::TEXT),
        Some(Type::UNKNOWN),
    ];
    for (query, expected) in [
        (
            "SELECT $1, $2, $4, $5",
            "SELECT CAST($1 AS SMALLINT), $2, $4, $5",
        ),
        (
            "SELECT '$1 ü', E'it\\'s $1', $$ $1 $$, \"$1\" -- $1\n, é = $1/* $1 */+$1",
            "SELECT '$1 ü', E'it\\'s $1', $$ $1 $$, \"$1\" -- $1\n, é = CAST($1 AS SMALLINT)/* $1 */+CAST($1 AS SMALLINT)",
        ),
        (
            "SELECT $1::BIGINT, $3 ::regclass, cast( $3 as INT), $3 AS x",
            "SELECT CAST($1 AS SMALLINT)::BIGINT, $3 ::regclass, cast( $3 as INT), CAST($3 AS TEXT) AS x",
        ),
        ("SELECT 'open $1", "SELECT 'open $1"),
    ] {
        assert_eq!(as_declared(query, &types), expected);
    }
    assert!(matches!(as_declared("SELECT $2", &types), Cow::Borrowed(_)));
}

/// A query with its plan, as one is prepared.
async fn prepared(context: &SessionContext, query: &str) -> Prepared {
    let statement = Parser::parse_sql(&PostgreSqlDialect {}, query)
        .unwrap()
        .remove(0);
    let frame = planned(context, query).await.unwrap();
    let plan = with_types(frame.logical_plan().clone()).unwrap();
    (query.to_owned(), Some((statement, plan)))
}

/// The rows of a query with texts bound to its parameters.
async fn rows(
    query: &str,
    types: &[Option<Type>],
    given: &[Option<&'static str>],
) -> PgWireResult<RecordBatch> {
    let context = context(Limits::one_partition()).unwrap();
    let prepared = prepared(&context, &as_declared(query, types)).await;
    let statement = StoredStatement::new(String::new(), prepared, types.to_vec());
    let mut portal = Portal::new_cursor(String::new(), Arc::new(statement));
    let given = given
        .iter()
        .map(|text| text.map(|text| Bytes::from_static(text.as_bytes())));
    portal.parameters = given.collect();
    let filled = bound(portal)?;
    assert!(filled.parameters.is_empty() && filled.statement.parameter_types.is_empty());
    let (_, planned) = &filled.statement.statement;
    let (_, plan) = planned.as_ref().unwrap();
    let frame = DataFrame::new(context.state(), plan.clone());
    Ok(frame.collect().await.unwrap().remove(0))
}

#[tokio::test]
async fn parameters_have_the_type_of_what_stands_beside_them_or_are_texts() {
    let context = context(Limits::one_partition()).unwrap();
    let query = "SELECT $1 IS NULL, $7 || 'x', a = ANY($3) FROM (SELECT arrow_cast(1, 'UInt32') AS a) AS t \
                 WHERE a < $4 AND ($4 IS NULL OR CAST($6 AS BIGINT) = 1) LIMIT $5";
    let prepared = prepared(&context, query).await;
    let (_, planned) = &prepared;
    let (_, plan) = planned.as_ref().unwrap();
    let item = Arc::new(Field::new_list_field(DataType::UInt32, true));
    let expected = [
        (1, DataType::Utf8),
        (3, DataType::List(item)),
        (4, DataType::UInt32),
        (5, DataType::Int64),
        (6, DataType::Int64),
        (7, DataType::Utf8),
    ];
    assert_eq!(types(plan).unwrap(), BTreeMap::from(expected));
    let (text, large) = (Type::TEXT, Type::INT8);
    let numbers = Type::INT8_ARRAY;
    let expected = [
        text.clone(),
        Type::UNKNOWN,
        numbers,
        large.clone(),
        large.clone(),
        large,
        text,
    ];
    assert_eq!(told(&prepared).unwrap(), expected);
}

#[tokio::test]
async fn a_null_of_no_type_keeps_its_place() {
    let found = rows(
        "SELECT $1 IS NULL AS a, $2 AS b, $4 AS c",
        &[],
        &[None, Some("{x}"), None, Some("y")],
    );
    let found = found.await.unwrap();
    assert!(found.column(0).as_boolean().value(0));
    assert_eq!(found.column(1).as_string::<i32>().value(0), "{x}");
    assert_eq!(found.column(2).as_string::<i32>().value(0), "y");
    let refused = rows("SELECT $2", &[], &[Some("x")])
        .await
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("expected 2 parameters, found 1"),
        "{refused}"
    );
}

#[tokio::test]
async fn exact_numbers_are_compared_as_they_are() {
    let query = "SELECT CAST(9007199254740992 AS BIGINT) = $1 AS a, $1 + 0.5 AS b, 3 = ANY($2) AS c, \
                 3 BETWEEN $3 AND 4 AS d, 3 IN ($1, $3) AS e";
    let types = [
        Some(Type::NUMERIC),
        Some(Type::NUMERIC_ARRAY),
        Some(Type::NUMERIC),
    ];
    let given = [Some("9007199254740993"), Some("{3.5,2}"), Some("3.5")];
    let found = rows(query, &types, &given).await.unwrap();
    for column in [0, 2, 3, 4] {
        assert!(
            !found.column(column).as_boolean().value(0),
            "column {column}"
        );
    }
    let given = [Some("9007199254740992"), Some("{3.0,2}"), Some("3.0")];
    let found = rows(query, &types, &given).await.unwrap();
    for column in [0, 2, 3, 4] {
        assert!(
            found.column(column).as_boolean().value(0),
            "column {column}"
        );
    }
}
