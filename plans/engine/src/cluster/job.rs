//! A wave of units as one Ballista job.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use ballista_core::config::BallistaConfig;
use ballista_core::execution_plans::execute_physical_plan;
use ballista_core::extension::SessionConfigExt;
use ballista_core::serde::{BallistaLogicalExtensionCodec, BallistaPhysicalExtensionCodec};
use datafusion::datasource::memory::MemorySourceConfig;
use datafusion::error::{DataFusionError, Result as DataFusionResult};
use datafusion::execution::{
    SendableRecordBatchStream, SessionState, SessionStateBuilder, TaskContext,
};
use datafusion::physical_expr::EquivalenceProperties;
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::{ExecutionPlan, ExecutionPlanProperties, Partitioning};
use datafusion::prelude::SessionConfig;
use datafusion_proto::physical_plan::{PhysicalExtensionCodec, PhysicalProtoConverterExtension};
use datafusion_proto::protobuf::PhysicalPlanNode;
use evermap_contract::Registry;
use evermap_schemas::{Fault, Kind};
use futures::{StreamExt, TryStreamExt};

use crate::error::{OrFault, external, remote_fault};
use crate::nodes::node::{Deal, Duty, Need, Node, first};
use crate::unit::Unit;

/// The job of some units: a manifest with one partition each, and the node that does them.
pub fn job(units: &BTreeMap<usize, Unit>) -> Result<Arc<dyn ExecutionPlan>, Fault> {
    let schema = manifest_schema();
    let partition = |(index, unit): (&usize, &Unit)| {
        let text = serde_json::to_string(unit).map_err(|error| Fault::bug(error.to_string()))?;
        Ok(vec![manifest(vec![index.to_string()], vec![text])?])
    };
    let partitions = units
        .iter()
        .map(partition)
        .collect::<Result<Vec<_>, Fault>>()?;
    let manifest = MemorySourceConfig::try_new_exec(&partitions, schema, None).or_fault()?;
    unit_exec(manifest, Registry::default()).or_fault()
}

fn manifest(units: Vec<String>, texts: Vec<String>) -> Result<RecordBatch, Fault> {
    let columns: Vec<ArrayRef> = vec![
        Arc::new(StringArray::from(units)),
        Arc::new(StringArray::from(texts)),
    ];
    Ok(RecordBatch::try_new(manifest_schema(), columns)?)
}

/// Units and texts of a manifest.
fn entries(manifest: &RecordBatch) -> impl Iterator<Item = (&str, &str)> {
    let column = |index: usize| manifest.column(index).as_string::<i32>().iter().flatten();
    column(0).zip(column(1))
}

/// Runs a job to its end; the units that failed for reasons of their own.
pub async fn submit(
    scheduler: &str,
    plan: Arc<dyn ExecutionPlan>,
    registry: &Registry,
) -> Result<Vec<(usize, Fault)>, Fault> {
    let lost = |error: DataFusionError| {
        remote_fault(error.find_root(), &format!("the cluster of {scheduler}"))
    };
    let stream = execute_physical_plan::<PhysicalPlanNode>(
        scheduler.to_owned(),
        &BallistaConfig::default(),
        plan,
        &UnitCodec::new(registry.clone()),
        uuid::Uuid::new_v4().to_string(),
        session_config(registry),
    )
    .await
    .map_err(lost)?;
    let batches: Vec<RecordBatch> = stream.try_collect().await.map_err(lost)?;
    let fault =
        |(index, text): (&str, &str)| Some((index.parse().ok()?, serde_json::from_str(text).ok()?));
    let ended = batches.iter().flat_map(entries);
    Ok(ended.filter_map(fault).collect())
}

/// Rows of the manifest, and of what comes back: the unit's number, and its text, or its fault (empty for none).
fn manifest_schema() -> SchemaRef {
    Arc::new(Schema::new(vec![
        Field::new("unit", DataType::Utf8, false),
        Field::new("text", DataType::Utf8, false),
    ]))
}

/// Does the units of a manifest. Unary, so that Ballista cuts it by partition.
type UnitExec = Node<Units>;

/// Units, done by the operators of this process.
struct Units(Registry);

impl fmt::Display for Units {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the units of a manifest")
    }
}

impl Duty for Units {
    const NAME: &'static str = "UnitExec";
    type Shared = ();

    fn needs(&self) -> Vec<Need> {
        vec![Need {
            deal: Deal::Any,
            sorting: Vec::new(),
            parallel: false,
        }]
    }

    fn output(
        &self,
        children: &[Arc<dyn ExecutionPlan>],
    ) -> DataFusionResult<(EquivalenceProperties, Partitioning)> {
        let partitions = first(children)?.output_partitioning().partition_count();
        Ok((
            EquivalenceProperties::new(manifest_schema()),
            Partitioning::UnknownPartitioning(partitions),
        ))
    }

    fn execute(
        node: &UnitExec,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> DataFusionResult<SendableRecordBatchStream> {
        let manifest = first(&node.children)?.execute(partition, context)?;
        let units = Arc::clone(&node.duty);
        let done = manifest.then(move |batch| {
            let units = Arc::clone(&units);
            async move { work(&batch?, &units.0).await.map_err(external) }
        });
        Ok(Box::pin(RecordBatchStreamAdapter::new(
            manifest_schema(),
            done,
        )))
    }
}

fn unit_exec(
    manifest: Arc<dyn ExecutionPlan>,
    registry: Registry,
) -> DataFusionResult<Arc<dyn ExecutionPlan>> {
    let units = Arc::new(Units(registry));
    Ok(Arc::new(UnitExec::try_new(units, vec![manifest])?))
}

async fn work(batch: &RecordBatch, registry: &Registry) -> Result<RecordBatch, Fault> {
    let (mut units, mut outcomes) = (Vec::new(), Vec::new());
    for (index, text) in entries(batch) {
        let unit: Unit = serde_json::from_str(text).map_err(|error| {
            Fault::bug(format!("a unit does not read: {error}"))
                .next("run the same evermap everywhere")
        })?;
        units.push(index.to_owned());
        outcomes.push(match unit.run(registry).await {
            Ok(_) => String::new(),
            // What the machine was short of may be there on another one: let the task fail and be tried again.
            Err(fault) if fault.kind == Kind::Resource => return Err(coded(&fault)),
            Err(fault) => {
                serde_json::to_string(&fault).map_err(|error| Fault::bug(error.to_string()))?
            }
        });
    }
    manifest(units, outcomes)
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
            [manifest] if bytes == MAGIC => unit_exec(Arc::clone(manifest), self.registry.clone()),
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
