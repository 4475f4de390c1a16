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
use evermap_language::{Body, Input, Plan, PlanFaults, PlanTest, Step};
use evermap_schemas::{Fault, Kind};

use crate::conform::conform;
use crate::error::{OrFault, without_kind};
use crate::program::test_rows::{check_given, misfits};
use crate::program::{Program, Task};
use crate::sql::{Limits, coming, context, put_rows, read_only, reference};

/// What became of one test: `None` where it passed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TestOutcome {
    /// The test's name.
    pub name: String,
    /// The first difference, or why there is nothing to compare.
    pub failure: Option<String>,
}

/// What is wrong with the rows that tests give.
///
/// # Errors
/// A fault of ours.
pub async fn given_faults(
    plan: &Plan,
    program: &Program,
    registry: &Registry,
    dataset: &Dataset,
) -> Result<PlanFaults, Fault> {
    let context = context(Limits::one_partition())?;
    dataset.register(&context)?;
    for step in &plan.steps {
        let Some(schema) = program.schemas.get(&step.name) else {
            continue;
        };
        for input in [Input::Step, Input::Previous, Input::New] {
            let rows = RecordBatch::new_empty(Arc::clone(schema));
            put_rows(&context, &input(step.name.clone()), rows)?;
        }
    }
    let mut faults = plan.faults();
    check_given(plan, registry, &context, &mut faults).await;
    Ok(faults.settle())
}

/// Runs a plan's tests, each whatever becomes of the others.
///
/// # Errors
/// A lack of resources, or a fault of ours.
pub async fn run_tests(
    plan: &Plan,
    program: &Program,
    registry: &Registry,
    dataset: &Dataset,
) -> Result<Vec<TestOutcome>, Fault> {
    let mut outcomes = Vec::new();
    for test in &plan.tests {
        let bench = Bench {
            plan,
            program,
            registry,
            dataset,
        };
        let failure = match bench.run(test).await {
            Ok(failure) => failure,
            Err(fault) if matches!(fault.kind, Kind::User | Kind::Data) => {
                Some(without_kind(&fault))
            }
            Err(fault) => return Err(fault.at(format!("test {}", test.name))),
        };
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
        let mut misfit = Vec::new();
        for (input, rows) in &test.given {
            let schema = self.schema(&context, input).await?;
            let given = (input, rows.as_slice());
            let found = misfits(self.plan, self.registry, test, given, &schema);
            if !found.is_empty() {
                misfit.extend(found);
                continue;
            }
            let rows = table(&schema, rows).map_err(|fault| fault.at(input.written()))?;
            put_rows(&context, input, rows.clone())?;
            tables.insert(input.clone(), rows);
        }
        if !misfit.is_empty() {
            return Ok(Some(misfit.join("; ")));
        }
        for step in &self.plan.steps {
            let made = Input::Step(step.name.clone());
            let rows = match tables.get(&made) {
                Some(given) => given.clone(),
                None => {
                    let made = self.step(&context, step, &tables).await;
                    made.map_err(|fault| fault.at(format!("step `{}`", step.name)))?
                }
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
            let compared = compare(found, rows, test.tolerance);
            if let Some(text) = compared.map_err(|fault| fault.at(format!("table `{step}`")))? {
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
                let schema = coming(&context.state(), frame.logical_plan().clone()).or_fault()?;
                let batches = frame.collect().await.or_fault()?;
                let schema = batches.first().map_or(schema, RecordBatch::schema);
                Ok(concat_batches(&schema, &batches)?)
            }
        }
    }
}
