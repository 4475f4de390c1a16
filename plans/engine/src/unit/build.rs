//! A unit's stages as one DataFusion plan.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use arrow::datatypes::{DataType, Schema, SchemaRef};
use datafusion::execution::TaskContext;
use datafusion::physical_optimizer::PhysicalOptimizerRule;
use datafusion::physical_optimizer::ensure_requirements::EnsureRequirements;
use datafusion::physical_plan::coalesce_partitions::CoalescePartitionsExec;
use datafusion::physical_plan::empty::EmptyExec;
use datafusion::physical_plan::sorts::sort::SortExec;
use datafusion::physical_plan::{ExecutionPlan, ExecutionPlanProperties};
use datafusion::prelude::SessionContext;
use evermap_contract::{Losses, Phase, Registry};
use evermap_datasets::{Dataset, ImageReader};
use evermap_language::Input;
use evermap_schemas::{Fault, Layer};
use futures::FutureExt;
use futures::future::BoxFuture;
use serde_json::Value;

use crate::error::OrFault;
use crate::fingerprint::UnitLog;
use crate::locked::locked;
use crate::map::receipt::Extent;
use crate::map::store::{Store, each};
use crate::nodes::light::LightBatches;
use crate::nodes::node::{Deal, Duty, Need, ordering};
use crate::nodes::operator::{Operator, OperatorExec};
use crate::nodes::pixels::{Fetching, PixelsExec};
use crate::nodes::planned::PlannedTable;
use crate::nodes::python::{Python, PythonExec};
use crate::program::python::PythonTask;
use crate::program::{Read, Role, Stage, Task};
use crate::sql::described::noted;
use crate::sql::{BATCH_ROWS, context_with, put, read_only};
use crate::unit::Unit;
use crate::unit::tables::Tables;

/// Rows per batch where rows carry bytes by the hundred kilobytes.
const HEAVY_BATCH_ROWS: usize = 64;

/// Rows that are written at once where each may have megabytes.
const HEAVY_WRITTEN_ROWS: usize = 8;

/// Stored bytes that a batch should hold at most.
const BATCH_BYTES: u64 = 4 << 20;

/// Builds a unit's plan and keeps what it needs while it runs.
pub struct Builder<'a> {
    tables: Tables<'a>,
    layer: Option<Layer>,
    opened: Vec<UnitLog>,
    reader: Option<Arc<ImageReader>>,
    skipped: Arc<Mutex<Losses>>,
    batch_rows: usize,
}

impl<'a> Builder<'a> {
    /// Opens the unit's logs and sets a context up.
    ///
    /// # Errors
    /// When a log cannot be opened.
    pub async fn new(
        unit: &'a Unit,
        store: &'a Store,
        registry: &'a Registry,
    ) -> Result<Self, Fault> {
        let is_operator = |stage: &Stage| matches!(stage.task, Task::Op { .. });
        let operators_only = unit.recipe.stages.iter().all(is_operator);
        // Floating-point sums depend on how rows are dealt out: a query or a function has one partition, the same
        // everywhere.
        let mut limits = unit.limits;
        if !operators_only {
            limits.partitions = 1;
        }
        let layer = unit.stage()?.layer(registry);
        let batch_rows = batch_rows(unit, layer.as_ref());
        let context = context_with(limits, batch_rows)?;
        if operators_only {
            read_in_order(&context);
        }
        context.register_object_store(store.url(), store.objects());
        let mut opened = Vec::new();
        for (manifest, log) in unit.logs.iter().zip(&unit.recipe.logs) {
            let runtime = context.runtime_env();
            opened.push(UnitLog::open(store, &runtime, manifest, log).await?);
        }
        let (mut logs, mut reader) = (BTreeMap::new(), None);
        if let Some(dataset) = joined(&opened) {
            dataset.register_stores(&context.runtime_env());
            logs = dataset.tables()?;
            reader = Some(Arc::new(ImageReader::new(
                &dataset,
                ImageReader::CACHE_BYTES,
            )));
        }
        let tables = Tables {
            unit,
            store,
            registry,
            context,
            logs,
        };
        Ok(Self {
            tables,
            layer,
            opened,
            reader,
            skipped: Arc::default(),
            batch_rows,
        })
    }

    /// The layer that the unit makes; `None` for a query's rows.
    pub fn layer(&self) -> Option<&Layer> {
        self.layer.as_ref()
    }

    /// The columns of the unit's plan as they are written: those of a query with what is known of them, and nothing that
    /// they bring along from a table that is not stored.
    ///
    /// # Errors
    /// As [`Unit::stage`].
    pub fn written(&self, schema: SchemaRef) -> Result<SchemaRef, Fault> {
        Ok(match &self.tables.unit.stage()?.task {
            Task::Sql { notes, .. } => noted(&schema, notes),
            Task::Op { .. } | Task::Python(_) => schema,
        })
    }

    /// What the rows are of.
    pub fn extent(&self) -> Extent {
        self.tables.unit.recipe.extent.clone()
    }

    /// Rows that are written at once.
    pub fn written_rows(&self) -> usize {
        match self.layer().is_some_and(has_bytes) {
            true => HEAVY_WRITTEN_ROWS,
            false => self.batch_rows,
        }
    }

    /// The context that the plan runs in.
    pub fn task_context(&self) -> Arc<TaskContext> {
        self.tables.context.task_ctx()
    }

    /// That the logs which were read are those that the recipe names.
    ///
    /// # Errors
    /// A fault for a log that is another one by now, or grew in what was read of it; what the store says of one that it does
    /// not give.
    pub async fn logs_are_the_same(&self) -> Result<(), Fault> {
        each(self.opened.iter().map(UnitLog::still)).await.map(drop)
    }

    /// What operators skipped.
    pub fn skipped(&self) -> BTreeMap<String, u64> {
        locked(&self.skipped).0.clone()
    }

    /// What the logs had lost.
    pub fn log_losses(&self) -> BTreeMap<String, u64> {
        let mut counted = Losses::default();
        let told = self.opened.iter().flat_map(|log| log.dataset.losses.told());
        told.for_each(|(line, count)| counted.add(line, count));
        counted.0
    }

    /// The unit's plan: one partition, ordered as its rows are kept.
    ///
    /// # Errors
    /// Whatever keeps it from being planned.
    pub async fn plan(&self) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let stage = self.tables.unit.stage()?;
        let plan = self.stage(stage).await?;
        let order = match (&stage.task, self.layer()) {
            (Task::Op { .. } | Task::Python(_), Some(layer)) => {
                layer.key.iter().map(ToString::to_string).collect()
            }
            (Task::Sql { ordered: true, .. } | Task::Python(_), _) => Vec::new(),
            _ => sortable_columns(&plan.schema()),
        };
        self.ensure(sorted(plan, &order))
    }

    fn stage<'b>(
        &'b self,
        stage: &'b Stage,
    ) -> BoxFuture<'b, Result<Arc<dyn ExecutionPlan>, Fault>> {
        async move {
            let reads = &stage.reads;
            let plan = match &stage.task {
                Task::Op {
                    op, phase, params, ..
                } => self.operator(op, *phase, params, reads).await,
                Task::Sql { query, .. } => self.query(query, reads).await,
                Task::Python(task) => self.python(task, reads).await,
            };
            plan.map_err(|fault| fault.at(format!("step {}", stage.name)))
        }
        .boxed()
    }

    async fn operator(
        &self,
        op: &str,
        phase: Phase,
        params: &Value,
        reads: &[Read],
    ) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let entry = self.tables.registry.get(op)?;
        let read = |role: Role| reads.iter().find(|read| read.role == role);
        let mut tables = vec![match read(Role::Driving) {
            Some(read) => self.table(read).await?,
            None => Arc::new(EmptyExec::new(entry.driving(phase).port.layer.schema())),
        }];
        let mut sides = Vec::new();
        for port in entry.sides(phase) {
            if let Some(read) = read(Role::Side(port.name.to_owned())) {
                tables.push(self.table(read).await?);
                sides.push(port.clone());
            }
        }
        let operator = Operator::new(entry, params, phase, sides, Arc::clone(&self.skipped));
        let ports = operator.ports().zip(operator.needs());
        let children = tables.into_iter().zip(ports);
        let children = children.map(|(table, (port, need))| self.pixels(table, port.pixels, need));
        let children = children.collect::<Result<_, _>>()?;
        let exec = OperatorExec::try_new(Arc::new(operator), children);
        self.ensure(Arc::new(exec.or_fault()?))
    }

    async fn python(
        &self,
        task: &PythonTask,
        reads: &[Read],
    ) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let mut children = Vec::new();
        for read in reads {
            let (table, need) = (self.table(read).await?, Need::whole(Vec::new()));
            children.push(self.pixels(table, read.pixels.as_deref(), need)?);
        }
        let python = Python {
            task: task.clone(),
            schema: task.schema(self.tables.registry)?,
            extent: self.extent(),
            losses: Arc::clone(&self.skipped),
        };
        let exec = PythonExec::try_new(Arc::new(python), children);
        self.ensure(Arc::new(exec.or_fault()?))
    }

    /// The table with the images of a column, where one is named, whose reader needs the rows so.
    fn pixels(
        &self,
        table: Arc<dyn ExecutionPlan>,
        column: Option<&str>,
        need: Need,
    ) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let Some(column) = column else {
            return Ok(table);
        };
        let missing = || Fault::bug("images are asked for without logs");
        let fetching = Fetching {
            column: column.to_owned(),
            need: Need {
                parallel: need.deal != Deal::Single,
                ..need
            },
            reader: self.reader.clone().ok_or_else(missing)?,
            losses: Arc::clone(&self.skipped),
        };
        let exec = PixelsExec::try_new(Arc::new(fetching), vec![table]);
        Ok(Arc::new(exec.or_fault()?))
    }

    /// The rows that are read as a plan: of a stage inside this unit, of artifacts, or of logs.
    async fn table(&self, read: &Read) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        if let Some(stage) = self.inside(&read.table) {
            return self.stage(stage).await;
        }
        let plan = self.tables.rows(read).await?.create_physical_plan().await;
        plan.or_fault()
    }

    /// The stage, where the table is made inside this unit.
    fn inside(&self, table: &Input) -> Option<&Stage> {
        let Input::Step(name) = table else {
            return None;
        };
        let (_, inner) = self.tables.unit.recipe.stages.split_last()?;
        inner.iter().find(|stage| stage.name == *name)
    }

    async fn query(&self, query: &str, reads: &[Read]) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let context = &self.tables.context;
        for read in reads {
            let table = match self.inside(&read.table) {
                Some(stage) => Arc::new(PlannedTable(self.stage(stage).await?)) as _,
                None => self.tables.rows(read).await?.into_view(),
            };
            put(context, &read.table, table)?;
        }
        let frame = read_only(context, query).await?;
        frame.create_physical_plan().await.or_fault()
    }

    /// Puts in front of operators the repartitioning and order that they need.
    fn ensure(&self, plan: Arc<dyn ExecutionPlan>) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let state = self.tables.context.state();
        let options = state.config_options();
        let ensured = EnsureRequirements::new().optimize(plan, options);
        let light = ensured.and_then(|plan| LightBatches.optimize(plan, options));
        light.or_fault()
    }
}

/// Has files that follow each other read one behind the other, so that rows which are stored in order are not sorted.
fn read_in_order(context: &SessionContext) {
    let state = context.state_ref();
    let mut state = state.write();
    let execution = &mut state.config_mut().options_mut().execution;
    execution.split_file_groups_by_statistics = true;
}

/// The sessions of some logs as one; what scans lose goes to the ledger of the first.
fn joined(opened: &[UnitLog]) -> Option<Dataset> {
    let (first, others) = opened.split_first()?;
    let mut joined = first.dataset.clone();
    for log in others {
        joined.sessions.extend(log.dataset.sessions.iter().cloned());
    }
    joined.sessions.sort_by(|a, b| a.name.cmp(&b.name));
    Some(joined)
}

/// Rows per batch: few of heavy rows, whether they are made or read, so that a batch has megabytes and no more.
fn batch_rows(unit: &Unit, output: Option<&Layer>) -> usize {
    if output.is_some_and(has_bytes) {
        return HEAVY_BATCH_ROWS;
    }
    let read = unit.recipe.artifacts();
    let row_bytes = read.map(|artifact| artifact.bytes / artifact.rows.max(1));
    let rows = BATCH_BYTES / row_bytes.max().unwrap_or_default().max(1);
    usize::try_from(rows).map_or(BATCH_ROWS, |rows| rows.clamp(HEAVY_BATCH_ROWS, BATCH_ROWS))
}

/// Whether rows carry bytes, which may be many.
fn has_bytes(layer: &Layer) -> bool {
    let mut columns = layer.columns.iter();
    columns.any(|column| column.data_type == DataType::Binary)
}

fn sorted(plan: Arc<dyn ExecutionPlan>, columns: &[String]) -> Arc<dyn ExecutionPlan> {
    let order = ordering(columns.iter().map(String::as_str), &plan.schema());
    let single = if plan.output_partitioning().partition_count() > 1 {
        Arc::new(CoalescePartitionsExec::new(plan))
    } else {
        plan
    };
    match order {
        Some(order) => Arc::new(SortExec::new(order, single)),
        None => single,
    }
}

/// The columns that rows of a query are ordered by: all that can be compared.
fn sortable_columns(schema: &Schema) -> Vec<String> {
    schema
        .fields()
        .iter()
        .filter(|field| !field.data_type().is_nested())
        .map(|field| field.name().clone())
        .collect()
}
