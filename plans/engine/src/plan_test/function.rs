//! A step in Python under test: it is held to what operators are held to, as far as the test's rows show it.

use std::collections::BTreeSet;
use std::sync::Arc;

use arrow::array::{AsArray, BooleanArray, RecordBatch, new_null_array};
use arrow::compute::{concat_batches, filter_record_batch};
use arrow::datatypes::DataType;
use evermap_contract::laws::sort;
use evermap_contract::{Registry, pixels_column};
use evermap_interpreter::Table;
use evermap_language::Grain;
use evermap_schemas::Fault;

use crate::conform::beside;
use crate::map::receipt::Extent;
use crate::nodes::python::Python;
use crate::program::python::PythonTask;

/// The rows that a function makes of its tables, in the order of its ports.
///
/// # Errors
/// As [`Python::made`]; a user fault where it makes other rows of the same tables, or, by rows, of other batches.
pub fn rows(
    task: &PythonTask,
    registry: &Registry,
    tables: &[RecordBatch],
) -> Result<RecordBatch, Fault> {
    let mut python = Python {
        task: task.clone(),
        schema: task.schema(registry)?,
        extent: Extent::default(),
        losses: Arc::default(),
    };
    let mut made = |calls: Vec<Vec<RecordBatch>>| -> Result<RecordBatch, Fault> {
        let mut rows = Vec::new();
        for tables in calls.into_iter().filter(|tables| has_rows(tables)) {
            python.extent = extent(task.grain, &tables);
            let tables: Vec<Table> = tables.into_iter().map(table).collect();
            rows.extend(python.made(&tables)?);
        }
        let rows = concat_batches(&python.schema, &rows)?;
        match task.layer(registry) {
            Some(layer) => sort(&rows, layer.key),
            None => Ok(rows),
        }
    };
    let once = made(calls(task.grain, tables))?;
    if made(calls(task.grain, tables))? != once {
        let text = "made other rows when it was called again with the same tables";
        return Err(Fault::user(text)
            .at(task.function.label())
            .next("seed what is random, and order what has no order"));
    }
    if task.grain == Grain::Rows && made(row_by_row(tables))? != once {
        let text = "made other rows of one row at a time than of all rows together";
        return Err(Fault::user(text)
            .at(task.function.label())
            .next("say `grain: session`"));
    }
    Ok(once)
}

/// The table with a column for images, which a test has none of.
///
/// # Errors
/// A fault of ours.
pub fn without_images(rows: &RecordBatch, column: &str) -> Result<RecordBatch, Fault> {
    let images = new_null_array(&DataType::Binary, rows.num_rows());
    beside(rows, &pixels_column(column), images)
}

fn has_rows(tables: &[RecordBatch]) -> bool {
    tables.iter().any(|table| table.num_rows() > 0)
}

fn table(rows: RecordBatch) -> Table {
    let (schema, batches) = (rows.schema(), vec![rows]);
    Table { schema, batches }
}

/// What the rows of a call are of, where its tables name only one.
fn extent(grain: Grain, tables: &[RecordBatch]) -> Extent {
    let only = |column: &str| {
        let found = tables.iter().flat_map(|table| names(table, column));
        let found: BTreeSet<String> = found.flatten().collect();
        found.first().filter(|_| found.len() == 1).cloned()
    };
    Extent {
        session: only("session").filter(|_| matches!(grain, Grain::Rows | Grain::Session)),
        site: only("site").filter(|_| grain != Grain::Map),
    }
}

/// What each call is given: by session or by site the rows of one, and tables that do not name them whole.
fn calls(grain: Grain, tables: &[RecordBatch]) -> Vec<Vec<RecordBatch>> {
    let column = match grain {
        Grain::Session => "session",
        Grain::Site => "site",
        Grain::Rows | Grain::Map => return vec![tables.to_vec()],
    };
    let found = tables.iter().flat_map(|table| names(table, column));
    let found: BTreeSet<String> = found.flatten().collect();
    let of = |name: &String| tables.iter().map(|table| of(table, column, name)).collect();
    match found.is_empty() {
        true => vec![tables.to_vec()],
        false => found.iter().map(of).collect(),
    }
}

fn row_by_row(tables: &[RecordBatch]) -> Vec<Vec<RecordBatch>> {
    let rows = |table: &RecordBatch| {
        (0..table.num_rows())
            .map(|row| table.slice(row, 1))
            .collect()
    };
    let all: Vec<Vec<RecordBatch>> = tables.iter().map(rows).collect();
    all.into_iter().flatten().map(|row| vec![row]).collect()
}

/// The values of a text column, by row; none where there is no such column.
fn names(table: &RecordBatch, column: &str) -> Vec<Option<String>> {
    let found = table.column_by_name(column);
    let texts = found.and_then(|column| column.as_string_opt::<i32>());
    let texts = texts.map(|texts| texts.iter().map(|text| text.map(str::to_owned)).collect());
    texts.unwrap_or_default()
}

fn of(table: &RecordBatch, column: &str, name: &str) -> RecordBatch {
    let names = names(table, column);
    if names.is_empty() {
        return table.clone();
    }
    let wanted = names
        .iter()
        .map(|found| Some(found.as_deref() == Some(name)));
    let wanted: BooleanArray = wanted.collect();
    filter_record_batch(table, &wanted).unwrap_or_else(|_| table.clone())
}
