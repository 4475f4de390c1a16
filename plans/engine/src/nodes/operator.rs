//! The one `ExecutionPlan` that runs every operator.
//!
//! It says what the kernel's grain needs (hash partitioning, order) and DataFusion's optimizer puts that in front of
//! it. Rows cross from the async side to a blocking thread, the kernel runs inside the process's one CPU pool, and
//! what it emits crosses back. Nothing is sent while inside the pool, so that operators stacked on each other cannot
//! block it.
//!
//! ```text
//!  input stream ─► conform to the port ─► fetch pixels ─►│channel│─► kernel in CPU pool ─►│channel│─► output stream
//!        (async threads)                                       (blocking thread)
//! ```

use std::fmt;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use arrow::array::RecordBatch;
use arrow::compute::SortOptions;
use datafusion::common::tree_node::TreeNodeRecursion;
use datafusion::error::{DataFusionError, Result as DataFusionResult};
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::expressions::Column;
use datafusion::physical_expr::{
    Distribution, EquivalenceProperties, LexOrdering, OrderingRequirements, PhysicalExpr,
    PhysicalSortExpr,
};
use datafusion::physical_plan::execution_plan::{Boundedness, EmissionType};
use datafusion::physical_plan::stream::RecordBatchReceiverStreamBuilder;
use datafusion::physical_plan::{
    DisplayAs, DisplayFormatType, ExecutionPlan, ExecutionPlanProperties,
    InputDistributionRequirements, Partitioning, PlanProperties,
};
use evermap_contract::{
    Emit, Entry, Grain, Kernel, LayerRow, Losses, Port, Sides, StateRow, runs_of_equal, same_group,
};
use evermap_schemas::{Fault, rows};
use futures::{StreamExt, TryStreamExt};
use rayon::ThreadPool;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::sync::mpsc;

use crate::conform::conform;
use crate::error::{external, fault_of};
use crate::nodes::pixels::Pixels;

/// States that a lift may hold before it passes them on.
const STATE_BUDGET_BYTES: usize = 256 << 20;

/// Batches waiting on either side of a kernel.
const QUEUE: usize = 2;

/// Which part of an operator's work a plan node does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// All of it: Map and Group.
    Run,
    /// A fold's rows to states.
    Lift,
    /// A fold's states to rows.
    Merge,
}

/// An operator with its parameters and everything it reads besides its driving rows.
pub struct Work {
    /// The operator.
    pub entry: Entry,
    /// Its parameters, complete.
    pub params: Value,
    /// The part of it to do.
    pub phase: Phase,
    /// The tables of its other ports.
    pub sides: Sides,
    /// Fetches the images of the driving port, where it asks for them.
    pub pixels: Option<Pixels>,
    /// Where losses are counted.
    pub losses: Arc<Mutex<Losses>>,
}

impl Work {
    /// The layer whose rows come out.
    fn output(&self) -> evermap_schemas::Layer {
        if self.phase == Phase::Lift {
            StateRow::layer()
        } else {
            self.entry.output.clone()
        }
    }

    /// What drives this phase: the first port, or the states of a fold.
    fn driving(&self) -> Result<Port, Fault> {
        const STATES: Grain = Grain::Key {
            columns: &["site", "key"],
            order: &[],
        };
        match self.phase {
            Phase::Merge => Ok(Port::of::<StateRow>("states", STATES)),
            Phase::Run | Phase::Lift => self
                .entry
                .ports
                .first()
                .cloned()
                .ok_or_else(|| Fault::bug("an operator has no port")),
        }
    }
}

/// Runs an operator over its driving rows.
pub struct OperatorExec {
    work: Arc<Work>,
    driving: Port,
    input: Arc<dyn ExecutionPlan>,
    properties: Arc<PlanProperties>,
}

impl OperatorExec {
    /// A node over `input`, which has at least the driving port's columns.
    ///
    /// # Errors
    /// A bug fault for an operator without ports.
    pub fn try_new(work: Arc<Work>, input: Arc<dyn ExecutionPlan>) -> Result<Self, Fault> {
        let driving = work.driving()?;
        let properties = PlanProperties::new(
            EquivalenceProperties::new(work.output().schema()),
            Partitioning::UnknownPartitioning(input.output_partitioning().partition_count()),
            EmissionType::Incremental,
            Boundedness::Bounded,
        );
        Ok(Self {
            work,
            driving,
            input,
            properties: Arc::new(properties),
        })
    }

    fn column(&self, name: &str) -> Option<Arc<dyn PhysicalExpr>> {
        Column::new_with_schema(name, &self.input.schema())
            .ok()
            .map(|column| Arc::new(column) as _)
    }
}

impl fmt::Debug for OperatorExec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "OperatorExec({}, {:?})",
            self.work.entry.name, self.work.phase
        )
    }
}

impl DisplayAs for OperatorExec {
    fn fmt_as(&self, _: DisplayFormatType, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "OperatorExec: operator={}, phase={:?}, params={}",
            self.work.entry.name, self.work.phase, self.work.params
        )
    }
}

impl ExecutionPlan for OperatorExec {
    fn name(&self) -> &str {
        "OperatorExec"
    }

    fn properties(&self) -> &Arc<PlanProperties> {
        &self.properties
    }

    fn children(&self) -> Vec<&Arc<dyn ExecutionPlan>> {
        vec![&self.input]
    }

    fn input_distribution_requirements(&self) -> InputDistributionRequirements {
        let key: Vec<_> = self
            .driving
            .grain
            .group_columns()
            .iter()
            .filter_map(|name| self.column(name))
            .collect();
        let distribution = if key.is_empty() {
            Distribution::UnspecifiedDistribution
        } else {
            Distribution::KeyPartitioned(key)
        };
        InputDistributionRequirements::new(vec![distribution])
    }

    fn required_input_ordering(&self) -> Vec<Option<OrderingRequirements>> {
        let columns = self.driving.order();
        let order = columns.iter().filter_map(|name| {
            Some(PhysicalSortExpr::new(
                self.column(name)?,
                SortOptions {
                    descending: false,
                    nulls_first: true,
                },
            ))
        });
        vec![LexOrdering::new(order).map(OrderingRequirements::from)]
    }

    fn apply_expressions(
        &self,
        _: &mut dyn FnMut(&Arc<dyn PhysicalExpr>) -> DataFusionResult<TreeNodeRecursion>,
    ) -> DataFusionResult<TreeNodeRecursion> {
        Ok(TreeNodeRecursion::Continue)
    }

    fn with_new_children(
        self: Arc<Self>,
        mut children: Vec<Arc<dyn ExecutionPlan>>,
    ) -> DataFusionResult<Arc<dyn ExecutionPlan>> {
        let input = children
            .pop()
            .ok_or_else(|| DataFusionError::Internal("OperatorExec has one child".into()))?;
        Ok(Arc::new(
            Self::try_new(Arc::clone(&self.work), input).map_err(external)?,
        ))
    }

    fn execute(
        &self,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> DataFusionResult<SendableRecordBatchStream> {
        let input = self.input.execute(partition, context)?;
        let (work, port) = (Arc::clone(&self.work), self.driving.clone());
        let mut output = RecordBatchReceiverStreamBuilder::new(self.schema(), QUEUE);
        let (feed, rows) = mpsc::channel(QUEUE);
        let feeder_work = Arc::clone(&work);
        output.spawn(async move {
            let mut ready = std::pin::pin!(fed(input, feeder_work, port));
            while let Some(batch) = ready.next().await {
                if feed.send(batch).await.is_err() {
                    break;
                }
            }
            Ok(())
        });
        let sender = output.tx();
        let span = tracing::info_span!("operator", name = self.work.entry.name, phase = ?self.work.phase, partition);
        output.spawn_blocking(move || {
            let _entered = span.enter();
            let outlet = Outlet { sender };
            drive(&work, rows, &outlet).map_err(external)
        });
        Ok(output.build())
    }
}

/// The driving rows as the kernel wants them: conformed to the port, with pixels, one batch ahead of the kernel.
fn fed(
    input: SendableRecordBatchStream,
    work: Arc<Work>,
    port: Port,
) -> impl futures::Stream<Item = Result<RecordBatch, Fault>> + Send {
    let conformed = input
        .map_err(|error| fault_of(&error))
        .map(move |batch| conform(&batch?, &port.layer));
    let pixel_work = Arc::clone(&work);
    conformed
        .map_ok(move |batch| match &pixel_work.pixels {
            Some(pixels) => {
                futures::stream::iter(pixels.slices(&batch).into_iter().map(Ok)).left_stream()
            }
            None => futures::stream::iter([Ok(batch)]).right_stream(),
        })
        .try_flatten()
        .map(move |batch| {
            let work = Arc::clone(&work);
            async move {
                match &work.pixels {
                    Some(pixels) => pixels.resolve(batch?, &work.losses).await,
                    None => batch,
                }
            }
        })
        .buffered(QUEUE)
}

/// The process's CPU pool: kernels run here and nowhere else.
fn cpu_pool() -> Result<&'static ThreadPool, Fault> {
    static POOL: OnceLock<Result<ThreadPool, String>> = OnceLock::new();
    POOL.get_or_init(|| {
        rayon::ThreadPoolBuilder::new()
            .thread_name(|index| format!("kernel-{index}"))
            .build()
            .map_err(|error| error.to_string())
    })
    .as_ref()
    .map_err(|error| Fault::resource(format!("the CPU pool does not start: {error}")))
}

struct Outlet {
    sender: mpsc::Sender<DataFusionResult<RecordBatch>>,
}

/// The reader went away: stop, without an error of our own.
fn gone() -> Fault {
    Fault::resource("the reader of an operator's rows has gone")
}

impl Outlet {
    /// Runs a piece of kernel in the CPU pool, then hands on what it emitted.
    fn run(
        &self,
        work: &Work,
        piece: impl FnOnce(&mut Emit<'_>) -> Result<(), Fault> + Send,
    ) -> Result<(), Fault> {
        let (done, emitted, losses) = cpu_pool()?.install(|| {
            let (mut emitted, mut losses) = (Vec::new(), Losses::default());
            let mut collect = |batch: RecordBatch| {
                emitted.push(batch);
                Ok(())
            };
            let done = piece(&mut Emit::new(&mut collect, &mut losses));
            (done, emitted, losses)
        });
        work.losses
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .merge(&losses);
        done?;
        emitted
            .into_iter()
            .try_for_each(|batch| self.sender.blocking_send(Ok(batch)).map_err(|_| gone()))
    }
}

type Rows = mpsc::Receiver<Result<RecordBatch, Fault>>;

/// The kernel's life, on a blocking thread: open, rows, close.
fn drive(work: &Work, mut rows: Rows, outlet: &Outlet) -> Result<(), Fault> {
    match (work.entry.kernel(&work.params)?, work.phase) {
        (Kernel::Map(kernel), _) => {
            let mapper = kernel.open(&work.sides)?;
            while let Some(batch) = rows.blocking_recv().transpose()? {
                outlet.run(work, |emit| mapper.map(&batch, emit))?;
            }
            Ok(())
        }
        (Kernel::Group(kernel), _) => drive_groups(work, kernel.as_ref(), rows, outlet),
        (Kernel::Fold(kernel), Phase::Lift) => {
            let mut lifter = kernel.lifter(&work.sides, STATE_BUDGET_BYTES);
            while let Some(batch) = rows.blocking_recv().transpose()? {
                outlet.run(work, |emit| lifter.push(&batch, emit))?;
            }
            outlet.run(work, |emit| lifter.close(emit))
        }
        (Kernel::Fold(kernel), _) => drive_merge(work, kernel.as_ref(), rows, outlet),
    }
}

fn drive_groups(
    work: &Work,
    kernel: &dyn evermap_contract::GroupKernel,
    mut rows: Rows,
    outlet: &Outlet,
) -> Result<(), Fault> {
    let Some((driving, others)) = work.entry.ports.split_first() else {
        return Ok(());
    };
    let columns = driving.grain.group_columns();
    let mut open: Option<(RecordBatch, Box<dyn evermap_contract::Group>)> = None;
    while let Some(batch) = rows.blocking_recv().transpose()? {
        for run in runs_of_equal(&batch, columns)? {
            let same = open
                .as_ref()
                .is_some_and(|(first, _)| same_group(first, &run, columns));
            if !same {
                if let Some((_, mut finished)) = open.take() {
                    outlet.run(work, |emit| finished.close(emit))?;
                }
                open = Some((
                    run.slice(0, 1),
                    kernel.open(&work.sides.belonging(others, &run)?)?,
                ));
            }
            if let Some((_, group)) = open.as_mut() {
                outlet.run(work, |emit| group.push(&run, emit))?;
            }
        }
    }
    match open {
        Some((_, mut last)) => outlet.run(work, |emit| last.close(emit)),
        None => Ok(()),
    }
}

/// Merges the states of each key as they come, ordered by key, and finishes a key when the next one begins.
fn drive_merge(
    work: &Work,
    kernel: &dyn evermap_contract::FoldKernel,
    mut input: Rows,
    outlet: &Outlet,
) -> Result<(), Fault> {
    let mut open: Option<StateRow> = None;
    while let Some(batch) = input.blocking_recv().transpose()? {
        for next in rows::<StateRow>(&batch)? {
            open = Some(match open.take() {
                Some(mut held) if held.site == next.site && held.key == next.key => {
                    held.state = kernel.merge(vec![held.state, next.state])?;
                    held
                }
                Some(finished) => {
                    finish(work, kernel, finished, outlet)?;
                    next
                }
                None => next,
            });
        }
    }
    open.map_or(Ok(()), |last| finish(work, kernel, last, outlet))
}

fn finish(
    work: &Work,
    kernel: &dyn evermap_contract::FoldKernel,
    StateRow { site, key, state }: StateRow,
    outlet: &Outlet,
) -> Result<(), Fault> {
    outlet.run(work, |emit| kernel.finish(&site, &key, state, emit))
}
