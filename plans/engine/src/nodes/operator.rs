//! The one plan node that runs every operator.
//!
//! It says what the operator's shape needs (hash partitioning, order) and DataFusion's optimizer puts that in front of
//! it. Its first child drives; the others are its sides, each collected once, from which the job is prepared that all
//! partitions share. Rows cross from the async side to a blocking thread, the kernel runs inside the process's one CPU
//! pool, and what it emits crosses back. Nothing is sent while inside the pool, so that operators stacked on each
//! other cannot block it.
//!
//! ```text
//!  sides ─► conform ─► memory reservation ─► Job, in the CPU pool, once
//!                    └► row store (`row_store`), where rows are fetched one at a time
//!                                             │
//!  driving rows ─► conform ─► │channel│ ─► Worker, in the CPU pool ─► │channel│ ─► output stream
//!        (async threads)                     (blocking thread)
//! ```

use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use arrow::array::RecordBatch;
use datafusion::common::utils::memory::get_record_batch_memory_size;
use datafusion::error::Result as DataFusionResult;
use datafusion::execution::memory_pool::{MemoryConsumer, MemoryReservation};
use datafusion::execution::runtime_env::RuntimeEnv;
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::EquivalenceProperties;
use datafusion::physical_plan::metrics::{
    BaselineMetrics, Count, MetricBuilder, RecordOutput, Time,
};
use datafusion::physical_plan::stream::RecordBatchReceiverStreamBuilder;
use datafusion::physical_plan::{ExecutionPlan, ExecutionPlanProperties, Partitioning};
use evermap_contract::{Driving, Emit, Entry, Job, Losses, Phase, Port, Sides, pixels_column};
use evermap_schemas::Fault;
use futures::future::{BoxFuture, Shared};
use futures::{FutureExt, StreamExt};
use rayon::ThreadPool;
use serde_json::Value;
use tokio::sync::{mpsc, oneshot};

use crate::conform::{beside, conform};
use crate::error::{OrFault, external};
use crate::locked::locked;
use crate::nodes::node::{Deal, Duty, Need, Node, first};
use crate::nodes::row_store::{Filled, RowWriter};

/// Batches waiting on either side of a kernel.
const QUEUE: usize = 2;

/// Runs an operator over its driving rows.
pub type OperatorExec = Node<Operator>;

/// An operator with its parameters: the driving rows are the first child, then the sides.
pub struct Operator {
    entry: Entry,
    params: Value,
    phase: Phase,
    driving: Driving,
    /// The ports of the sides, in the order of the children.
    sides: Vec<Port>,
    losses: Arc<Mutex<Losses>>,
}

impl Operator {
    /// A phase of an operator with complete parameters; `sides` are the ports that are connected. What it skips is
    /// counted in `losses`.
    pub fn new(
        entry: &Entry,
        params: &Value,
        phase: Phase,
        sides: Vec<Port>,
        losses: Arc<Mutex<Losses>>,
    ) -> Self {
        Self {
            entry: entry.clone(),
            params: params.clone(),
            phase,
            driving: entry.driving(phase),
            sides,
            losses,
        }
    }

    /// The operator's name.
    pub fn name(&self) -> &str {
        self.entry.name
    }

    /// The ports of the children, in their order.
    pub fn ports(&self) -> impl Iterator<Item = &Port> {
        std::iter::once(&self.driving.port).chain(&self.sides)
    }
}

impl fmt::Display for Operator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, phase, params) = (self.entry.name, self.phase, &self.params);
        let sides: Vec<_> = self.sides.iter().map(|port| port.name).collect();
        let (driving, sides) = (self.driving.port.name, sides.join(", "));
        write!(
            f,
            "operator={name}, phase={phase:?}, driving={driving}, sides=[{sides}], params={params}"
        )
    }
}

impl Duty for Operator {
    const NAME: &'static str = "OperatorExec";
    type Shared = OnceLock<Preparing>;

    fn needs(&self) -> Vec<Need> {
        let driving = Need {
            deal: Deal::ByKey(self.driving.group),
            sorting: self.driving.sorting.clone(),
            // Rows with images were dealt out before the images were fetched.
            parallel: self.driving.port.pixels.is_none(),
        };
        let sides = self.sides.iter().map(|port| Need::whole(port.sorting()));
        std::iter::once(driving).chain(sides).collect()
    }

    fn output(
        &self,
        children: &[Arc<dyn ExecutionPlan>],
    ) -> DataFusionResult<(EquivalenceProperties, Partitioning)> {
        let partitions = first(children)?.output_partitioning().partition_count();
        let schema = self.entry.yields(self.phase).schema();
        Ok((
            EquivalenceProperties::new(schema),
            Partitioning::UnknownPartitioning(partitions),
        ))
    }

    fn execute(
        node: &OperatorExec,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> DataFusionResult<SendableRecordBatchStream> {
        let input = first(&node.children)?.execute(partition, Arc::clone(&context))?;
        let mut output = RecordBatchReceiverStreamBuilder::new(node.schema(), QUEUE);
        let (feed, rows) = mpsc::channel(QUEUE);
        let (ready, prepared) = oneshot::channel();
        output.spawn(feed_rows(
            Arc::clone(&node.duty),
            node.prepared(context),
            ready,
            input,
            feed,
        ));
        let outlet = Outlet {
            operator: Arc::clone(&node.duty),
            sender: output.tx(),
            metrics: BaselineMetrics::new(&node.metrics, partition),
            done: MetricBuilder::new(&node.metrics).counter(DRIVING_ROWS, partition),
        };
        let (name, phase) = (node.duty.entry.name, node.duty.phase);
        let span = tracing::info_span!("operator", name, ?phase, partition);
        output.spawn_blocking(move || {
            let _entered = span.enter();
            let prepared = prepared.blocking_recv().unwrap_or_else(|_| Err(gone()));
            prepared
                .and_then(|prepared| drive(&prepared.job, rows, &outlet))
                .map_err(external)
        });
        Ok(output.build())
    }
}

/// A job being prepared; every partition waits for the same.
pub type Preparing = Shared<BoxFuture<'static, Result<Arc<Prepared>, Fault>>>;

/// A job, and the memory that its sides hold as long as it runs.
pub struct Prepared {
    job: Job,
    _memory: MemoryReservation,
}

/// What is told of the sides.
struct SideMetrics {
    rows: Count,
    bytes: Count,
    /// Those in temporary files, beside them.
    file_bytes: Count,
    collecting: Time,
    preparing: Time,
}

impl OperatorExec {
    fn prepared(&self, context: Arc<TaskContext>) -> Preparing {
        let begin = || {
            let builder = || MetricBuilder::new(&self.metrics);
            let metrics = SideMetrics {
                rows: builder().global_counter("side_rows"),
                bytes: builder().global_counter("side_bytes"),
                file_bytes: builder().global_counter("side_file_bytes"),
                collecting: builder().subset_time("side_time", 0),
                preparing: builder().subset_time("prepare_time", 0),
            };
            let tables = self.children.iter().skip(1).cloned().collect();
            prepare(Arc::clone(&self.duty), tables, context, metrics)
                .boxed()
                .shared()
        };
        self.shared.get_or_init(begin).clone()
    }
}

/// Collects the sides and prepares the job.
async fn prepare(
    operator: Arc<Operator>,
    tables: Vec<Arc<dyn ExecutionPlan>>,
    context: Arc<TaskContext>,
    metrics: SideMetrics,
) -> Result<Arc<Prepared>, Fault> {
    let memory = MemoryConsumer::new(format!("sides of {}", operator.entry.name))
        .register(context.memory_pool());
    let runtime = context.runtime_env();
    let mut sides = Sides::default();
    // Rows that may go to a disk take the memory that the others leave.
    let all = operator.sides.iter().zip(tables);
    let (fetched, whole): (Vec<_>, Vec<_>) = all.partition(|(port, _)| port.fetched);
    for (port, table) in whole.into_iter().chain(fetched) {
        let _timer = metrics.collecting.timer();
        let rows = table.execute(0, Arc::clone(&context)).or_fault()?;
        let place = |fault: Fault| fault.at(format!("port {}", port.name));
        if port.fetched {
            let filled = write_rows(port, rows, &memory, &runtime).await;
            let filled = filled.map_err(place)?;
            metrics.rows.add(rows_in(&filled.catalogue));
            metrics.file_bytes.add(filled.file_bytes as usize);
            sides.store(port.name, filled.catalogue, filled.store);
        } else {
            let rows = collect(port, rows, &memory).await.map_err(place)?;
            metrics.rows.add(rows_in(&rows));
            sides.add(port.name, rows);
        }
    }
    metrics.bytes.add(memory.size());
    let timed = metrics.preparing;
    let job = in_pool(move || {
        let _timer = timed.timer();
        let Operator { entry, params, .. } = operator.as_ref();
        Job::new(entry, params, operator.phase, sides)
    });
    Ok(Arc::new(Prepared {
        job: job.await?,
        _memory: memory,
    }))
}

fn rows_in(batches: &[RecordBatch]) -> usize {
    batches.iter().map(RecordBatch::num_rows).sum()
}

async fn collect(
    port: &Port,
    mut table: SendableRecordBatchStream,
    memory: &MemoryReservation,
) -> Result<Vec<RecordBatch>, Fault> {
    let mut rows = Vec::new();
    while let Some(batch) = table.next().await {
        let batch = given(&batch.or_fault()?, port)?;
        memory
            .try_grow(get_record_batch_memory_size(&batch))
            .or_fault()?;
        rows.push(batch);
    }
    Ok(rows)
}

async fn write_rows(
    port: &Port,
    mut table: SendableRecordBatchStream,
    memory: &MemoryReservation,
    runtime: &RuntimeEnv,
) -> Result<Filled, Fault> {
    let mut writer = RowWriter::new(memory, runtime);
    while let Some(batch) = table.next().await {
        writer.push(given(&batch.or_fault()?, port)?)?;
    }
    writer.finish()
}

/// The batch with just what a port reads: the columns of its layer, and the images beside them.
fn given(batch: &RecordBatch, port: &Port) -> Result<RecordBatch, Fault> {
    let rows = conform(batch, &port.layer)?;
    let Some(column) = port.pixels else {
        return Ok(rows);
    };
    let name = pixels_column(column);
    let images = batch.column_by_name(&name).cloned();
    let images = images.ok_or_else(|| Fault::bug(format!("no column {name}")))?;
    beside(&rows, &name, images)
}

/// Waits for the job, then hands on the driving rows as the kernel wants them.
async fn feed_rows(
    operator: Arc<Operator>,
    prepared: Preparing,
    ready: oneshot::Sender<Result<Arc<Prepared>, Fault>>,
    mut input: SendableRecordBatchStream,
    feed: mpsc::Sender<Result<RecordBatch, Fault>>,
) -> DataFusionResult<()> {
    let prepared = prepared.await;
    let wanted = prepared
        .as_ref()
        .is_ok_and(|prepared| !prepared.job.is_idle());
    if ready.send(prepared).is_err() || !wanted {
        return Ok(());
    }
    while let Some(batch) = input.next().await {
        let batch = batch.or_fault();
        let rows = batch.and_then(|batch| given(&batch, &operator.driving.port));
        if feed.send(rows).await.is_err() {
            break;
        }
    }
    Ok(())
}

/// The worker's life, on a blocking thread.
fn drive(
    job: &Job,
    mut rows: mpsc::Receiver<Result<RecordBatch, Fault>>,
    outlet: &Outlet,
) -> Result<(), Fault> {
    let mut worker = job.worker();
    let (mut taken, mut done) = (0, 0);
    while let Some(batch) = rows.blocking_recv().transpose()? {
        outlet.run(&|_| (), |emit| worker.push(&batch, emit))?;
        taken += batch.num_rows();
        let now = taken.saturating_sub(worker.held()).max(done);
        outlet.done.add(now - done);
        done = now;
    }
    let tell = telling(&outlet.done, taken - done);
    outlet.run(&tell, |emit| worker.close(emit))?;
    tell(1.0);
    Ok(())
}

/// Counts so many rows as the share of them grows that a kernel says that it is done with.
fn telling(done: &Count, rows: usize) -> impl Fn(f64) + Sync {
    let told = AtomicUsize::new(0);
    move |share| {
        let now = (share.clamp(0.0, 1.0) * rows as f64) as usize;
        let before = told.fetch_max(now, Ordering::Relaxed);
        done.add(now.saturating_sub(before));
    }
}

/// The metric that counts driving rows that a kernel is done with.
pub const DRIVING_ROWS: &str = "driving_rows";

struct Outlet {
    operator: Arc<Operator>,
    sender: mpsc::Sender<DataFusionResult<RecordBatch>>,
    metrics: BaselineMetrics,
    /// Driving rows that the kernel is done with; those of a key that is taken whole, when it is done with the key, or as it
    /// tells.
    done: Count,
}

impl Outlet {
    /// Runs a piece of kernel in the CPU pool, which may tell how far it has come, then hands on what it emitted.
    fn run(
        &self,
        tell: &(dyn Fn(f64) + Sync),
        piece: impl FnOnce(&mut Emit<'_>) -> Result<(), Fault> + Send,
    ) -> Result<(), Fault> {
        let timer = self.metrics.elapsed_compute().timer();
        let (done, emitted, losses) = cpu_pool()?.install(|| {
            let (mut emitted, mut losses) = (Vec::new(), Losses::default());
            let mut collect = |batch: RecordBatch| {
                emitted.push(batch);
                Ok(())
            };
            let done = piece(&mut Emit::new(&mut collect, &mut losses).told(tell));
            (done, emitted, losses)
        });
        timer.done();
        locked(&self.operator.losses).merge(&losses);
        done?;
        emitted.into_iter().try_for_each(|batch| {
            let batch = batch.record_output(&self.metrics);
            self.sender.blocking_send(Ok(batch)).map_err(|_| gone())
        })
    }
}

/// The reader went away: stop, without an error of our own.
fn gone() -> Fault {
    Fault::resource("the reader of an operator's rows has gone")
}

/// Runs work in the CPU pool, off the async threads.
async fn in_pool<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Fault> + Send + 'static,
) -> Result<T, Fault> {
    let pool = cpu_pool()?;
    tokio::task::spawn_blocking(|| pool.install(work))
        .await
        .map_err(|error| Fault::bug(format!("an operator panicked: {error}")))?
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_a_key_count_as_its_kernel_tells_and_once() {
        let done = Count::new();
        let tell = telling(&done, 10);
        let counted = [0.25, 0.5, 0.1, f64::NAN, 7.0, 1.0].map(|share| {
            tell(share);
            done.value()
        });
        assert_eq!(counted, [2, 5, 5, 5, 10, 10]);
    }
}
