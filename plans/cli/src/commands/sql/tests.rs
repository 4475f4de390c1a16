#![allow(clippy::unwrap_used)]

use arrow::array::AsArray;
use arrow::datatypes::{DataType, Float64Type};

use super::*;

#[test]
fn a_column_that_is_a_word_of_sql_is_explained() {
    let fault = statements("SELECT session, view FROM views").unwrap_err();
    assert!(fault.to_string().contains("\"view\""), "{fault}");
    assert!(statements("SELECT session, \"view\" FROM views").is_ok());
}

#[test]
fn how_a_query_that_is_nested_too_deep_is_written_is_told() {
    let query = |term: &str| format!("SELECT 1 FROM t WHERE {}", vec![term; 100].join(" OR "));
    let fault = statements(&query("a IS DISTINCT FROM b")).unwrap_err();
    let said =
        "nested too deep; put each IS DISTINCT FROM into parentheses, (a IS DISTINCT FROM b) OR …";
    assert!(fault.to_string().contains(said), "{fault}");
    assert!(statements(&query("(a IS DISTINCT FROM b)")).is_ok());
}

#[test]
fn semicolons_in_quotes_and_comments_end_nothing() {
    let text = "SELECT ';' AS a; -- ; no\nSELECT \"b;\" FROM \"/odom\" /* ; */;";
    assert_eq!(statements(text).unwrap().len(), 2);
    assert_eq!(statements(" \n-- nothing\n").unwrap().len(), 0);
    assert!(
        statements("SELEC 1")
            .unwrap_err()
            .to_string()
            .starts_with("user: ")
    );
}

#[tokio::test]
async fn queries_only_read() {
    let tables = Tables {
        context: context(Limits::default()).unwrap(),
        reader: None,
        dataset: None,
        indexed: OnceCell::new(),
    };
    for (query, reads) in [
        ("COPY (SELECT 1) TO '/nowhere/a.json'", false),
        (
            "CREATE EXTERNAL TABLE t (a TEXT) STORED AS CSV LOCATION '/etc/passwd'",
            false,
        ),
        ("CREATE TABLE t AS SELECT 1", false),
        ("SET datafusion.runtime.memory_limit = '1T'", false),
        ("SELECT * FROM '/etc/passwd'", false),
        ("EXPLAIN SELECT 1", true),
        ("SHOW TABLES", true),
        ("WITH a AS (SELECT 1 AS x) SELECT x FROM a", true),
    ] {
        let mut sink = Sink::spooled(usize::MAX);
        let statement = statements(query).unwrap().remove(0);
        let ran = tables.run(statement, Format::Csv, &mut sink).await;
        assert_eq!(ran.is_ok(), reads, "{query}: {ran:?}");
    }
}

#[tokio::test]
async fn values_that_are_left_open_are_refused() {
    let tables = Tables {
        context: context(Limits::default()).unwrap(),
        reader: None,
        dataset: None,
        indexed: OnceCell::new(),
    };
    for (query, open) in [
        ("SELECT 1 AS a WHERE 2 > $1", "$1"),
        ("SELECT a FROM (VALUES (1)) t(a) LIMIT $n", "$n"),
        ("EXPLAIN SELECT 1 AS a WHERE 2 > $1", "$1"),
    ] {
        let fault = tables.ask(query).await.unwrap_err();
        let said = format!(
            "user: expected values, found {open}, which nobody gives a value; write the value itself"
        );
        assert_eq!(fault.to_string(), said, "{query}");
    }
}

#[tokio::test]
async fn results_have_a_header_even_without_rows() {
    let tables = Tables {
        context: context(Limits::default()).unwrap(),
        reader: None,
        dataset: None,
        indexed: OnceCell::new(),
    };
    for (query, expected) in [
        ("SELECT 1 AS a, 'x' AS b", "a,b\n1,x\n"),
        ("SELECT 1 AS a WHERE false", "a\n"),
    ] {
        let mut sink = Sink::spooled(usize::MAX);
        let statement = statements(query).unwrap().remove(0);
        tables.run(statement, Format::Csv, &mut sink).await.unwrap();
        assert_eq!(String::from_utf8(sink.bytes()).unwrap(), expected);
    }
}

#[tokio::test]
async fn files_have_the_types_of_their_rows() {
    let tables = Tables {
        context: context(Limits::default()).unwrap(),
        reader: None,
        dataset: None,
        indexed: OnceCell::new(),
    };
    let query = "SELECT bytes / 1024 AS kib, bytes + 1 AS next, \
        CAST(bytes AS DOUBLE) / 1024 AS wanted FROM (SELECT CAST(5120 AS BIGINT UNSIGNED) AS bytes)";
    let (schema, batches) = tables.ask(query).await.unwrap();
    assert_eq!(schema.fields(), batches[0].schema_ref().fields());
    let mut sink = Sink::spooled(usize::MAX);
    let statement = statements(query).unwrap().remove(0);
    let ran = tables.run(statement, Format::Arrow, &mut sink).await;
    ran.unwrap();
    let bytes = std::io::Cursor::new(sink.bytes());
    let read = arrow::ipc::reader::FileReader::try_new(bytes, None);
    let read: Vec<RecordBatch> = read.unwrap().map(Result::unwrap).collect();
    assert_eq!(read, batches);
    let values = read[0].columns().iter();
    let values = values.map(|column| arrow::compute::cast(column, &DataType::Float64).unwrap());
    let values: Vec<f64> = values
        .map(|column| column.as_primitive::<Float64Type>().value(0))
        .collect();
    assert_eq!(values, [5.0, 5121.0, 5.0]);
    let mut sink = Sink::spooled(usize::MAX);
    let statement = statements(query).unwrap().remove(0);
    let ran = tables.run(statement, Format::Parquet, &mut sink).await;
    assert_eq!(ran.unwrap(), 1);
}
