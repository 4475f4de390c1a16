//! What the cameras of a session are called, read from the first calibration of each topic, and which of their images are
//! read.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::roles::{CAMERAS, CalibratedCamera, CameraNames, Role, calibration};
use evermap_schemas::{Fault, rows};
use futures::TryStreamExt;

use crate::fault::OrFault;
use crate::losses::{Loss, Reason};
use crate::roles::Topics;
use crate::roles::ahead::batches;
use crate::roles::rows::Known;
use crate::session::{LogPart, Session};

/// The role that names cameras.
pub(super) const ROLE: Role = calibration::ROLE;

/// The cameras of sessions, by the sessions' names.
pub(super) type Cameras = BTreeMap<Arc<str>, CameraNames>;

/// Which images of their cameras sessions read, without any names yet.
pub(super) fn images(sessions: &[Session]) -> Cameras {
    let of_session = |session: &Session| {
        let topics = |role: &Role| {
            let topics = session.roles.topics(role.name).iter();
            let spoken = topics.filter(|topic| !session.is_silent(topic));
            spoken.map(String::as_str).collect::<Vec<_>>()
        };
        (session.name.clone(), CameraNames::of_images(topics))
    };
    sessions.iter().map(of_session).collect()
}

/// Reads the names of all sessions, whose images are known. Cameras that are not read, as they have the frame of another
/// one, are counted once a session.
pub(super) async fn read(
    topics: &Topics,
    parts: &[Arc<LogPart>],
    images: &Cameras,
) -> Result<Cameras, Fault> {
    let mut cameras = images.clone();
    for part in parts {
        for topic in topics.get(&part.session).into_iter().flatten() {
            let names = cameras.entry(part.session.clone()).or_default();
            if !names.knows(topic)
                && let Some(first) = first(part, topic, names).await?
            {
                names.add(topic, first);
            }
        }
    }
    count_doubled(topics, parts, &cameras);
    Ok(cameras)
}

/// Counts the calibration topics whose camera is another one's, in the first file of each session.
fn count_doubled(topics: &Topics, parts: &[Arc<LogPart>], cameras: &Cameras) {
    for (session, names) in cameras {
        let Some(part) = parts.iter().find(|part| part.session == *session) else {
            continue;
        };
        for topic in topics.get(session).into_iter().flatten() {
            if let Some(detail) = names.doubled(topic) {
                let (loss, losses) = (Loss::one(0), &part.losses);
                losses.note_topic(Reason::SameCamera, topic, 0, loss, detail);
            }
        }
    }
}

/// The camera of a topic's first calibration in a file.
async fn first(
    part: &Arc<LogPart>,
    topic: &str,
    cameras: &CameraNames,
) -> Result<Option<CalibratedCamera>, Fault> {
    let known = Known {
        cameras: cameras.clone(),
        ..Known::default()
    };
    let mut batches = batches::<CalibratedCamera>(CAMERAS, part, topic, known, 1)?;
    match batches.try_next().await.or_fault()? {
        Some(batch) => Ok(rows::<CalibratedCamera>(&batch)?.into_iter().next()),
        None => Ok(None),
    }
}
