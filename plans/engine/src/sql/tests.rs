#![allow(clippy::unwrap_used)]
use super::*;

#[tokio::test]
async fn a_query_is_described_with_the_types_of_its_rows() {
    let context = context(Limits::one_partition()).unwrap();
    let query =
        "SELECT x / 1024 AS kib, x + 1 AS next FROM (SELECT CAST(5 AS BIGINT UNSIGNED) AS x)";
    let rows = read_only(&context, query).await.unwrap();
    let rows = rows.collect().await.unwrap();
    let described = read_only(&context, &format!("DESCRIBE {query}")).await;
    let described = described.unwrap().collect().await.unwrap();
    for (at, column) in rows[0].schema().fields().iter().enumerate() {
        let value = |index: usize| {
            let column = described[0].column(index);
            arrow::util::display::array_value_to_string(column, at).unwrap()
        };
        assert_eq!(value(0), *column.name());
        assert_eq!(value(1), column.data_type().to_string());
    }
}

#[test]
fn tables_are_named_as_a_plan_names_them() {
    let query =
        r#"WITH a AS (SELECT * FROM poses) SELECT * FROM a, "/odom", previous.lanes, poses"#;
    assert_eq!(tables(query).unwrap(), ["/odom", "poses", "previous.lanes"]);
    assert!(tables("SELEC").is_err());
}
