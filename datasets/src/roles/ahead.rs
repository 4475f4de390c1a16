//! Rows of a topic that are read before those of a role can be made, as they say what its messages mean.

use std::sync::Arc;

use arrow::array::RecordBatch;
use datafusion::error::Result as ScanResult;
use datafusion::execution::memory_pool::GreedyMemoryPool;
use datafusion::physical_plan::metrics::ExecutionPlanMetricsSet;
use evermap_schemas::roles::Messages;
use evermap_schemas::{Fault, LayerRow, rows};
use futures::TryStreamExt;
use futures::stream::BoxStream;

use crate::fault::OrFault;
use crate::roles::rows::{RoleRows, SessionFacts};
use crate::scan::{Job, ScanMetrics, ScanRequest, stream};
use crate::session::LogPart;

/// Memory that reading them takes at most: chunks that do not fit are read by portions.
const BYTES: usize = 64 << 20;

/// Messages that are looked at together, where all of a topic may be.
pub(super) const AT_ONCE: usize = 1024;

/// The rows that a topic's messages in a file become, from so many messages at a time.
pub(super) fn batches<T: LayerRow>(
    messages: Messages,
    part: &Arc<LogPart>,
    topic: &str,
    known: SessionFacts,
    at_once: usize,
) -> Result<BoxStream<'static, ScanResult<RecordBatch>>, Fault> {
    let schema = T::layer().schema();
    let columns: Vec<usize> = (0..schema.fields().len()).collect();
    let topics = [topic.to_owned()];
    let rows = RoleRows::new(messages, &topics, known, part, &schema, &columns)?;
    let units = ScanRequest {
        part,
        range: (0, u64::MAX),
        channels: part.channels_of(topic).map(|c| c.id).collect(),
        predicate: None,
        schema: &schema,
        indexed: &[],
    }
    .units();
    Ok(stream(Job {
        part: part.clone(),
        units,
        rows: Box::new(rows),
        batch_rows: at_once,
        pool: Some(Arc::new(GreedyMemoryPool::new(BYTES))),
        // As tables of roles note what they lose, so that it counts once.
        topic: String::new(),
        metrics: ScanMetrics::new(&ExecutionPlanMetricsSet::new(), 0),
    }))
}

/// The first row that a topic's messages in a file become.
pub(super) async fn first<T: LayerRow>(
    messages: Messages,
    part: &Arc<LogPart>,
    topic: &str,
    known: SessionFacts,
) -> Result<Option<T>, Fault> {
    let mut batches = batches::<T>(messages, part, topic, known, 1)?;
    match batches.try_next().await.or_fault()? {
        Some(batch) => Ok(rows::<T>(&batch)?.into_iter().next()),
        None => Ok(None),
    }
}
