//! The tests that a plan carries: rows in, rows out, on the naive engine for operators and on DataFusion for queries.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::compute::concat_batches;
use arrow::datatypes::SchemaRef;
use datafusion::catalog::{MemorySchemaProvider, SchemaProvider};
use datafusion::common::TableReference;
use datafusion::datasource::MemTable;
use datafusion::prelude::SessionContext;
use evermap_contract::Registry;
use evermap_contract::laws::{Split, difference, run, table};
use evermap_datasets::Dataset;
use evermap_language::{Body, Input, Plan, PlanTest, Step};
use evermap_schemas::Fault;

use crate::conform::conform;
use crate::error::fault_of;
use crate::program::Program;
use crate::sql::{Limits, context, read_only};

/// What became of one test: `None` where it passed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TestOutcome {
    /// The test's name.
    pub name: String,
    /// The first difference.
    pub failure: Option<String>,
}

/// Runs a plan's tests.
///
/// # Errors
/// When a test's rows do not fit their tables, or a step fails.
pub async fn run_tests(
    plan: &Plan,
    program: &Program,
    registry: &Registry,
    dataset: &Dataset,
) -> Result<Vec<TestOutcome>, Fault> {
    let mut outcomes = Vec::new();
    for test in &plan.tests {
        let failure = Bench {
            plan,
            program,
            registry,
            dataset,
        }
        .run(test)
        .await
        .map_err(|fault| fault.at(format!("test {}", test.name)))?;
        outcomes.push(TestOutcome {
            name: test.name.clone(),
            failure,
        });
    }
    Ok(outcomes)
}

struct Bench<'a> {
    plan: &'a Plan,
    program: &'a Program,
    registry: &'a Registry,
    dataset: &'a Dataset,
}

impl Bench<'_> {
    async fn run(&self, test: &PlanTest) -> Result<Option<String>, Fault> {
        let context = context(Limits {
            partitions: 1,
            ..Limits::default()
        })?;
        self.dataset.register(&context)?;
        let previous = Arc::new(MemorySchemaProvider::new());
        if let Some(catalog) = context.catalog("datafusion") {
            catalog
                .register_schema("previous", Arc::clone(&previous) as _)
                .map_err(|error| fault_of(&error))?;
        }
        let mut tables: BTreeMap<String, RecordBatch> = BTreeMap::new();
        // What a test does not say of the version before is empty, as before the first version.
        for step in &self.plan.steps {
            if let (Body::Op { .. }, Some(schema)) =
                (&step.body, self.program.schemas.get(&step.name))
            {
                let name = format!("{}{}", Input::PREVIOUS, step.name);
                put(
                    &context,
                    &previous,
                    &name,
                    &RecordBatch::new_empty(Arc::clone(schema)),
                )?;
            }
        }
        for (input, rows) in &test.given {
            let schema = self.schema(&context, input).await?;
            tables.insert(
                input.written(),
                table(&schema, rows).map_err(|fault| fault.at(input.written()))?,
            );
        }
        for (name, rows) in &tables {
            put(&context, &previous, name, rows)?;
        }
        for step in &self.plan.steps {
            if !tables.contains_key(&step.name) {
                let rows = self.step(&context, step, &tables).await?;
                put(&context, &previous, &step.name, &rows)?;
                tables.insert(step.name.clone(), rows);
            }
        }
        for (step, expected) in &test.expect {
            let found = tables
                .get(step)
                .ok_or_else(|| Fault::bug(format!("no step {step}")))?;
            if let Some(text) = difference(found, expected, test.tolerance)? {
                return Ok(Some(format!("{step}: {text}")));
            }
        }
        Ok(None)
    }

    async fn schema(&self, context: &SessionContext, input: &Input) -> Result<SchemaRef, Fault> {
        match input {
            Input::Step(name) | Input::Previous(name) => {
                self.program.schemas.get(name).cloned().ok_or_else(|| {
                    Fault::user(format!("the columns of {} are not known", input.written()))
                })
            }
            Input::Source(name) => {
                let found = context
                    .table_provider(TableReference::bare(name.clone()))
                    .await;
                Ok(found.map_err(|error| fault_of(&error))?.schema())
            }
        }
    }

    async fn step(
        &self,
        context: &SessionContext,
        step: &Step,
        tables: &BTreeMap<String, RecordBatch>,
    ) -> Result<RecordBatch, Fault> {
        match &step.body {
            Body::Op { op, inputs, params } => {
                let entry = self.registry.get(op)?;
                let mut rows = BTreeMap::new();
                for (name, input) in inputs {
                    if let (Some(port), Some(found)) =
                        (entry.port(name), tables.get(&input.written()))
                    {
                        rows.insert(name.clone(), conform(found, &port.layer)?);
                    }
                }
                Ok(run(entry, params, &rows, Split::default())?.rows)
            }
            Body::Sql { query, .. } => {
                let frame = read_only(context, query).await?;
                let schema = Arc::new(frame.schema().as_arrow().clone());
                let batches = frame.collect().await.map_err(|error| fault_of(&error))?;
                let schema = batches.first().map_or(schema, RecordBatch::schema);
                Ok(concat_batches(&schema, &batches)?)
            }
        }
    }
}

fn put(
    context: &SessionContext,
    previous: &MemorySchemaProvider,
    name: &str,
    rows: &RecordBatch,
) -> Result<(), Fault> {
    let provider = MemTable::try_new(rows.schema(), vec![vec![rows.clone()]])
        .map_err(|error| fault_of(&error))?;
    if let Some(layer) = name.strip_prefix(Input::PREVIOUS) {
        let _ = previous.deregister_table(layer);
        return previous
            .register_table(layer.to_owned(), Arc::new(provider))
            .map(drop)
            .map_err(|error| fault_of(&error));
    }
    let reference = TableReference::bare(name);
    context
        .deregister_table(reference.clone())
        .map_err(|error| fault_of(&error))?;
    context
        .register_table(reference, Arc::new(provider))
        .map(drop)
        .map_err(|error| fault_of(&error))
}
