//! A unit's stages as one DataFusion plan.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use arrow::array::RecordBatch;
use arrow::compute::SortOptions;
use arrow::datatypes::{DataType, Schema, SchemaRef};
use datafusion::catalog::MemorySchemaProvider;
use datafusion::common::TableReference;
use datafusion::config::ConfigOptions;
use datafusion::execution::TaskContext;
use datafusion::logical_expr::{ident, lit};
use datafusion::physical_expr::expressions::Column;
use datafusion::physical_expr::{LexOrdering, PhysicalSortExpr};
use datafusion::physical_optimizer::PhysicalOptimizerRule;
use datafusion::physical_optimizer::ensure_requirements::EnsureRequirements;
use datafusion::physical_plan::coalesce_partitions::CoalescePartitionsExec;
use datafusion::physical_plan::sorts::sort::SortExec;
use datafusion::physical_plan::{ExecutionPlan, ExecutionPlanProperties, collect};
use datafusion::prelude::{DataFrame, SessionContext};
use evermap_contract::{Entry, LayerRow, Losses, Port, Registry, Sides, StateRow};
use evermap_datasets::{Dataset, ImageReader};
use evermap_schemas::{Fault, Layer};
use futures::FutureExt;
use futures::future::BoxFuture;

use crate::conform::conform;
use crate::error::fault_of;
use crate::map::artifact::read_artifacts;
use crate::map::receipt::Artifact;
use crate::map::store::Store;
use crate::nodes::operator::{OperatorExec, Phase, Work};
use crate::nodes::pixels::Pixels;
use crate::nodes::planned::PlannedTable;
use crate::program::{Stage, Table, Task};
use crate::sql::{BATCH_ROWS, Limits, context_with, read_only};
use crate::unit::Unit;

/// Rows per batch where rows carry bytes by the hundred kilobytes.
const HEAVY_BATCH_ROWS: usize = 64;

/// Stored bytes that a batch should hold at most.
const BATCH_BYTES: u64 = 4 << 20;

/// Decompressed chunks that one unit keeps at hand for the images in them.
const IMAGE_CACHE_BYTES: u64 = 64 << 20;

/// How much of a table a reader wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Want {
    /// The unit's session.
    Session,
    /// The unit's site.
    Site,
}

/// Builds a unit's plan and keeps what it needs while it runs.
pub struct Builder<'a> {
    unit: &'a Unit,
    store: &'a Store,
    registry: &'a Registry,
    context: SessionContext,
    opened: Vec<Dataset>,
    reader: Option<Arc<ImageReader>>,
    skipped: Arc<Mutex<Losses>>,
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
        limits: Limits,
    ) -> Result<Self, Fault> {
        let queries = unit
            .recipe
            .stages
            .iter()
            .any(|stage| matches!(stage.task, Task::Sql { .. }));
        // Floating-point sums depend on how rows are dealt out: a query has one partition, the same everywhere.
        let partitions = if queries { 1 } else { limits.partitions };
        let batch_rows = batch_rows(unit, &output_schema(unit.stage()?, registry));
        let context = context_with(
            Limits {
                partitions,
                ..limits
            },
            batch_rows,
        )?;
        context.register_object_store(store.url(), store.objects());
        let mut opened = Vec::new();
        for manifest in &unit.logs {
            let runtime = context.runtime_env();
            opened.push(Dataset::open(&runtime, &[], Some(manifest)).await?);
        }
        let dataset = joined(&opened);
        if let Some(dataset) = &dataset {
            dataset.register(&context)?;
        }
        let reader = dataset
            .as_ref()
            .map(|dataset| Arc::new(ImageReader::new(dataset, IMAGE_CACHE_BYTES)));
        Ok(Self {
            unit,
            store,
            registry,
            context,
            opened,
            reader,
            skipped: Arc::default(),
        })
    }

    /// The layer that the unit makes; `None` for a query's rows.
    pub fn layer(&self) -> Option<Layer> {
        let stage = self.unit.stage().ok()?;
        stage.layer(self.registry)
    }

    /// The context that the plan runs in.
    pub fn task_context(&self) -> Arc<TaskContext> {
        self.context.task_ctx()
    }

    /// What operators skipped.
    pub fn skipped(&self) -> BTreeMap<String, u64> {
        self.skipped
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .0
            .clone()
    }

    /// What the logs had lost.
    pub fn log_losses(&self) -> BTreeMap<String, u64> {
        let mut counted = BTreeMap::new();
        for entry in self
            .opened
            .iter()
            .flat_map(|dataset| dataset.losses.entries())
        {
            let line = format!("{}: {}", entry.file, entry.reason.text());
            *counted.entry(line).or_insert(0) += entry.loss.count;
        }
        counted
    }

    /// The unit's plan: one partition, ordered as its rows are kept.
    ///
    /// # Errors
    /// Whatever keeps it from being planned.
    pub async fn plan(&self) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let stage = self.unit.stage()?;
        let plan = self.stage(stage).await?;
        let order = match &stage.task {
            Task::Sql { ordered: true, .. } => Vec::new(),
            Task::Sql { .. } => sortable_columns(&plan.schema()),
            Task::Op { .. } => self
                .layer()
                .map(|layer| layer.key.iter().map(ToString::to_string).collect())
                .unwrap_or_default(),
        };
        self.ensure(sorted(plan, &order))
    }

    fn stage<'b>(
        &'b self,
        stage: &'b Stage,
    ) -> BoxFuture<'b, Result<Arc<dyn ExecutionPlan>, Fault>> {
        async move {
            let plan = match &stage.task {
                Task::Op {
                    op,
                    phase,
                    params,
                    inputs,
                    ..
                } => self.operator(op, *phase, params, inputs).await,
                Task::Sql { query, inputs, .. } => self.query(query, inputs).await,
            };
            plan.map_err(|fault| fault.at(format!("step {}", stage.name)))
        }
        .boxed()
    }

    async fn operator(
        &self,
        op: &str,
        phase: Phase,
        params: &serde_json::Value,
        inputs: &BTreeMap<String, Table>,
    ) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let entry = self.registry.get(op)?.clone();
        let work = |sides, pixels| {
            let losses = Arc::clone(&self.skipped);
            Arc::new(Work {
                entry: entry.clone(),
                params: params.clone(),
                phase,
                sides,
                pixels,
                losses,
            })
        };
        if phase == Phase::Merge {
            let states = self
                .port(inputs.get("states"), &StateRow::layer(), Want::Site)
                .await?;
            return Ok(Arc::new(OperatorExec::try_new(
                work(Sides::default(), None),
                states,
            )?));
        }
        let Some((driving, others)) = entry.ports.split_first() else {
            return Err(Fault::bug(format!("operator {op} has no port")));
        };
        let input = self
            .port(inputs.get(driving.name), &driving.layer, want(driving))
            .await?;
        let sides = self.sides(others, inputs).await?;
        let pixels = driving
            .pixels
            .map(|column| self.pixels(column))
            .transpose()?;
        let exec = OperatorExec::try_new(work(sides, pixels), input)?;
        self.ensure(Arc::new(exec))
    }

    fn pixels(&self, column: &'static str) -> Result<Pixels, Fault> {
        let reader = self
            .reader
            .as_ref()
            .ok_or_else(|| Fault::bug("images are asked for without logs"))?;
        Ok(Pixels::new(column, Arc::clone(reader)))
    }

    async fn port(
        &self,
        table: Option<&Table>,
        layer: &Layer,
        want: Want,
    ) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        match table {
            None => Ok(empty(layer.schema())),
            Some(table) => self.table(table, want).await,
        }
    }

    async fn sides(
        &self,
        ports: &[Port],
        inputs: &BTreeMap<String, Table>,
    ) -> Result<Sides, Fault> {
        let mut tables = BTreeMap::new();
        for port in ports {
            let Some(table) = inputs.get(port.name) else {
                continue;
            };
            let plan = self.table(table, want(port)).await?;
            let key: Vec<String> = side_order(port);
            let plan = self.ensure(sorted(plan, &key))?;
            let batches = collect(plan, self.context.task_ctx())
                .await
                .map_err(|error| fault_of(&error))?;
            let batches = batches
                .iter()
                .map(|batch| conform(batch, &port.layer))
                .collect::<Result<Vec<_>, _>>();
            tables.insert(
                port.name.to_owned(),
                batches.map_err(|fault| fault.at(format!("port {}", port.name)))?,
            );
        }
        Ok(Sides::new(tables))
    }

    /// A table's rows as a plan: a stage inside this unit, artifacts, or logs.
    async fn table(&self, table: &Table, want: Want) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        if let Some(stage) = self.inside(table) {
            return self.stage(stage).await;
        }
        let frame = self.frame(table, want).await?;
        frame
            .create_physical_plan()
            .await
            .map_err(|error| fault_of(&error))
    }

    /// The stage, where the table is made inside this unit.
    fn inside(&self, table: &Table) -> Option<&Stage> {
        let Table::Stage(name) = table else {
            return None;
        };
        let (_, inner) = self.unit.recipe.stages.split_last()?;
        inner.iter().find(|stage| stage.name == *name)
    }

    async fn frame(&self, table: &Table, want: Want) -> Result<DataFrame, Fault> {
        let (frame, artifacts, without): (_, &[Artifact], &[String]) = match table {
            Table::Log(name) => {
                let found = self.context.table(TableReference::bare(name.clone())).await;
                (found.map_err(|error| fault_of(&error))?, &[], &[])
            }
            Table::Stage(name) => {
                let artifacts = self.unit.tables.get(name).map_or(&[][..], Vec::as_slice);
                (self.artifacts(artifacts, None).await?, artifacts, &[])
            }
            Table::Previous(name) => {
                let previous = self
                    .unit
                    .previous
                    .get(name)
                    .ok_or_else(|| Fault::bug(format!("no previous {name}")))?;
                let entry = previous
                    .op
                    .as_deref()
                    .map(|op| self.registry.get(op))
                    .transpose()?;
                (
                    self.artifacts(&previous.artifacts, entry).await?,
                    previous.artifacts.as_slice(),
                    previous.without.as_slice(),
                )
            }
        };
        let frame = self.narrowed(frame, artifacts, want)?;
        if without.is_empty()
            || frame
                .schema()
                .field_with_unqualified_name("session")
                .is_err()
        {
            return Ok(frame);
        }
        let without = without.iter().map(|session| lit(session.clone())).collect();
        frame
            .filter(ident("session").in_list(without, true))
            .map_err(|error| fault_of(&error))
    }

    /// Rows of artifacts that cover more than is wanted are filtered.
    fn narrowed(
        &self,
        frame: DataFrame,
        artifacts: &[Artifact],
        want: Want,
    ) -> Result<DataFrame, Fault> {
        let recipe = &self.unit.recipe;
        let wider =
            |covered: fn(&Artifact) -> bool| artifacts.iter().any(|artifact| !covered(artifact));
        let (column, value) = match (want, &recipe.session, &recipe.site) {
            (Want::Session, Some(session), _)
                if wider(|artifact| artifact.session.is_some()) || artifacts.len() > 1 =>
            {
                ("session", session)
            }
            (_, _, Some(site)) if wider(|artifact| artifact.site.is_some()) => ("site", site),
            _ => return Ok(frame),
        };
        if frame.schema().field_with_unqualified_name(column).is_err() {
            return Ok(frame);
        }
        frame
            .filter(ident(column).eq(lit(value.clone())))
            .map_err(|error| fault_of(&error))
    }

    async fn artifacts(
        &self,
        artifacts: &[Artifact],
        entry: Option<&Entry>,
    ) -> Result<DataFrame, Fault> {
        if artifacts.is_empty() {
            let schema =
                entry.map_or_else(|| Arc::new(Schema::empty()), |entry| entry.output.schema());
            return self
                .context
                .read_batch(RecordBatch::new_empty(schema))
                .map_err(|error| fault_of(&error));
        }
        read_artifacts(&self.context, self.store, artifacts).await
    }

    async fn query(&self, query: &str, inputs: &[Table]) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let want = if self.unit.recipe.session.is_some() {
            Want::Session
        } else {
            Want::Site
        };
        let previous = Arc::new(MemorySchemaProvider::new());
        if let Some(catalog) = self.context.catalog("datafusion") {
            catalog
                .register_schema("previous", previous as _)
                .map_err(|error| fault_of(&error))?;
        }
        for table in inputs {
            let reference = match table {
                Table::Log(_) => continue,
                Table::Stage(name) => TableReference::bare(name.clone()),
                Table::Previous(name) => TableReference::partial("previous", name.clone()),
            };
            let provider = match self.inside(table) {
                Some(stage) => Arc::new(PlannedTable::new(self.stage(stage).await?)) as _,
                None => self.frame(table, want).await?.into_view(),
            };
            self.context
                .deregister_table(reference.clone())
                .map_err(|error| fault_of(&error))?;
            self.context
                .register_table(reference, provider)
                .map_err(|error| fault_of(&error))?;
        }
        let frame = read_only(&self.context, query).await?;
        frame
            .create_physical_plan()
            .await
            .map_err(|error| fault_of(&error))
    }

    /// Puts in front of operators the repartitioning and order that they need.
    fn ensure(&self, plan: Arc<dyn ExecutionPlan>) -> Result<Arc<dyn ExecutionPlan>, Fault> {
        let state = self.context.state();
        let options: &ConfigOptions = state.config_options();
        EnsureRequirements::new()
            .optimize(plan, options)
            .map_err(|error| fault_of(&error))
    }
}

/// The sessions of some datasets as one; what scans lose goes to the ledger of the first.
fn joined(opened: &[Dataset]) -> Option<Dataset> {
    let mut joined = opened.first()?.clone();
    for dataset in &opened[1..] {
        joined.sessions.extend(dataset.sessions.iter().cloned());
    }
    joined.sessions.sort_by(|a, b| a.name.cmp(&b.name));
    Some(joined)
}

fn want(port: &Port) -> Want {
    if port.grain.is_per_session() {
        Want::Session
    } else {
        Want::Site
    }
}

/// Sides are ordered by their groups first, so that a group's rows lie together, then by the layer's key.
fn side_order(port: &Port) -> Vec<String> {
    let mut order: Vec<String> = port.order().iter().map(ToString::to_string).collect();
    order.extend(
        port.layer
            .key
            .iter()
            .filter(|key| !port.order().contains(key))
            .map(ToString::to_string),
    );
    order
}

fn empty(schema: SchemaRef) -> Arc<dyn ExecutionPlan> {
    Arc::new(datafusion::physical_plan::empty::EmptyExec::new(schema))
}

fn output_schema(stage: &Stage, registry: &Registry) -> SchemaRef {
    let layer = stage.layer(registry);
    layer.map_or_else(|| Arc::new(Schema::empty()), |layer| layer.schema())
}

/// Rows per batch: few of heavy rows, whether they are made or read, so that a batch has megabytes and no more.
fn batch_rows(unit: &Unit, output: &Schema) -> usize {
    if is_heavy(output) {
        return HEAVY_BATCH_ROWS;
    }
    let previous = unit.previous.values().flat_map(|layer| &layer.artifacts);
    let row_bytes = unit
        .tables
        .values()
        .flatten()
        .chain(previous)
        .map(|artifact| artifact.bytes / artifact.rows.max(1))
        .max();
    let rows = BATCH_BYTES / row_bytes.unwrap_or_default().max(1);
    usize::try_from(rows).map_or(BATCH_ROWS, |rows| rows.clamp(HEAVY_BATCH_ROWS, BATCH_ROWS))
}

fn is_heavy(schema: &Schema) -> bool {
    schema
        .fields()
        .iter()
        .any(|field| *field.data_type() == DataType::Binary)
}

fn sorted(plan: Arc<dyn ExecutionPlan>, columns: &[String]) -> Arc<dyn ExecutionPlan> {
    let schema = plan.schema();
    let order = columns.iter().filter_map(|name| {
        let column = Column::new_with_schema(name, &schema).ok()?;
        Some(PhysicalSortExpr::new(
            Arc::new(column),
            SortOptions {
                descending: false,
                nulls_first: true,
            },
        ))
    });
    let single: Arc<dyn ExecutionPlan> = if plan.output_partitioning().partition_count() > 1 {
        Arc::new(CoalescePartitionsExec::new(Arc::clone(&plan)))
    } else {
        plan
    };
    match LexOrdering::new(order) {
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
