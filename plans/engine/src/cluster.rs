//! Many machines: Ballista runs the units.
//!
//! A wave of ready units is one map-only job: a `UnitExec` over an in-memory manifest with one partition a unit.
//! Nothing is shuffled, and Ballista's answer is not what counts: a unit is done when its receipt is in the map store.
//! So a lost executor, a hung job or a restarted scheduler costs a resubmission of what is missing, and can never
//! change an answer.
//!
//! ```text
//!   ready units ──► job ──► executors ──► artifacts, receipts ──► map store
//!        ▲                                                            │ polled
//!        └────────── resubmit what is missing ◄── job ended or hung ◄─┘
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use arrow::array::{ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use ballista_core::config::{BallistaConfig, TaskSchedulingPolicy};
use ballista_core::execution_plans::execute_physical_plan;
use ballista_core::extension::SessionConfigExt;
use ballista_core::registry::BallistaFunctionRegistry;
use ballista_core::serde::protobuf::scheduler_grpc_client::SchedulerGrpcClient;
use ballista_core::serde::{BallistaLogicalExtensionCodec, BallistaPhysicalExtensionCodec};
use ballista_executor::executor_process::{ExecutorProcessConfig, start_executor_process};
use ballista_scheduler::cluster::BallistaCluster;
use ballista_scheduler::config::SchedulerConfig;
use ballista_scheduler::scheduler_process::start_server;
use datafusion::common::tree_node::TreeNodeRecursion;
use datafusion::datasource::memory::MemorySourceConfig;
use datafusion::error::{DataFusionError, Result as DataFusionResult};
use datafusion::execution::{
    SendableRecordBatchStream, SessionState, SessionStateBuilder, TaskContext,
};
use datafusion::physical_expr::{EquivalenceProperties, PhysicalExpr};
use datafusion::physical_plan::execution_plan::{Boundedness, EmissionType};
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::{
    DisplayAs, DisplayFormatType, ExecutionPlan, ExecutionPlanProperties, Partitioning,
    PlanProperties,
};
use datafusion::prelude::SessionConfig;
use datafusion_proto::physical_plan::{PhysicalExtensionCodec, PhysicalProtoConverterExtension};
use datafusion_proto::protobuf::PhysicalPlanNode;
use evermap_contract::Registry;
use evermap_schemas::{Fault, Kind};
use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use tokio::sync::mpsc;

use crate::error::{external, fault_of};
use crate::runner::{Outcome, Runner};
use crate::store::Store;
use crate::unit::{Receipt, Unit};

/// How often the map store is asked for receipts.
const POLL: Duration = Duration::from_millis(300);

/// How often a wave is submitted before what is missing is given up.
const ATTEMPTS: usize = 6;

/// Runs units on a Ballista cluster.
pub struct ClusterRunner {
    scheduler: String,
    registry: Registry,
    deadline: Duration,
    width: usize,
}

impl ClusterRunner {
    /// Runs units on the cluster of the scheduler at `url` (`http://host:port`). A job in which no unit ends for
    /// `deadline` counts as hung: what is missing is submitted anew.
    pub fn new(url: &str, registry: Registry, deadline: Duration) -> Self {
        let scheduler = match url.split_once("://") {
            Some((_, address)) => format!("http://{address}"),
            None => format!("http://{url}"),
        };
        Self {
            scheduler,
            registry,
            deadline,
            width: 16,
        }
    }

    /// Starts a scheduler and an executor inside this process, and runs units on them.
    ///
    /// # Errors
    /// A resource fault when they do not start.
    pub async fn in_process(
        registry: Registry,
        slots: usize,
        deadline: Duration,
    ) -> Result<Self, Fault> {
        let state = session_state(session_config(&registry));
        let address = ballista_scheduler::standalone::new_standalone_scheduler_from_state(&state)
            .await
            .map_err(|error| cluster_fault(&error, "the scheduler does not start"))?;
        let url = format!("http://127.0.0.1:{}", address.port());
        let client = SchedulerGrpcClient::connect(url.clone())
            .await
            .map_err(|error| cluster_fault(&error, "the scheduler does not answer"))?;
        ballista_executor::new_standalone_executor_from_state(client, slots.max(1), &state)
            .await
            .map_err(|error| cluster_fault(&error, "the executor does not start"))?;
        Ok(Self {
            scheduler: url,
            registry,
            deadline,
            width: slots.max(1),
        })
    }
}

fn cluster_fault(error: &dyn fmt::Display, what: &str) -> Fault {
    let text = error.to_string();
    Fault::parse(&text).unwrap_or_else(|| Fault::resource(format!("{what}: {text}")))
}

impl Runner for ClusterRunner {
    fn start(&self, units: Vec<(usize, Unit)>) -> BoxStream<'static, Outcome> {
        let (sender, receiver) = mpsc::unbounded_channel();
        let wave = Wave {
            scheduler: self.scheduler.clone(),
            registry: self.registry.clone(),
            deadline: self.deadline,
            outcomes: sender,
        };
        tokio::spawn(wave.run(units));
        tokio_stream(receiver)
    }

    fn width(&self) -> usize {
        self.width
    }
}

fn tokio_stream(mut receiver: mpsc::UnboundedReceiver<Outcome>) -> BoxStream<'static, Outcome> {
    futures::stream::poll_fn(move |context| receiver.poll_recv(context)).boxed()
}

/// One wave of units, from submission to the last outcome.
struct Wave {
    scheduler: String,
    registry: Registry,
    deadline: Duration,
    outcomes: mpsc::UnboundedSender<Outcome>,
}

type Missing = BTreeMap<usize, Unit>;

impl Wave {
    async fn run(self, units: Vec<(usize, Unit)>) {
        let mut missing: Missing = units.into_iter().collect();
        let mut reason = Fault::resource("the cluster did nothing");
        for attempt in 0..ATTEMPTS {
            if missing.is_empty() {
                return;
            }
            if attempt > 0 {
                tracing::warn!(missing = missing.len(), %reason, "submitting anew what is missing");
                tokio::time::sleep(POLL * (1 << attempt.min(5))).await;
            }
            if let Err(fault) = self.attempt(&mut missing).await {
                reason = fault;
            }
        }
        for (index, _) in missing {
            let fault = Fault::new(
                reason.kind,
                format!("{}, after {ATTEMPTS} attempts", reason.message),
            )
            .next("look at the executors' logs, then run again: what was computed is kept");
            let _ = self.outcomes.send((index, Err(fault)));
        }
    }

    /// Submits one job and follows it until it ends, or nothing has ended for as long as the deadline.
    async fn attempt(&self, missing: &mut Missing) -> Result<(), Fault> {
        let order: Vec<usize> = missing.keys().copied().collect();
        let plan = job(missing.values())?;
        let submitted = submit(self.scheduler.clone(), plan, self.registry.clone());
        let mut job = std::pin::pin!(submitted);
        let mut progress = Instant::now();
        let ended = loop {
            match tokio::time::timeout(POLL, &mut job).await {
                Ok(ended) => break ended,
                Err(_) => {
                    if self.collect(missing).await? > 0 {
                        progress = Instant::now();
                    }
                    if missing.is_empty() {
                        return Ok(());
                    }
                    if progress.elapsed() > self.deadline {
                        let waited = self.deadline.as_secs();
                        return Err(Fault::resource(format!(
                            "no unit of a job ended for {waited} s"
                        )));
                    }
                }
            }
        };
        self.collect(missing).await?;
        for (row, fault) in ended? {
            if let Some(unit) = order
                .get(row)
                .and_then(|index| missing.remove(index).map(|unit| (*index, unit)))
            {
                let _ = self.outcomes.send((unit.0, Err(fault)));
            }
        }
        if missing.is_empty() {
            Ok(())
        } else {
            Err(Fault::resource("a job ended without all its receipts"))
        }
    }

    /// Takes the receipts that have come in; how many there were.
    async fn collect(&self, missing: &mut Missing) -> Result<usize, Fault> {
        let mut found = Vec::new();
        for (index, unit) in missing.iter() {
            let store = Store::open(&unit.store, false)?;
            if let Some(receipt) = Receipt::find(&store, &unit.recipe.digest()?).await? {
                found.push((*index, receipt));
            }
        }
        let count = found.len();
        for (index, receipt) in found {
            missing.remove(&index);
            let _ = self.outcomes.send((index, Ok(receipt)));
        }
        Ok(count)
    }
}

/// The job of some units: a manifest with one partition each, and the node that does them.
fn job<'u>(units: impl Iterator<Item = &'u Unit>) -> Result<Arc<dyn ExecutionPlan>, Fault> {
    let schema = manifest_schema();
    let partitions = units
        .enumerate()
        .map(|(row, unit)| {
            let text =
                serde_json::to_string(unit).map_err(|error| Fault::bug(error.to_string()))?;
            let columns: Vec<ArrayRef> = vec![
                Arc::new(StringArray::from(vec![row.to_string()])),
                Arc::new(StringArray::from(vec![text])),
            ];
            Ok(vec![RecordBatch::try_new(Arc::clone(&schema), columns)?])
        })
        .collect::<Result<Vec<_>, Fault>>()?;
    let manifest = MemorySourceConfig::try_new_exec(&partitions, schema, None)
        .map_err(|error| fault_of(&error))?;
    Ok(Arc::new(UnitExec::new(manifest, Registry::default())))
}

/// Runs a job to its end; the units that failed for reasons of their own, by their row in the manifest.
async fn submit(
    scheduler: String,
    plan: Arc<dyn ExecutionPlan>,
    registry: Registry,
) -> Result<Vec<(usize, Fault)>, Fault> {
    let codec = UnitCodec::new(registry.clone());
    let session = uuid::Uuid::new_v4().to_string();
    let config = session_config(&registry);
    let lost = |error: DataFusionError| {
        cluster_fault(error.find_root(), &format!("the cluster of {scheduler}"))
    };
    let stream = execute_physical_plan::<PhysicalPlanNode>(
        scheduler.clone(),
        &BallistaConfig::default(),
        plan,
        &codec,
        session,
        config,
    )
    .await
    .map_err(lost)?;
    let batches: Vec<RecordBatch> = stream.try_collect().await.map_err(lost)?;
    let mut faults = Vec::new();
    for batch in &batches {
        let (rows, texts) = (
            batch.column(0).as_string::<i32>(),
            batch.column(1).as_string::<i32>(),
        );
        for (row, text) in rows.iter().flatten().zip(texts.iter().flatten()) {
            if let (Ok(row), Ok(fault)) = (row.parse(), serde_json::from_str::<Fault>(text)) {
                faults.push((row, fault));
            }
        }
    }
    Ok(faults)
}

/// Rows of the manifest, and of what comes back: the unit's row, and its text, or its fault (empty for none).
fn manifest_schema() -> SchemaRef {
    Arc::new(Schema::new(vec![
        Field::new("row", DataType::Utf8, false),
        Field::new("text", DataType::Utf8, false),
    ]))
}

/// Does the units of a manifest. Unary, so that Ballista cuts it by partition.
#[derive(Clone)]
struct UnitExec {
    manifest: Arc<dyn ExecutionPlan>,
    registry: Registry,
    properties: Arc<PlanProperties>,
}

impl UnitExec {
    fn new(manifest: Arc<dyn ExecutionPlan>, registry: Registry) -> Self {
        let properties = PlanProperties::new(
            EquivalenceProperties::new(manifest_schema()),
            Partitioning::UnknownPartitioning(manifest.output_partitioning().partition_count()),
            EmissionType::Incremental,
            Boundedness::Bounded,
        );
        Self {
            manifest,
            registry,
            properties: Arc::new(properties),
        }
    }
}

impl fmt::Debug for UnitExec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "UnitExec")
    }
}

impl DisplayAs for UnitExec {
    fn fmt_as(&self, _: DisplayFormatType, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "UnitExec")
    }
}

impl ExecutionPlan for UnitExec {
    fn name(&self) -> &str {
        "UnitExec"
    }

    fn properties(&self) -> &Arc<PlanProperties> {
        &self.properties
    }

    fn children(&self) -> Vec<&Arc<dyn ExecutionPlan>> {
        vec![&self.manifest]
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
        let manifest = children
            .pop()
            .ok_or_else(|| DataFusionError::Internal("UnitExec has one child".into()))?;
        Ok(Arc::new(Self::new(manifest, self.registry.clone())))
    }

    fn execute(
        &self,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> DataFusionResult<SendableRecordBatchStream> {
        let registry = self.registry.clone();
        let done = self
            .manifest
            .execute(partition, context)?
            .then(move |batch| {
                let registry = registry.clone();
                async move { work(&batch?, &registry).await.map_err(external) }
            });
        Ok(Box::pin(RecordBatchStreamAdapter::new(
            manifest_schema(),
            done,
        )))
    }
}

async fn work(manifest: &RecordBatch, registry: &Registry) -> Result<RecordBatch, Fault> {
    let (rows, texts) = (
        manifest.column(0).as_string::<i32>(),
        manifest.column(1).as_string::<i32>(),
    );
    let mut outcomes = Vec::new();
    for text in texts.iter().flatten() {
        let unit: Unit = serde_json::from_str(text).map_err(|error| {
            Fault::bug(format!("a unit does not read: {error}"))
                .next("run the same evermap everywhere")
        })?;
        outcomes.push(match unit.run(registry).await {
            Ok(_) => String::new(),
            // What the machine was short of may be there on another one: let the task fail and be tried again.
            Err(fault) if fault.kind == Kind::Resource => return Err(coded(&fault)),
            Err(fault) => {
                serde_json::to_string(&fault).map_err(|error| Fault::bug(error.to_string()))?
            }
        });
    }
    let columns: Vec<ArrayRef> = vec![
        Arc::new(rows.clone()),
        Arc::new(StringArray::from(outcomes)),
    ];
    Ok(RecordBatch::try_new(manifest_schema(), columns)?)
}

/// A remote error arrives as a string: the code at its front lets the other side read it back.
fn coded(fault: &Fault) -> Fault {
    Fault {
        message: fault.coded(),
        place: String::new(),
        next: String::new(),
        kind: fault.kind,
    }
}

const MAGIC: &[u8] = b"evermap unit 1";

/// Sends [`UnitExec`] over the wire: a word, since the manifest beneath it says everything.
#[derive(Clone)]
struct UnitCodec {
    registry: Registry,
    inner: Arc<BallistaPhysicalExtensionCodec>,
}

impl UnitCodec {
    fn new(registry: Registry) -> Self {
        Self {
            registry,
            inner: Arc::default(),
        }
    }
}

impl fmt::Debug for UnitCodec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "UnitCodec")
    }
}

impl PhysicalExtensionCodec for UnitCodec {
    fn try_decode(
        &self,
        bytes: &[u8],
        inputs: &[Arc<dyn ExecutionPlan>],
        context: &TaskContext,
        converter: &dyn PhysicalProtoConverterExtension,
    ) -> DataFusionResult<Arc<dyn ExecutionPlan>> {
        match inputs {
            [manifest] if bytes == MAGIC => Ok(Arc::new(UnitExec::new(
                Arc::clone(manifest),
                self.registry.clone(),
            ))),
            _ => self.inner.try_decode(bytes, inputs, context, converter),
        }
    }

    fn try_encode(
        &self,
        node: Arc<dyn ExecutionPlan>,
        bytes: &mut Vec<u8>,
        converter: &dyn PhysicalProtoConverterExtension,
    ) -> DataFusionResult<()> {
        if node.downcast_ref::<UnitExec>().is_some() {
            bytes.extend_from_slice(MAGIC);
            return Ok(());
        }
        self.inner.try_encode(node, bytes, converter)
    }
}

fn session_config(registry: &Registry) -> SessionConfig {
    SessionConfig::new_with_ballista()
        .with_ballista_logical_extension_codec(Arc::new(BallistaLogicalExtensionCodec::default()))
        .with_ballista_physical_extension_codec(Arc::new(UnitCodec::new(registry.clone())))
        .with_ballista_adaptive_query_planner(false)
}

fn session_state(config: SessionConfig) -> SessionState {
    SessionStateBuilder::new()
        .with_default_features()
        .with_config(config)
        .build()
}

/// Serves as a scheduler until stopped.
///
/// # Errors
/// A resource fault when the address is taken, a user fault when it is none.
pub async fn scheduler(host: &str, port: u16, registry: Registry) -> Result<(), Fault> {
    let address = format!("{host}:{port}")
        .parse()
        .map_err(|error| Fault::user(format!("{host}:{port}: {error}")))?;
    let producer = registry.clone();
    let config = SchedulerConfig {
        bind_host: host.to_owned(),
        external_host: host.to_owned(),
        bind_port: port,
        scheduling_policy: TaskSchedulingPolicy::PullStaged,
        override_logical_codec: Some(Arc::new(BallistaLogicalExtensionCodec::default())),
        override_physical_codec: Some(Arc::new(UnitCodec::new(registry))),
        override_config_producer: Some(Arc::new(move || session_config(&producer))),
        override_session_builder: Some(Arc::new(|config| {
            Ok(session_state(config.upgrade_for_ballista()))
        })),
        executor_timeout_seconds: 12,
        expire_dead_executor_interval_seconds: 2,
        ..SchedulerConfig::default()
    };
    let failed = |error: &dyn fmt::Display| cluster_fault(error, "the scheduler does not start");
    let cluster = BallistaCluster::new_from_config(&config)
        .await
        .map_err(|error| failed(&error))?;
    start_server(cluster, address, Arc::new(config))
        .await
        .map_err(|error| failed(&error))
}

/// Where an executor listens, and for whom it works.
#[derive(Debug, Clone)]
pub struct ExecutorOptions {
    /// The scheduler's host and port.
    pub scheduler: (String, u16),
    /// Address to listen on, as the others reach it.
    pub host: String,
    /// Port for results.
    pub port: u16,
    /// Port for calls.
    pub grpc_port: u16,
    /// Units to run side by side.
    pub slots: usize,
    /// Folder for Ballista's own files.
    pub work_dir: String,
}

/// Serves as an executor until stopped.
///
/// # Errors
/// A resource fault when it cannot start or loses its scheduler for good.
pub async fn executor(options: ExecutorOptions, registry: Registry) -> Result<(), Fault> {
    let state = session_state(session_config(&registry));
    let producer = registry.clone();
    let config = ExecutorProcessConfig {
        bind_host: options.host.clone(),
        external_host: Some(options.host),
        port: options.port,
        grpc_port: options.grpc_port,
        scheduler_host: options.scheduler.0,
        scheduler_port: options.scheduler.1,
        scheduler_connect_timeout_seconds: 60,
        vcores: options.slots.max(1),
        work_dir: Some(options.work_dir),
        task_scheduling_policy: TaskSchedulingPolicy::PullStaged,
        override_function_registry: Some(Arc::new(BallistaFunctionRegistry::from(&state))),
        override_config_producer: Some(Arc::new(move || session_config(&producer))),
        override_logical_codec: Some(Arc::new(BallistaLogicalExtensionCodec::default())),
        override_physical_codec: Some(Arc::new(UnitCodec::new(registry))),
        executor_heartbeat_interval_seconds: 3,
        ..ExecutorProcessConfig::default()
    };
    start_executor_process(Arc::new(config))
        .await
        .map_err(|error| cluster_fault(&error, "the executor stopped"))
}
