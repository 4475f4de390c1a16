//! What the cameras of a session are called: read from the first calibration of each topic.

use std::collections::BTreeMap;
use std::sync::Arc;

use datafusion::physical_plan::metrics::ExecutionPlanMetricsSet;
use evermap_schemas::roles::{Calibration, CameraNames, Messages, Role, calibration};
use evermap_schemas::{Fault, LayerRow, rows};
use futures::TryStreamExt;

use crate::fault::OrFault;
use crate::roles::Topics;
use crate::roles::rows::RoleRows;
use crate::scan::{Job, ScanMetrics, Wanted, stream};
use crate::session::LogPart;

/// The role that names cameras.
pub(super) const ROLE: Role = calibration::ROLE;

/// Reads the names of all sessions.
pub(super) async fn read(
    topics: &Topics,
    parts: &[Arc<LogPart>],
) -> Result<BTreeMap<Arc<str>, CameraNames>, Fault> {
    let mut cameras = BTreeMap::<Arc<str>, CameraNames>::new();
    for part in parts {
        for topic in topics.get(&part.session).into_iter().flatten() {
            let names = cameras.entry(part.session.clone()).or_default();
            if !names.knows(topic)
                && let Some(messages) = ROLE.messages()
                && let Some(first) = first(*messages, part, topic).await?
            {
                names.add(topic, first.camera);
            }
        }
    }
    Ok(cameras)
}

/// The first calibration of a topic in a file.
async fn first(
    messages: Messages,
    part: &Arc<LogPart>,
    topic: &str,
) -> Result<Option<Calibration>, Fault> {
    let schema = Calibration::layer().schema();
    let columns: Vec<usize> = (0..schema.fields().len()).collect();
    let topics = [topic.to_owned()];
    let nobody = CameraNames::default();
    let rows_of = RoleRows::new(messages, &topics, nobody, None, part, &schema, &columns)?;
    let units = Wanted {
        part,
        range: (0, u64::MAX),
        channels: part.channels_of(topic).map(|c| c.id).collect(),
        predicate: None,
        schema: &schema,
    }
    .units();
    let mut batches = stream(Job {
        part: part.clone(),
        units,
        rows: Box::new(rows_of),
        batch_rows: 1,
        pool: None,
        topic: topic.to_owned(),
        metrics: ScanMetrics::new(&ExecutionPlanMetricsSet::new(), 0),
    });
    let batch = batches.try_next().await.or_fault()?;
    match batch {
        Some(batch) => Ok(rows::<Calibration>(&batch)?.into_iter().next()),
        None => Ok(None),
    }
}
