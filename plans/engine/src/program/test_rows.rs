//! Rows of a plan's tests against the tables that they are of.

use std::collections::BTreeSet;
use std::sync::Arc;

use arrow::datatypes::{DataType, FieldRef, Fields, Schema, SchemaRef};
use datafusion::prelude::SessionContext;
use evermap_contract::Registry;
use evermap_contract::laws::table;
use evermap_language::{Body, Input, Location, Plan, PlanFaults, PlanTest, Row, nearest};
use evermap_schemas::type_name;
use serde_json::Value;

use crate::sql::schema_of;

/// More letters of a value are not shown.
const LONGEST_SHOWN: usize = 60;

/// Records the columns that tests name and their tables do not have: they would be compared with nothing. `context` has
/// the tables; of those that it has not, nothing is known.
pub async fn check_columns(plan: &Plan, context: &SessionContext, faults: &mut PlanFaults) {
    for test in &plan.tests {
        let made = test.expect.iter().chain(&test.contains);
        let made = made.map(|(step, rows)| (Input::Step(step.clone()), rows));
        let given = test.given.iter().map(|(input, rows)| (input.clone(), rows));
        for (input, rows) in given.chain(made) {
            let Some(schema) = schema_of(context, &input).await else {
                continue;
            };
            for unknown in unknown(schema.fields(), rows) {
                let (test_name, table) = (&test.name, input.written());
                let text = format!("test `{test_name}`: `{table}` has {unknown}");
                faults.error(Location::Text(test.position), text);
            }
        }
    }
}

/// Records what keeps rows that tests give from being read, as [`misfits`] finds it in the tables of `context`.
pub async fn check_given(
    plan: &Plan,
    registry: &Registry,
    context: &SessionContext,
    faults: &mut PlanFaults,
) {
    for test in &plan.tests {
        for (input, rows) in &test.given {
            let Some(schema) = schema_of(context, input).await else {
                continue;
            };
            for misfit in misfits(plan, registry, test, (input, rows.as_slice()), &schema) {
                let text = format!("test `{}`: {misfit}", test.name);
                faults.error(Location::Text(test.position), text);
            }
        }
    }
}

/// What keeps the rows of a table that a test gives from being of its columns, or from being read by a step that the test
/// runs: one sentence a column.
pub fn misfits(
    plan: &Plan,
    registry: &Registry,
    test: &PlanTest,
    (input, rows): (&Input, &[Row]),
    schema: &Schema,
) -> Vec<String> {
    let given = input.written();
    let misfit = |column: &FieldRef| {
        let name = column.name();
        let reader = reader(plan, registry, test, (input, name.as_str()));
        let mut rows = rows.iter().enumerate();
        rows.find_map(|(number, row)| match row.get(name) {
            // What a row leaves out is null where it may be, else zero.
            None | Some(Value::Null) => {
                let why = match (column.is_nullable(), reader) {
                    (true, Some(step)) => format!(", which step `{step}` needs"),
                    (false, _) if row.contains_key(name) => String::new(),
                    _ => return None,
                };
                Some(format!(
                    "row {number} of `{given}` has no `{name}`{why}; give `{name}` a value"
                ))
            }
            Some(value) => (!fits(column, value)).then(|| {
                let (found, expected) = (shown(value), type_name(column.data_type()));
                format!("row {number} of `{given}` has {found} in `{name}`, expected {expected}")
            }),
        })
    };
    schema.fields().iter().filter_map(misfit).collect()
}

/// The first step that a test runs and that reads a column which may not be null there.
fn reader<'p>(
    plan: &'p Plan,
    registry: &Registry,
    test: &PlanTest,
    (input, column): (&Input, &str),
) -> Option<&'p str> {
    let is_given = |step: &str| {
        let mut given = test.given.iter();
        given.any(|(given, _)| matches!(given, Input::Step(name) if name == step))
    };
    let needs = |op: &str, port: &str| {
        let port = registry.get(op).ok().and_then(|entry| entry.port(port));
        let column = port.and_then(|port| port.layer.column(column));
        column.is_some_and(|column| !column.nullable)
    };
    let mut steps = plan.steps.iter().filter(|step| !is_given(&step.name));
    let reader = steps.find(|step| match &step.body {
        Body::Op { op, .. } => {
            let mut inputs = step.inputs.iter();
            inputs.any(|(port, read)| read == input && needs(op, port))
        }
        Body::Sql { .. } | Body::Python(_) => false,
    });
    reader.map(|step| step.name.as_str())
}

/// Whether a column holds a value; one that names members that there are not is told by [`unknown`].
fn fits(column: &FieldRef, value: &Value) -> bool {
    let columns: SchemaRef = Arc::new(Schema::new(vec![Arc::clone(column)]));
    let row = [Row::from_iter([(column.name().clone(), value.clone())])];
    table(&columns, &row).is_ok() || !unknown(columns.fields(), &row).is_empty()
}

fn shown(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(LONGEST_SHOWN) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

/// One sentence for each column that rows name and that there is not.
fn unknown(columns: &Fields, rows: &[Row]) -> BTreeSet<String> {
    let mut unknown = BTreeSet::new();
    rows.iter()
        .for_each(|row| check(columns, row, "", &mut unknown));
    unknown
}

fn check(columns: &Fields, row: &Row, within: &str, unknown: &mut BTreeSet<String>) {
    for (name, value) in row {
        let path = format!("{within}{name}");
        match (
            columns.find(name).map(|(_, column)| column.data_type()),
            value,
        ) {
            (Some(DataType::Struct(members)), Value::Object(row)) => {
                check(members, row, &format!("{path}."), unknown);
            }
            (Some(_), _) => {}
            (None, _) => {
                let known = columns.iter().map(|column| column.name().as_str());
                let near = nearest(name, known);
                let meant =
                    near.map_or_else(String::new, |near| format!("; did you mean `{near}`?"));
                unknown.insert(format!("no column `{path}`{meant}"));
            }
        }
    }
}
