//! What the cameras of a session are called, read from the first calibration of each topic, and which of their images are
//! read.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::Fault;
use evermap_schemas::roles::{
    CAMERA_FRAMES, CAMERAS, CalibratedCamera, CalibratedFrame, CameraNames, Role, calibration,
};

use crate::losses::{Loss, Reason};
use crate::roles::Topics;
use crate::roles::ahead::first;
use crate::roles::rows::SessionFacts;
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
/// one, or stand nobody knows where beside it, are counted once a session.
pub(super) async fn read(
    topics: &Topics,
    parts: &[Arc<LogPart>],
    images: &Cameras,
) -> Result<Cameras, Fault> {
    let mut cameras = images.clone();
    for part in parts {
        for topic in topics.get(&part.session).into_iter().flatten() {
            let names = cameras.entry(part.session.clone()).or_default();
            if !names.knows(topic) {
                name(part, topic, names).await?;
            }
        }
    }
    count_left_out(topics, parts, &cameras);
    Ok(cameras)
}

/// Names the camera of a topic by its first calibration in a file; where none is read, its frame is noted.
async fn name(part: &Arc<LogPart>, topic: &str, names: &mut CameraNames) -> Result<(), Fault> {
    let (cameras, frames) = (known(names), known(names));
    if let Some(camera) = first::<CalibratedCamera>(CAMERAS, part, topic, cameras).await? {
        names.add(topic, camera);
    } else if let Some(named) = first::<CalibratedFrame>(CAMERA_FRAMES, part, topic, frames).await?
    {
        names.add_unread(topic, named.frame);
    }
    Ok(())
}

fn known(cameras: &CameraNames) -> SessionFacts {
    SessionFacts {
        cameras: cameras.clone(),
        ..SessionFacts::default()
    }
}

/// Counts the calibration topics whose camera is not read, in the first file of each session.
fn count_left_out(topics: &Topics, parts: &[Arc<LogPart>], cameras: &Cameras) {
    for (session, names) in cameras {
        let Some(part) = parts.iter().find(|part| part.session == *session) else {
            continue;
        };
        for topic in topics.get(session).into_iter().flatten() {
            if let Some(detail) = names.left_out(topic) {
                let (loss, losses) = (Loss::one(0), &part.losses);
                losses.note_topic(Reason::SameCamera, topic, 0, loss, detail);
            }
        }
    }
}
