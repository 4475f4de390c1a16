//! A wave of units as one Ballista job.

use std::fmt;
use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use ballista_core::config::BallistaConfig;
use ballista_core::execution_plans::execute_physical_plan;
use ballista_core::extension::SessionConfigExt;
use ballista_core::serde::{BallistaLogicalExtensionCodec, BallistaPhysicalExtensionCodec};
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
use futures::{StreamExt, TryStreamExt};

use crate::error::{external, fault_of, remote_fault};
use crate::unit::Unit;

/// The job of some units: a manifest with one partition each, and the node that does them.
pub fn job<'u>(units: impl Iterator<Item = &'u Unit>) -> Result<Arc<dyn ExecutionPlan>, Fault> {
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
pub async fn submit(
    scheduler: String,
    plan: Arc<dyn ExecutionPlan>,
    registry: Registry,
) -> Result<Vec<(usize, Fault)>, Fault> {
    let codec = UnitCodec::new(registry.clone());
    let session = uuid::Uuid::new_v4().to_string();
    let config = session_config(&registry);
    let lost = |error: DataFusionError| {
        remote_fault(error.find_root(), &format!("the cluster of {scheduler}"))
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
pub struct UnitCodec {
    registry: Registry,
    inner: Arc<BallistaPhysicalExtensionCodec>,
}

impl UnitCodec {
    /// A codec of a process with these operators.
    pub fn new(registry: Registry) -> Self {
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

/// The configuration of sessions that know units.
pub fn session_config(registry: &Registry) -> SessionConfig {
    SessionConfig::new_with_ballista()
        .with_ballista_logical_extension_codec(Arc::new(BallistaLogicalExtensionCodec::default()))
        .with_ballista_physical_extension_codec(Arc::new(UnitCodec::new(registry.clone())))
        .with_ballista_adaptive_query_planner(false)
}

/// The state of a session with this configuration.
pub fn session_state(config: SessionConfig) -> SessionState {
    SessionStateBuilder::new()
        .with_default_features()
        .with_config(config)
        .build()
}
