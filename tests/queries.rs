//! SQL over layers and logs, as text files in `tests/sql` (sqllogictest). Run with `EVERMAP_BLESS=1` to complete them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use datafusion::arrow::util::display::{ArrayFormatter, FormatOptions};
use datafusion::prelude::SessionContext;
use evermap_engine::map::Map;
use evermap_engine::sql::{Limits, context};
use evermap_tests::{evermap, rectangle, repository, text, write_drive};
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
        let frame = self.0.sql(query).await.map_err(|error| refused(&error))?;
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
    let sessions = [text(&drives[0]), text(&drives[1])];
    evermap(&[
        "run",
        "trajectory",
        "--map",
        text(&map),
        "--sessions",
        sessions[0],
        sessions[1],
    ])
    .expect(0);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let context = runtime.block_on(async {
        let map = Map::open(text(&map), None).await.unwrap();
        map.context(Limits {
            partitions: 1,
            ..Limits::default()
        })
        .await
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
    check("logs.slt", context);
}
