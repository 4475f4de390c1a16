//! Rows that are filtered or dealt out, put together by bytes. DataFusion's filters and repartitions put what is left of
//! batches together until there are so many rows, whatever they weigh: a thousand images have hundreds of megabytes.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

use arrow::array::{AsArray, RecordBatch};
use arrow::compute::{BatchCoalescer, filter_record_batch};
use arrow::datatypes::{DataType, Schema, SchemaRef};
use datafusion::error::{DataFusionError, Result};
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::physical_expr::projection::ProjectionRef;
use datafusion::physical_expr::{EquivalenceProperties, Partitioning, PhysicalExpr};
use datafusion::physical_plan::execution_plan::Boundedness;
use datafusion::physical_plan::filter::{FilterExec, FilterExecBuilder};
use datafusion::physical_plan::metrics::{BaselineMetrics, RecordOutput};
use datafusion::physical_plan::repartition::RepartitionExec;
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::{
    ExecutionPlan, ExecutionPlanProperties, replace_children_if_necessary,
};
use futures::{TryStreamExt, stream};

use crate::nodes::node::{Duty, Node, first};
use crate::nodes::weight::weight;

/// Bytes that are put together; heavier batches are handed on as they are.
const GATHERED_BYTES: usize = 1 << 20;

/// What stands in for a filter or a repartition of rows that may be heavy; `None` for other plans.
///
/// # Errors
/// When a plan does not take its inputs.
pub fn light_filter(plan: &Arc<dyn ExecutionPlan>) -> Result<Option<Arc<dyn ExecutionPlan>>> {
    if !plan
        .schema()
        .fields()
        .iter()
        .any(|field| may_be_heavy(field.data_type()))
    {
        return Ok(None);
    }
    if let Some(filter) = plan.downcast_ref::<FilterExec>() {
        let kept = Gathering {
            filter: Some(Filter::of(filter)),
            fetch: filter.fetch(),
        };
        return node(kept, filter.input()).map(Some);
    }
    let Some(dealt) = plan.downcast_ref::<RepartitionExec>() else {
        return Ok(None);
    };
    // One that keeps an order, or whose rows do not end, puts no batches together.
    if dealt.preserve_order() || dealt.input().boundedness().is_unbounded() {
        return Ok(None);
    }
    let endless = node(Endless, dealt.input())?;
    let dealt = replace_children_if_necessary(Arc::clone(plan), vec![endless])?;
    all_gathered(&dealt).map(Some)
}

/// All rows of a plan, put together by bytes.
///
/// # Errors
/// When a plan does not take its inputs.
pub fn all_gathered(plan: &Arc<dyn ExecutionPlan>) -> Result<Arc<dyn ExecutionPlan>> {
    node(Gathering::default(), plan)
}

/// Whether it stands in for a filter: fewer rows come out than went in, nobody knows how many.
pub fn is_filter(plan: &dyn ExecutionPlan) -> bool {
    let gathering = plan.downcast_ref::<Node<Gathering>>();
    gathering.is_some_and(|node| node.duty.filter.is_some())
}

/// A node over one plan.
///
/// # Errors
/// As [`Duty::output`].
pub fn node<D: Duty>(duty: D, input: &Arc<dyn ExecutionPlan>) -> Result<Arc<dyn ExecutionPlan>> {
    let node = Node::try_new(Arc::new(duty), vec![Arc::clone(input)])?;
    Ok(Arc::new(node))
}

/// Whether there is no limit to what a value weighs.
fn may_be_heavy(kind: &DataType) -> bool {
    match kind {
        DataType::Struct(members) => members
            .iter()
            .any(|member| may_be_heavy(member.data_type())),
        DataType::FixedSizeList(value, _) => may_be_heavy(value.data_type()),
        DataType::Boolean
        | DataType::Null
        | DataType::Dictionary(..)
        | DataType::FixedSizeBinary(_) => false,
        other => !other.is_primitive(),
    }
}

/// Rows that are taken for endless by what deals them out, so that it hands on what comes.
struct Endless;

impl fmt::Display for Endless {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("as they come")
    }
}

impl Duty for Endless {
    const NAME: &'static str = "EndlessExec";
    type Shared = ();

    fn boundedness(&self) -> Boundedness {
        Boundedness::Unbounded {
            requires_infinite_memory: false,
        }
    }

    fn keeps_order(&self) -> bool {
        true
    }

    fn execute(
        node: &Node<Self>,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        first(&node.children)?.execute(partition, context)
    }
}

/// What is kept of each row that comes, and of which rows.
#[derive(Debug, Clone)]
struct Filter {
    predicate: Arc<dyn PhysicalExpr>,
    projection: Option<ProjectionRef>,
}

impl Filter {
    fn of(filter: &FilterExec) -> Self {
        Self {
            predicate: Arc::clone(filter.predicate()),
            projection: filter.projection().clone(),
        }
    }

    /// The filter of DataFusion's over a plan.
    fn over(&self, plan: &Arc<dyn ExecutionPlan>) -> Result<Arc<dyn ExecutionPlan>> {
        let same = FilterExecBuilder::new(Arc::clone(&self.predicate), Arc::clone(plan));
        let same = same.apply_projection_by_ref(self.projection.as_ref())?;
        Ok(Arc::new(same.build()?))
    }

    fn kept(&self, batch: &RecordBatch) -> Result<RecordBatch> {
        let told = self.predicate.evaluate(batch)?;
        let told = told.into_array(batch.num_rows())?;
        let told = told.as_boolean_opt().ok_or_else(|| {
            DataFusionError::Internal("a filter's predicate is no boolean".to_owned())
        })?;
        let kept = match &self.projection {
            Some(columns) => filter_record_batch(&batch.project(columns)?, told),
            None => filter_record_batch(batch, told),
        };
        Ok(kept?)
    }
}

/// Rows that are handed on in batches of as many as come, or of [`GATHERED_BYTES`].
#[derive(Debug, Clone, Default)]
struct Gathering {
    /// Which; all, where there is none.
    filter: Option<Filter>,
    /// The most of each partition.
    fetch: Option<usize>,
}

impl fmt::Display for Gathering {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.filter {
            Some(filter) => write!(f, "{}", filter.predicate)?,
            None => f.write_str("all")?,
        }
        match self.fetch {
            Some(rows) => write!(f, ", fetch={rows}"),
            None => Ok(()),
        }
    }
}

impl Duty for Gathering {
    const NAME: &'static str = "LightFilterExec";
    type Shared = ();

    fn output(
        &self,
        children: &[Arc<dyn ExecutionPlan>],
    ) -> Result<(EquivalenceProperties, Partitioning)> {
        let child = first(children)?;
        let same: Arc<dyn ExecutionPlan> = match &self.filter {
            Some(filter) => filter.over(child)?,
            None => Arc::clone(child),
        };
        let (known, dealt) = (same.equivalence_properties(), same.output_partitioning());
        Ok((known.clone(), dealt.clone()))
    }

    fn expressions(&self) -> Vec<&Arc<dyn PhysicalExpr>> {
        self.filter.iter().map(|filter| &filter.predicate).collect()
    }

    fn keeps_order(&self) -> bool {
        true
    }

    fn execute(
        node: &Node<Self>,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        let most = context.session_config().batch_size();
        let input = first(&node.children)?.execute(partition, context)?;
        let schema = node.schema();
        let metrics = BaselineMetrics::new(&node.metrics, partition);
        let begun = GatheredRows {
            rows: Rows::new(&schema, most),
            duty: Arc::clone(&node.duty),
            left: node.duty.fetch.unwrap_or(usize::MAX),
            input: Some(input),
        };
        let batches = stream::try_unfold((begun, metrics), async |(mut gathered, metrics)| {
            let next = gathered.next(&metrics).await?;
            Ok(next.map(|batch| (batch.record_output(&metrics), (gathered, metrics))))
        });
        Ok(Box::pin(RecordBatchStreamAdapter::new(schema, batches)))
    }
}

/// A partition's rows on their way.
struct GatheredRows {
    rows: Rows,
    duty: Arc<Gathering>,
    /// Rows that are still wanted.
    left: usize,
    /// `None` when nothing more comes, or is wanted.
    input: Option<SendableRecordBatchStream>,
}

impl GatheredRows {
    async fn next(&mut self, metrics: &BaselineMetrics) -> Result<Option<RecordBatch>> {
        loop {
            if let Some(batch) = self.rows.ready.pop_front() {
                return Ok(Some(batch));
            }
            let Some(input) = &mut self.input else {
                return Ok(None);
            };
            let come = input.try_next().await?;
            let _timer = metrics.elapsed_compute().timer();
            match come {
                Some(batch) => self.take(batch)?,
                None => self.end()?,
            }
        }
    }

    fn take(&mut self, batch: RecordBatch) -> Result<()> {
        let kept = match &self.duty.filter {
            Some(filter) => filter.kept(&batch)?,
            None => batch,
        };
        let kept = kept.slice(0, kept.num_rows().min(self.left));
        self.left -= kept.num_rows();
        self.rows.add(kept)?;
        match self.left {
            0 => self.end(),
            _ => Ok(()),
        }
    }

    fn end(&mut self) -> Result<()> {
        self.input = None;
        self.rows.flush()
    }
}

/// Rows that are put together.
struct Rows {
    coalescer: BatchCoalescer,
    /// Bytes that the coalescer holds, or fewer.
    held: usize,
    ready: VecDeque<RecordBatch>,
}

impl Rows {
    fn new(schema: &Schema, most: usize) -> Self {
        let schema: SchemaRef = Arc::new(schema.clone());
        let coalescer = BatchCoalescer::new(schema, most);
        Self {
            coalescer: coalescer.with_biggest_coalesce_batch_size(Some(most / 2)),
            held: 0,
            ready: VecDeque::new(),
        }
    }

    fn add(&mut self, batch: RecordBatch) -> Result<()> {
        let weight = weight(&batch);
        if weight >= GATHERED_BYTES {
            self.flush()?;
            self.ready.push_back(batch);
            return Ok(());
        }
        self.coalescer.push_batch(batch)?;
        self.held += weight;
        match self.held >= GATHERED_BYTES {
            true => self.flush(),
            false => {
                self.collect();
                Ok(())
            }
        }
    }

    fn flush(&mut self) -> Result<()> {
        self.coalescer.finish_buffered_batch()?;
        self.collect();
        Ok(())
    }

    fn collect(&mut self) {
        while let Some(batch) = self.coalescer.next_completed_batch() {
            self.held = 0;
            self.ready.push_back(batch);
        }
    }
}

#[cfg(test)]
mod tests;
