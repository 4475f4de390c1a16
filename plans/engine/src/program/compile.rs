//! A checked plan becomes a program.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use datafusion::catalog::{MemorySchemaProvider, SchemaProvider};
use datafusion::datasource::MemTable;
use datafusion::prelude::SessionContext;
use evermap_contract::{Entry, Grain, Kernel, LayerRow, Registry, StateRow};
use evermap_language::{Body, Faults, Input, Place, Plan, Step};
use serde_json::Value;

use crate::conform::misfits;
use crate::nodes::operator::Phase;
use crate::program::locality::is_local;
use crate::program::{LIFT, Program, Scope, Stage, Table, Task};
use crate::sql;

/// Compiles a plan. `context` has the log tables registered; their rows are not read.
///
/// # Errors
/// Every fault of the plan that its text alone does not show: queries that do not plan, tables that do not fit ports.
pub async fn compile(
    plan: &Plan,
    registry: &Registry,
    context: &SessionContext,
    origin: &str,
    text: &str,
) -> Result<Program, Faults> {
    let mut compiler = Compiler {
        registry,
        context,
        plan,
        faults: Faults::new(origin, text),
        stages: Vec::new(),
        schemas: BTreeMap::new(),
        previous: Arc::new(MemorySchemaProvider::new()),
    };
    compiler.register_previous();
    for step in &plan.steps {
        compiler.step(step).await;
    }
    if compiler.faults.error_count() > 0 {
        return Err(compiler.faults.settle());
    }
    compiler.decide_stored();
    Ok(Program {
        plan: plan.name.clone(),
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

struct Compiler<'a> {
    registry: &'a Registry,
    context: &'a SessionContext,
    plan: &'a Plan,
    faults: Faults,
    stages: Vec<Stage>,
    schemas: BTreeMap<String, SchemaRef>,
    previous: Arc<MemorySchemaProvider>,
}

impl Compiler<'_> {
    fn fault(&mut self, step: &Step, message: impl Into<String>) {
        self.faults.error(Place::Text(step.position), message);
    }

    /// Layers of the version before have the schema of the operator that makes them in this plan.
    fn register_previous(&mut self) {
        if let Some(catalog) = self.context.catalog("datafusion") {
            let _ = catalog.register_schema("previous", Arc::clone(&self.previous) as _);
        }
        for step in &self.plan.steps {
            if let Body::Op { op, .. } = &step.body
                && let Ok(entry) = self.registry.get(op)
            {
                self.add_previous(&step.name, entry.output.schema());
            }
        }
    }

    fn add_previous(&self, name: &str, schema: SchemaRef) {
        if let Ok(table) = MemTable::try_new(schema, vec![vec![]]) {
            let _ = self
                .previous
                .register_table(name.to_owned(), Arc::new(table));
        }
    }

    async fn step(&mut self, step: &Step) {
        self.check_previous(step);
        let schema = match &step.body {
            Body::Op { op, inputs, params } => self.op(step, op, inputs, params).await,
            Body::Sql { query, inputs } => self.sql(step, query, inputs).await,
        };
        let Some(schema) = schema else { return };
        if let Ok(table) = MemTable::try_new(Arc::clone(&schema), vec![vec![]]) {
            let _ = self.context.register_table(
                datafusion::common::TableReference::bare(step.name.clone()),
                Arc::new(table),
            );
        }
        self.schemas.insert(step.name.clone(), schema);
    }

    /// The columns of a query are known once it is planned, which may need those of the version before: only layers
    /// of operators can be read from there.
    fn check_previous(&mut self, step: &Step) {
        let inputs: Vec<&Input> = match &step.body {
            Body::Op { inputs, .. } => inputs.values().collect(),
            Body::Sql { inputs, .. } => inputs.iter().collect(),
        };
        let is_query = |name: &str| {
            let mut steps = self.plan.steps.iter();
            steps.any(|step| step.name == name && matches!(step.body, Body::Sql { .. }))
        };
        let faults: Vec<_> = inputs
            .into_iter()
            .filter(|input| matches!(input, Input::Previous(name) if is_query(name)))
            .map(|input| {
                let (name, read) = (&step.name, input.written());
                format!("step `{name}`: `{read}` is made by a query; of the version before, only layers of operators can be read")
            })
            .collect();
        faults.into_iter().for_each(|fault| self.fault(step, fault));
    }

    async fn op(
        &mut self,
        step: &Step,
        op: &str,
        inputs: &BTreeMap<String, Input>,
        params: &Value,
    ) -> Option<SchemaRef> {
        let entry = match self.registry.get(op) {
            Ok(entry) => entry.clone(),
            Err(fault) => {
                self.fault(step, fault.message);
                return None;
            }
        };
        let params = match entry
            .normalise(params)
            .and_then(|params| entry.kernel(&params).map(|kernel| (params, kernel)))
        {
            Ok(params) => Some(params),
            Err(fault) => {
                self.fault(step, format!("step `{}`: {}", step.name, fault.message));
                None
            }
        };
        for (port, input) in inputs {
            self.check_port(step, &entry, port, input).await;
        }
        let schema = entry.output.schema();
        if let Some((params, kernel)) = params {
            self.add_operator(step, &entry, inputs, params, &kernel);
        }
        Some(schema)
    }

    async fn check_port(&mut self, step: &Step, entry: &Entry, port: &str, input: &Input) {
        let (Some(port), Some(schema)) = (entry.port(port), self.schema_of(input).await) else {
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

    async fn schema_of(&self, input: &Input) -> Option<SchemaRef> {
        match input {
            Input::Step(name) => self.schemas.get(name).cloned(),
            Input::Source(name) => {
                let table = self
                    .context
                    .table_provider(datafusion::common::TableReference::bare(name.clone()))
                    .await;
                table.ok().map(|table| table.schema())
            }
            Input::Previous(name) => self
                .previous
                .table(name)
                .await
                .ok()
                .flatten()
                .map(|table| table.schema()),
        }
    }

    fn add_operator(
        &mut self,
        step: &Step,
        entry: &Entry,
        inputs: &BTreeMap<String, Input>,
        params: Value,
        kernel: &Kernel,
    ) {
        let tables: BTreeMap<_, _> = inputs
            .iter()
            .map(|(port, input)| (port.clone(), table(input)))
            .collect();
        let own = entry.ports.first().map_or(Scope::Map, |driving| {
            let grain = if driving.grain.is_per_session() {
                Scope::Session
            } else {
                Scope::Site
            };
            tables
                .get(driving.name)
                .map_or(grain, |table| self.scope_of(table).max(grain))
        });
        let scope = entry
            .ports
            .iter()
            .skip(1)
            .filter(|port| port.grain.is_per_session())
            .fold(own, |scope, port| {
                tables
                    .get(port.name)
                    .map_or(scope, |table| scope.max(self.scope_of(table)))
            });
        let stage = |name: String, phase, inputs, scope| Stage {
            name,
            task: Task::Op {
                op: entry.name.to_owned(),
                version: entry.version,
                phase,
                params: params.clone(),
                inputs,
            },
            scope,
            stored: false,
        };
        if matches!(kernel, Kernel::Fold(_)) {
            let lift = format!("{}{LIFT}", step.name);
            let states = BTreeMap::from([("states".to_owned(), Table::Stage(lift.clone()))]);
            self.schemas
                .insert(lift.clone(), StateRow::layer().schema());
            self.stages.push(stage(lift, Phase::Lift, tables, scope));
            self.stages.push(stage(
                step.name.clone(),
                Phase::Merge,
                states,
                scope.max(Scope::Site),
            ));
        } else {
            self.stages
                .push(stage(step.name.clone(), Phase::Run, tables, scope));
        }
    }

    async fn sql(&mut self, step: &Step, query: &str, inputs: &[Input]) -> Option<SchemaRef> {
        if inputs
            .iter()
            .any(|input| matches!(input, Input::Step(name) if !self.schemas.contains_key(name)))
        {
            return None;
        }
        let frame = match sql::read_only(self.context, query).await {
            Ok(frame) => frame,
            Err(fault) => {
                self.fault(
                    step,
                    format!(
                        "the query of `{}` does not plan: {}",
                        step.name, fault.message
                    ),
                );
                return None;
            }
        };
        let plan = frame.logical_plan();
        let repeated = sql::repeated_columns(plan);
        if !repeated.is_empty() {
            self.fault(
                step,
                format!(
                    "the query of `{}` gives two columns the name {}; name one with AS",
                    step.name,
                    repeated.join(", ")
                ),
            );
            return None;
        }
        let tables: Vec<_> = inputs.iter().map(table).collect();
        let widest = tables
            .iter()
            .map(|table| self.scope_of(table))
            .max()
            .unwrap_or(Scope::Map);
        // Rows of a table that covers a site are narrowed to those of a session where they are read.
        let scope = match widest {
            Scope::Map => Scope::Map,
            _ if is_local(plan, "session") => Scope::Session,
            _ if is_local(plan, "site") => Scope::Site,
            _ => Scope::Map,
        };
        let schema = crate::conform::bare(plan.schema().as_arrow());
        let task = Task::Sql {
            query: query.to_owned(),
            inputs: tables,
            ordered: sql::is_ordered(plan),
        };
        self.stages.push(Stage {
            name: step.name.clone(),
            task,
            scope,
            stored: false,
        });
        Some(schema)
    }

    fn scope_of(&self, table: &Table) -> Scope {
        match table {
            Table::Log(_) => Scope::Session,
            Table::Previous(_) => Scope::Site,
            Table::Stage(name) => self
                .stages
                .iter()
                .find(|stage| stage.name == *name)
                .map_or(Scope::Map, |stage| stage.scope),
        }
    }

    /// A stage is kept when it is written, is read twice, is read at a wider scope, or is a port other than the
    /// driving one, whose table every unit needs.
    fn decide_stored(&mut self) {
        let mut readers: BTreeMap<String, usize> = BTreeMap::new();
        let mut stored: BTreeSet<String> = self.plan.write.iter().cloned().collect();
        for stage in &self.stages {
            for table in stage.task.inputs() {
                let Table::Stage(input) = table else { continue };
                *readers.entry(input.clone()).or_default() += 1;
                if self.scope_of(table) != stage.scope || self.is_side(stage, input) {
                    stored.insert(input.clone());
                }
            }
        }
        stored.extend(
            readers
                .into_iter()
                .filter(|(_, count)| *count > 1)
                .map(|(name, _)| name),
        );
        for stage in &mut self.stages {
            stage.stored = stored.contains(&stage.name);
        }
    }

    fn is_side(&self, stage: &Stage, input: &str) -> bool {
        let Task::Op {
            op, inputs, phase, ..
        } = &stage.task
        else {
            return false;
        };
        let Ok(entry) = self.registry.get(op) else {
            return false;
        };
        *phase != Phase::Merge
            && entry.ports.iter().enumerate().any(|(index, port)| {
                let here =
                    matches!(inputs.get(port.name), Some(Table::Stage(name)) if name == input);
                here && (index > 0 || port.grain == Grain::Whole)
            })
    }
}

fn table(input: &Input) -> Table {
    match input {
        Input::Step(name) => Table::Stage(name.clone()),
        Input::Source(name) => Table::Log(name.clone()),
        Input::Previous(name) => Table::Previous(name.clone()),
    }
}
