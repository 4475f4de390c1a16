//! A checked plan becomes a program.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::datatypes::{Field, SchemaRef};
use datafusion::prelude::SessionContext;
use evermap_contract::{Entry, Phase, Reach, Registry, Shape};
use evermap_language::{Body, Grain, Input, Location, Plan, PlanFaults, PythonStep, Step};
use evermap_schemas::{Cell, ImageRef, layers};
use serde_json::Value;

use crate::conform::{bare, declared, misfits};
use crate::error::without_kind;
use crate::program::kept;
use crate::program::locality::is_local;
use crate::program::python::PythonTask;
use crate::program::query::Query;
use crate::program::reads::{is_read_again, operator_reads, query_read};
use crate::program::test_rows;
use crate::program::{LIFT, Program, Read, Role, Scope, Stage, Task};
use crate::sql;
use crate::sql::described::{described, noted, notes};

/// Compiles a plan. `context` has the log tables registered; their rows are not read.
///
/// # Errors
/// Every fault of the plan that its text alone does not show: queries that do not plan, tables that do not fit ports.
pub async fn compile(
    plan: &Plan,
    registry: &Registry,
    context: &SessionContext,
) -> Result<Program, PlanFaults> {
    let mut compiler = Compiler::new(plan, registry, context, plan.faults());
    compiler.check().await;
    if compiler.faults.error_count() > 0 {
        return Err(compiler.faults.settle());
    }
    kept::decide(&mut compiler.stages, &plan.write, &compiler.read_again);
    compiler.check_once();
    compiler.check_stored();
    if compiler.faults.error_count() > 0 {
        return Err(compiler.faults.settle());
    }
    Ok(Program {
        plan: plan.name.clone(),
        needs: plan.needs.clone(),
        stages: compiler.stages,
        schemas: compiler.schemas,
        write: plan.write.clone(),
        warnings: plan
            .warnings
            .iter()
            .map(|fault| fault.message.clone())
            .collect(),
    })
}

/// The faults that a plan's text has, with those of the steps and tests that have none there: [`evermap_language::read`].
/// `context` has the tables that every log has; steps that read topics are left out.
pub async fn all_faults(
    sound: &Plan,
    registry: &Registry,
    context: &SessionContext,
    faults: PlanFaults,
) -> PlanFaults {
    let mut compiler = Compiler::new(sound, registry, context, faults);
    compiler.has_topics = false;
    compiler.check().await;
    compiler.faults.settle()
}

struct Compiler<'a> {
    registry: &'a Registry,
    context: &'a SessionContext,
    plan: &'a Plan,
    faults: PlanFaults,
    stages: Vec<Stage>,
    schemas: BTreeMap<String, SchemaRef>,
    /// Whether tables of topics are there.
    has_topics: bool,
    /// Steps whose columns are known and whose scopes are not, as they read what is not known.
    vague: BTreeSet<String>,
    /// Tables that a single query reads more than once.
    read_again: BTreeSet<Input>,
}

impl<'a> Compiler<'a> {
    fn new(
        plan: &'a Plan,
        registry: &'a Registry,
        context: &'a SessionContext,
        faults: PlanFaults,
    ) -> Self {
        Self {
            registry,
            context,
            plan,
            faults,
            stages: Vec::new(),
            schemas: BTreeMap::new(),
            has_topics: true,
            vague: BTreeSet::new(),
            read_again: BTreeSet::new(),
        }
    }

    /// Steps and tests. Where anything is at fault, all that is wrong with tests is told with it.
    async fn check(&mut self) {
        self.register_previous();
        let (plan, context) = (self.plan, self.context);
        for step in &plan.steps {
            self.step(step).await;
        }
        test_rows::check_columns(plan, context, &mut self.faults).await;
        if self.faults.error_count() > 0 {
            test_rows::check_given(plan, self.registry, context, &mut self.faults).await;
        }
    }

    fn fault(&mut self, step: &Step, message: impl Into<String>) {
        self.faults.error(Location::Text(step.position), message);
    }

    /// Layers of the version before have the schema of the operator that makes them in this plan.
    fn register_previous(&mut self) {
        for step in &self.plan.steps {
            if let Body::Op { op, .. } = &step.body
                && let Ok(entry) = self.registry.get(op)
            {
                self.put(Input::Previous(step.name.clone()), entry.output.schema());
            }
        }
    }

    /// An empty table: queries are planned on columns alone.
    fn put(&self, input: Input, schema: SchemaRef) {
        let _ = sql::put_rows(self.context, &input, RecordBatch::new_empty(schema));
    }

    async fn step(&mut self, step: &Step) {
        self.check_versions(step);
        let schema = match &step.body {
            Body::Op { op, params } => self.op(step, op, params).await,
            Body::Sql { query } => {
                let query = Query::of(step, query);
                self.sql(step, query).await
            }
            Body::Python(python) => self.python(step, python).await,
        };
        let Some(schema) = schema else { return };
        if !self.knows_scopes(step) {
            self.vague.insert(step.name.clone());
        }
        let described = match self.stages.iter().find(|stage| stage.name == step.name) {
            Some(Stage {
                task: Task::Sql { notes, .. },
                ..
            }) => noted(&schema, notes),
            _ => Arc::clone(&schema),
        };
        self.put(Input::Step(step.name.clone()), Arc::clone(&described));
        self.put(Input::New(step.name.clone()), described);
        self.schemas.insert(step.name.clone(), schema);
    }

    /// The columns of a query are known once it is planned, which may need those of the version before: only layers
    /// of operators can be read from there. Nor are they known where there is no new session.
    fn check_versions(&mut self, step: &Step) {
        let made_by = |name: &str| match self.plan.step(name)?.body {
            Body::Op { .. } => None,
            Body::Sql { .. } => Some("a query"),
            Body::Python(_) => Some("a function"),
        };
        let faults: Vec<_> = step
            .inputs
            .values()
            .filter_map(|input| {
                let (of, rows) = match input {
                    Input::Previous(of) => (of, "of the version before"),
                    Input::New(of) => (of, "of new sessions alone"),
                    Input::Step(_) | Input::Source(_) => return None,
                };
                let why = match (made_by(of), input) {
                    (Some(maker), _) => {
                        format!("is made by {maker}; {rows}, only layers of operators can be read")
                    }
                    (None, Input::New(_))
                        if !self.vague.contains(of) && self.scope_of(input) != Scope::Session =>
                    {
                        format!("is not of new sessions alone: one unit of `{of}` covers more than a session")
                    }
                    _ => return None,
                };
                Some(format!("step `{}`: `{}` {why}", step.name, input.written()))
            })
            .collect();
        faults.into_iter().for_each(|fault| self.fault(step, fault));
    }

    async fn op(&mut self, step: &Step, op: &str, params: &Value) -> Option<SchemaRef> {
        let entry = match self.registry.get(op) {
            Ok(entry) => entry.clone(),
            Err(fault) => {
                self.fault(step, fault.message);
                return None;
            }
        };
        for (port, input) in &step.inputs {
            self.check_port(step, &entry, port, input).await;
        }
        match entry.normalise(params) {
            Ok(params) => self.add_operator(step, &entry, params),
            Err(fault) => self.fault(step, format!("step `{}`: {}", step.name, fault.message)),
        }
        Some(entry.output.schema())
    }

    async fn check_port(&mut self, step: &Step, entry: &Entry, port: &str, input: &Input) {
        let schema = sql::schema_of(self.context, input).await;
        let (Some(port), Some(schema)) = (entry.port(port), schema) else {
            return;
        };
        for misfit in misfits(&schema, &port.layer) {
            let text = format!(
                "step `{}`: `{}` {misfit}, which port `{}` of {} reads",
                step.name,
                input.written(),
                port.name,
                entry.name
            );
            self.fault(step, text);
        }
    }

    fn add_operator(&mut self, step: &Step, entry: &Entry, params: Value) {
        let mut stage = |name: &str, phase, inputs: &BTreeMap<String, Input>| {
            let reads = operator_reads(entry, phase, inputs);
            let scope = self.widest(&reads).unwrap_or(Scope::Map);
            self.stages.push(Stage {
                name: name.to_owned(),
                task: Task::Op {
                    op: entry.name.to_owned(),
                    version: entry.version,
                    phase,
                    params: params.clone(),
                },
                reads,
                scope,
                stored: false,
                once: step.once,
            });
        };
        if entry.shape == Shape::Fold {
            let lift = format!("{}{LIFT}", step.name);
            stage(&lift, Phase::Lift, &step.inputs);
            let states = entry.driving(Phase::Merge).port.name.to_owned();
            let states = BTreeMap::from([(states, Input::Step(lift))]);
            stage(&step.name, Phase::Merge, &states);
        } else {
            stage(&step.name, Phase::Run, &step.inputs);
        }
    }

    /// Whether the columns of all tables that a step reads are known; those of a step at fault are not.
    fn knows_inputs(&self, step: &Step) -> bool {
        let is_known = |input: &Input| match input {
            Input::Step(name) | Input::New(name) => self.schemas.contains_key(name),
            Input::Source(name) => self.has_topics || !name.starts_with('/'),
            Input::Previous(_) => true,
        };
        step.inputs.values().all(is_known)
    }

    /// Whether it is known how much of the map the tables cover that a step reads.
    fn knows_scopes(&self, step: &Step) -> bool {
        let is_vague = |input: &Input| match input {
            Input::Step(name) | Input::New(name) => self.vague.contains(name),
            Input::Source(_) | Input::Previous(_) => false,
        };
        self.knows_inputs(step) && !step.inputs.values().any(is_vague)
    }

    async fn python(&mut self, step: &Step, python: &PythonStep) -> Option<SchemaRef> {
        for (port, column) in &python.pixels {
            let schema = sql::schema_of(self.context, step.inputs.get(port)?).await?;
            let is_image = |field: &Field| *field.data_type() == ImageRef::data_type();
            if !schema.field_with_name(column).is_ok_and(is_image) {
                let name = &step.name;
                let text = format!("step `{name}`: `{port}` has no column `{column}` of images");
                self.fault(step, text);
            }
        }
        let task = match PythonTask::of(step, python, self.registry).await {
            Ok(task) if self.knows_inputs(step) => task,
            Ok(_) => return None,
            Err(fault) => {
                let text = without_kind(&fault);
                self.fault(step, format!("step `{}`: {text}", step.name));
                return None;
            }
        };
        let schema = task.schema(self.registry).ok()?;
        let read = |(port, input): (&String, &Input)| Read {
            role: Role::Side(port.clone()),
            pixels: python.pixels.get(port).cloned(),
            ..query_read(input)
        };
        self.stages.push(Stage {
            name: step.name.clone(),
            reads: step.inputs.iter().map(read).collect(),
            scope: match python.grain {
                Grain::Rows | Grain::Session => Scope::Session,
                Grain::Site => Scope::Site,
                Grain::Map => Scope::Map,
            },
            task: Task::Python(Box::new(task)),
            stored: false,
            once: step.once,
        });
        Some(schema)
    }

    async fn sql(&mut self, step: &Step, query: Query<'_>) -> Option<SchemaRef> {
        if !self.knows_inputs(step) {
            return None;
        }
        let frame = query.planned(self.context, &mut self.faults).await?;
        let plan = frame.logical_plan();
        let again = step
            .inputs
            .values()
            .filter(|table| is_read_again(plan, table));
        self.read_again.extend(again.cloned());
        let reads: Vec<_> = step.inputs.values().map(query_read).collect();
        let widest = self.widest(&reads).unwrap_or(Scope::Map);
        // Rows of a table that covers a site are narrowed to those of a session where they are read.
        let scope = match widest {
            Scope::Map => Scope::Map,
            _ if is_local(plan, "session") => Scope::Session,
            _ if is_local(plan, "site") => Scope::Site,
            _ => Scope::Map,
        };
        // It was planned to the end, so it is made alike.
        let coming = sql::coming(&self.context.state(), plan.clone());
        let schema = coming.map_or_else(|_| bare(plan.schema().as_arrow()), |schema| bare(&schema));
        let found = described(plan, |_| None);
        // Who gives a step the name of a layer says that its columns are that layer's.
        let layer = layers::named(&step.name);
        let task = Task::Sql {
            query: query.text.to_owned(),
            ordered: sql::is_ordered(plan),
            notes: notes(
                &layer.map_or_else(|| Arc::clone(&found), |layer| declared(&found, &layer)),
            ),
        };
        self.stages.push(Stage {
            name: step.name.clone(),
            task,
            reads,
            scope,
            stored: false,
            once: step.once,
        });
        Some(schema)
    }

    /// How much of the map a unit covers at least that reads this.
    fn widest(&self, reads: &[Read]) -> Option<Scope> {
        let scope = |read: &Read| match (&read.role, read.reach) {
            // A side of the whole site is read by units that cover less, too.
            (Role::Side(_), Reach::Site) => Scope::Session,
            (_, Reach::Site) => self.scope_of(&read.table).max(Scope::Site),
            (_, Reach::Session) => self.scope_of(&read.table),
        };
        reads.iter().map(scope).max()
    }

    fn scope_of(&self, table: &Input) -> Scope {
        match table {
            Input::Source(_) => Scope::Session,
            Input::Previous(_) => Scope::Site,
            Input::Step(name) | Input::New(name) => {
                let made = self.stages.iter().find(|stage| stage.name == *name);
                made.map_or(Scope::Map, |stage| stage.scope)
            }
        }
    }

    /// What is not kept cannot be as it was.
    fn check_once(&mut self) {
        let lost = |step: &&Step| {
            let mut stages = self.stages.iter().filter(|stage| stage.name == step.name);
            step.once && stages.any(|stage| !stage.stored)
        };
        let lost: Vec<&Step> = self.plan.steps.iter().filter(lost).collect();
        for step in lost {
            self.fault(
                step,
                format!(
                    "step `{}`: `once` is for steps that are stored: those that are written, or read by steps of more sessions",
                    step.name
                ),
            );
        }
    }

    /// What is kept is written as Parquet.
    fn check_stored(&mut self) {
        for stage in self.stages.iter().filter(|stage| stage.stored) {
            let schema = self.schemas.get(&stage.name);
            if let (Some(step), Some(schema)) = (self.plan.step(&stage.name), schema)
                && let Body::Sql { query } = &step.body
            {
                Query::of(step, query).check_stored(schema, &mut self.faults);
            }
        }
    }
}
