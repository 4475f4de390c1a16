//! How long after their stamps the messages of a role's topics were logged.

use evermap_schemas::roles::{DELAYS, Delay};
use evermap_schemas::rows;
use futures::TryStreamExt;

use crate::roles::ahead::batches;
use crate::roles::rows::SessionFacts;
use crate::session::Session;

/// Messages of a topic that are asked.
const FIRST: usize = 16;

/// Of each topic that has stamps, at the median of its first messages (ns).
pub(crate) async fn of(session: &Session, role: &str) -> Vec<(String, i64)> {
    let mut delays = Vec::new();
    for topic in session.roles.topics(role) {
        if let Some(delay) = of_topic(session, topic).await {
            delays.push((topic.clone(), delay));
        }
    }
    delays
}

/// What cannot be read of a log is told where its rows are read.
async fn of_topic(session: &Session, topic: &str) -> Option<i64> {
    let mut parts = session.parts.iter();
    let part = parts.find(|part| part.channels_of(topic).next().is_some())?;
    let mut batches = batches::<Delay>(DELAYS, part, topic, SessionFacts::default(), FIRST).ok()?;
    let first = rows::<Delay>(&batches.try_next().await.ok()??).ok()?;
    let between = |delay: &Delay| delay.log_time.0.saturating_sub(delay.stamp.0);
    let mut delays: Vec<i64> = first.iter().map(between).collect();
    delays.sort_unstable();
    delays.get(delays.len() / 2).copied()
}
