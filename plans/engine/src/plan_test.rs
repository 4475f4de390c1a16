//! The tests that a plan carries: rows in, rows out, on the naive engine for operators, on DataFusion for queries, and
//! by an interpreter for functions in Python.

mod function;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::compute::concat_batches;
use arrow::datatypes::SchemaRef;
use datafusion::prelude::SessionContext;
use evermap_contract::Registry;
use evermap_contract::laws::{JsonRow, Split, difference, lacking, run, table};
use evermap_datasets::Dataset;
use evermap_language::{Body, Input, Plan, PlanTest, Step};
use evermap_schemas::Fault;

use crate::conform::conform;
use crate::error::OrFault;
use crate::program::{Program, Task};
use crate::sql::{Limits, context, put_rows, read_only, reference};

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
    async fn run<'t>(&self, test: &'t PlanTest) -> Result<Option<String>, Fault> {
        let context = context(Limits::one_partition())?;
        self.dataset.register(&context)?;
        // What a test does not say of the version before is empty, as before the first version.
        for step in &self.plan.steps {
            if let (Body::Op { .. }, Some(schema)) =
                (&step.body, self.program.schemas.get(&step.name))
            {
                let rows = RecordBatch::new_empty(Arc::clone(schema));
                put_rows(&context, &Input::Previous(step.name.clone()), rows)?;
            }
        }
        let mut tables: BTreeMap<Input, RecordBatch> = BTreeMap::new();
        for (input, rows) in &test.given {
            let schema = self.schema(&context, input).await?;
            let rows = table(&schema, rows).map_err(|fault| fault.at(input.written()))?;
            put_rows(&context, input, rows.clone())?;
            tables.insert(input.clone(), rows);
        }
        for step in &self.plan.steps {
            let made = Input::Step(step.name.clone());
            let rows = match tables.get(&made) {
                Some(given) => given.clone(),
                None => self.step(&context, step, &tables).await?,
            };
            // What a test does not say of new sessions is all that there is, as before the first version.
            for input in [made, Input::New(step.name.clone())] {
                if let Entry::Vacant(vacant) = tables.entry(input) {
                    put_rows(&context, vacant.key(), rows.clone())?;
                    vacant.insert(rows.clone());
                }
            }
        }
        type Compare = fn(&RecordBatch, &[JsonRow], f64) -> Result<Option<String>, Fault>;
        let tables_of = |tables: &'t [(String, Vec<JsonRow>)], compare: Compare| {
            tables.iter().map(move |table| (table, compare))
        };
        let compared = tables_of(&test.expect, difference);
        for ((step, rows), compare) in compared.chain(tables_of(&test.contains, lacking)) {
            let found = tables
                .get(&Input::Step(step.clone()))
                .ok_or_else(|| Fault::bug(format!("no step {step}")))?;
            if let Some(text) = compare(found, rows, test.tolerance)? {
                return Ok(Some(format!("{step}: {text}")));
            }
        }
        Ok(None)
    }

    async fn schema(&self, context: &SessionContext, input: &Input) -> Result<SchemaRef, Fault> {
        match input {
            Input::Step(name) | Input::Previous(name) | Input::New(name) => {
                self.program.schemas.get(name).cloned().ok_or_else(|| {
                    Fault::user(format!("the columns of {} are not known", input.written()))
                })
            }
            Input::Source(_) => {
                let found = context.table_provider(reference(input)).await;
                Ok(found.or_fault()?.schema())
            }
        }
    }

    async fn step(
        &self,
        context: &SessionContext,
        step: &Step,
        tables: &BTreeMap<Input, RecordBatch>,
    ) -> Result<RecordBatch, Fault> {
        match &step.body {
            Body::Op { op, params } => {
                let entry = self.registry.get(op)?;
                let mut rows = BTreeMap::new();
                for (name, input) in &step.inputs {
                    if let (Some(port), Some(found)) = (entry.port(name), tables.get(input)) {
                        rows.insert(name.clone(), conform(found, &port.layer)?);
                    }
                }
                Ok(run(entry, params, &rows, Split::default())?.rows)
            }
            Body::Python(python) => {
                let mut given = Vec::new();
                for (port, input) in &step.inputs {
                    let rows = match tables.get(input) {
                        Some(found) => found.clone(),
                        None => RecordBatch::new_empty(self.schema(context, input).await?),
                    };
                    given.push(match python.pixels.get(port) {
                        Some(column) => function::without_images(&rows, column)?,
                        None => rows,
                    });
                }
                let Task::Python(task) = &self.program.stage(&step.name)?.task else {
                    return Err(Fault::bug(format!("{} is no function", step.name)));
                };
                function::rows(task, self.registry, &given)
            }
            Body::Sql { query } => {
                let frame = read_only(context, query).await?;
                let schema = Arc::new(frame.schema().as_arrow().clone());
                let batches = frame.collect().await.or_fault()?;
                let schema = batches.first().map_or(schema, RecordBatch::schema);
                Ok(concat_batches(&schema, &batches)?)
            }
        }
    }
}
