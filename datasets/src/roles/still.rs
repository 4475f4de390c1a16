//! Which frames of a session never move, though topics of moving transforms have them: read from all transforms, unless the
//! first ones tell that all frames move.
//!
//! So topics of transforms are read twice, here and where rows are made. Whether a frame is still, the last transform of
//! the session says, and all rows of the frame depend on it: whether its first row is fixed, and whether others are there. To
//! make them in one pass, rows of all frames that are still so far would be held to the end of all files, which are scanned
//! side by side and in bounded memory.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::roles::{Messages, SentTransform, StillFrames};
use evermap_schemas::{Fault, Kind, rows};
use futures::TryStreamExt;
use tokio::sync::OnceCell;

use crate::fault::OrFault;
use crate::roles::ahead::{AT_ONCE, batches};
use crate::roles::rows::SessionFacts;
use crate::session::{LogPart, Session};

/// All frames that a topic has are among so many of its transforms in a file, if none of these is still.
const ENOUGH: usize = 10_000;

/// The frames that never move, by session.
#[derive(Debug)]
pub(super) struct StillOf {
    /// How messages become the transforms that they send.
    messages: Messages,
    sessions: BTreeMap<Arc<str>, SessionStillFrames>,
}

/// What a session says of its frames.
#[derive(Debug)]
struct SessionStillFrames {
    topics: Vec<String>,
    parts: Vec<Arc<LogPart>>,
    /// Once somebody asked.
    found: OnceCell<Arc<StillFrames>>,
}

impl StillOf {
    /// Those of a role; its topics' messages become transforms so.
    pub fn new(messages: Messages, role: &str, sessions: &[Session]) -> Self {
        let asked = |session: &Session| SessionStillFrames {
            topics: session.roles.topics(role).to_vec(),
            parts: session.parts.clone(),
            found: OnceCell::new(),
        };
        let sessions = sessions.iter();
        Self {
            messages,
            sessions: sessions
                .map(|session| (session.name.clone(), asked(session)))
                .collect(),
        }
    }

    /// Those of a session.
    ///
    /// # Errors
    /// A resource fault for a file that cannot be read.
    pub async fn of(&self, session: &str) -> Result<Arc<StillFrames>, Fault> {
        match self.sessions.get(session) {
            Some(asked) => {
                let read = || asked.read(self.messages);
                asked.found.get_or_try_init(read).await.cloned()
            }
            None => Ok(Arc::default()),
        }
    }
}

impl SessionStillFrames {
    async fn read(&self, messages: Messages) -> Result<Arc<StillFrames>, Fault> {
        let mut still = StillFrames::default();
        // Backwards, so that `/tf_static` tells what is fixed before `/tf` is read for it.
        for topic in self.topics.iter().rev() {
            for part in &self.parts {
                match add(&mut still, messages, part, topic).await {
                    Err(fault) if fault.kind == Kind::Resource => return Err(fault),
                    // What cannot be decoded is told where rows are made of it.
                    _ => {}
                }
            }
        }
        Ok(Arc::new(still))
    }
}

/// Adds the transforms of a topic in a file, until they tell that all frames move.
async fn add(
    still: &mut StillFrames,
    messages: Messages,
    part: &Arc<LogPart>,
    topic: &str,
) -> Result<(), Fault> {
    let known = SessionFacts::default();
    let mut batches = batches::<SentTransform>(messages, part, topic, known, AT_ONCE)?;
    let mut looked_at = 0;
    while (looked_at < ENOUGH || still.is_open())
        && let Some(batch) = batches.try_next().await.or_fault()?
    {
        looked_at += batch.num_rows();
        for sent in rows::<SentTransform>(&batch)? {
            still.add(sent);
        }
    }
    Ok(())
}
