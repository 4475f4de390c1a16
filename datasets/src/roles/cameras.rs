//! What the cameras of a session are called: read from the first calibration of each topic.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::roles::{Calibration, CameraNames, Messages, Role, calibration};
use evermap_schemas::{Fault, rows};
use futures::TryStreamExt;

use crate::fault::OrFault;
use crate::roles::Topics;
use crate::roles::ahead::batches;
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
    let mut batches = batches::<Calibration>(messages, part, topic, 1)?;
    match batches.try_next().await.or_fault()? {
        Some(batch) => Ok(rows::<Calibration>(&batch)?.into_iter().next()),
        None => Ok(None),
    }
}
