//! The plan node that runs a function in Python, whose tables leave this process and whose rows come back.

use std::fmt;
use std::sync::{Arc, Mutex};

use arrow::array::{AsArray, RecordBatch};
use arrow::datatypes::SchemaRef;
use datafusion::common::utils::memory::get_record_batch_memory_size;
use datafusion::error::Result as DataFusionResult;
use datafusion::execution::memory_pool::{MemoryConsumer, MemoryReservation};
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::EquivalenceProperties;
use datafusion::physical_plan::metrics::{BaselineMetrics, RecordOutput};
use datafusion::physical_plan::stream::RecordBatchReceiverStreamBuilder;
use datafusion::physical_plan::{ExecutionPlan, Partitioning};
use evermap_contract::Losses;
use evermap_interpreter::Table;
use evermap_language::Grain;
use evermap_schemas::Fault;
use futures::StreamExt;
use tokio::sync::mpsc;

use crate::conform::conform_to;
use crate::error::{OrFault, external};
use crate::locked::locked;
use crate::map::receipt::Extent;
use crate::nodes::node::{Duty, Need, Node};
use crate::program::python::PythonTask;

/// Batches that wait for the reader.
const QUEUE: usize = 2;

/// Runs a function over its tables: the children, in the order of its ports.
pub type PythonExec = Node<Python>;

/// A function, and the columns that its rows are brought to.
pub struct Python {
    /// The function.
    pub task: PythonTask,
    /// What comes out.
    pub schema: SchemaRef,
    /// What it is given, and its rows are of.
    pub extent: Extent,
    /// Where what it leaves out is counted.
    pub losses: Arc<Mutex<Losses>>,
}

impl fmt::Display for Python {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let function = &self.task.function;
        let ports = function.ports.join(", ");
        write!(
            f,
            "function={}, grain={}, ports=[{ports}]",
            function.label(),
            self.task.grain.name()
        )
    }
}

impl Duty for Python {
    const NAME: &'static str = "PythonExec";
    type Shared = ();

    fn needs(&self) -> Vec<Need> {
        vec![Need::whole(Vec::new()); self.task.function.ports.len()]
    }

    fn output(
        &self,
        _: &[Arc<dyn ExecutionPlan>],
    ) -> DataFusionResult<(EquivalenceProperties, Partitioning)> {
        Ok((
            EquivalenceProperties::new(Arc::clone(&self.schema)),
            Partitioning::UnknownPartitioning(1),
        ))
    }

    fn execute(
        node: &PythonExec,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> DataFusionResult<SendableRecordBatchStream> {
        let children = node.children.iter();
        let inputs = children.map(|child| child.execute(partition, Arc::clone(&context)));
        let inputs: Vec<_> = inputs.collect::<DataFusionResult<_>>()?;
        let mut output = RecordBatchReceiverStreamBuilder::new(node.schema(), QUEUE);
        let name = format!("tables of {}", node.duty.task.function.label());
        let caller = Caller {
            python: Arc::clone(&node.duty),
            sender: output.tx(),
            metrics: BaselineMetrics::new(&node.metrics, partition),
            memory: MemoryConsumer::new(name).register(context.memory_pool()),
        };
        output.spawn(async move { caller.run(inputs).await.map_err(external) });
        Ok(output.build())
    }
}

struct Caller {
    python: Arc<Python>,
    sender: mpsc::Sender<DataFusionResult<RecordBatch>>,
    metrics: BaselineMetrics,
    memory: MemoryReservation,
}

impl Caller {
    async fn run(self, inputs: Vec<SendableRecordBatchStream>) -> Result<(), Fault> {
        if self.python.task.grain == Grain::Rows {
            for mut input in inputs {
                let schema = input.schema();
                while let Some(batch) = input.next().await {
                    let (schema, batches) = (Arc::clone(&schema), vec![batch.or_fault()?]);
                    self.call(vec![Table { schema, batches }]).await?;
                }
            }
            return Ok(());
        }
        let mut tables = Vec::new();
        for input in inputs {
            tables.push(self.collect(input).await?);
        }
        self.call(tables).await
    }

    /// The whole table. It is held twice, as it is sent as one stream.
    async fn collect(&self, mut input: SendableRecordBatchStream) -> Result<Table, Fault> {
        let (schema, mut batches) = (input.schema(), Vec::new());
        while let Some(batch) = input.next().await {
            let batch = batch.or_fault()?;
            let bytes = get_record_batch_memory_size(&batch);
            self.memory.try_grow(2 * bytes).or_fault()?;
            batches.push(batch);
        }
        Ok(Table { schema, batches })
    }

    /// Calls the function, unless all tables are empty, and hands its rows on.
    async fn call(&self, tables: Vec<Table>) -> Result<(), Fault> {
        let mut batches = tables.iter().flat_map(|table| &table.batches);
        if batches.all(|batch| batch.num_rows() == 0) {
            return Ok(());
        }
        let python = Arc::clone(&self.python);
        let timer = self.metrics.elapsed_compute().timer();
        let made = tokio::task::spawn_blocking(move || python.made(&tables)).await;
        timer.done();
        for rows in made.map_err(|error| Fault::bug(error.to_string()))?? {
            let rows = rows.record_output(&self.metrics);
            let sent = self.sender.send(Ok(rows)).await;
            sent.map_err(|_| Fault::resource("the reader of a function's rows has gone"))?;
        }
        Ok(())
    }
}

impl Python {
    /// The rows that the function makes of tables, in the columns that the plan says.
    ///
    /// # Errors
    /// What the function raises, or rows of other columns, of another session or another site.
    pub fn made(&self, tables: &[Table]) -> Result<Vec<RecordBatch>, Fault> {
        let function = &self.task.function;
        let mut made = function.call(&self.task.environment, tables)?;
        let skipped = Losses(std::mem::take(&mut made.skipped));
        locked(&self.losses).merge(&skipped);
        // What has no rows has columns still.
        made.rows
            .batches
            .push(RecordBatch::new_empty(made.rows.schema));
        let batches = made.rows.batches.iter();
        let conformed = batches.map(|batch| -> Result<RecordBatch, Fault> {
            let rows = conform_to(batch, &self.schema)?;
            check_extent(&rows, &self.extent)?;
            Ok(rows)
        });
        conformed
            .collect::<Result<_, _>>()
            .map_err(|fault| fault.at(function.label()))
    }
}

/// That rows name no other session or site than they are of: a query groups those of each by themselves.
///
/// # Errors
/// A data fault with the first that does.
fn check_extent(rows: &RecordBatch, extent: &Extent) -> Result<(), Fault> {
    for (column, expected) in [("session", &extent.session), ("site", &extent.site)] {
        let names = rows.column_by_name(column);
        let names = names.and_then(|names| names.as_string_opt::<i32>());
        if let (Some(expected), Some(names)) = (expected, names)
            && let Some(found) = names.iter().find(|name| *name != Some(expected.as_str()))
        {
            let found = found.unwrap_or("null");
            let text = format!("expected rows of {column} {expected}, found {found}");
            return Err(Fault::data(text).at(format!("column {column}")));
        }
    }
    Ok(())
}
