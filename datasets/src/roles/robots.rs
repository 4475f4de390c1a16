//! Which robot the rows of a role are of, where its topics may tell of several: read from all their messages, unless the
//! first ones settle it.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::roles::{Messages, Robot, Robots, Topic};
use evermap_schemas::{Fault, rows};
use futures::TryStreamExt;
use tokio::sync::OnceCell;

use crate::fault::OrFault;
use crate::manifest::Vehicle;
use crate::roles::ahead::batches;
use crate::session::{LogPart, Session};

/// Messages that are looked at together.
const AT_ONCE: usize = 1024;

/// The robots that are meant, by session.
#[derive(Debug)]
pub(super) struct RobotOf {
    /// How messages become robots.
    messages: Messages,
    sessions: BTreeMap<Arc<str>, Asked>,
}

/// What a session says of its robot.
#[derive(Debug)]
struct Asked {
    /// The vehicle that its manifest names, if any.
    vehicle: Vehicle,
    /// Files and topics of it that have robots.
    places: Vec<(Arc<LogPart>, String)>,
    /// The one that is meant, once somebody asked.
    robot: OnceCell<String>,
}

impl RobotOf {
    /// Those of a role; its topics' messages become robots so.
    pub fn new(messages: Messages, role: &str, sessions: &[Session]) -> Self {
        let asked = |session: &Session| {
            let topics = session.roles.topics(role).iter();
            let places = topics.flat_map(|topic| {
                let parts = session.parts.iter();
                let telling = parts.filter(move |part| tells(&messages, part, topic));
                telling.map(move |part| (part.clone(), topic.clone()))
            });
            Asked {
                vehicle: session.vehicle.clone(),
                places: places.collect(),
                robot: OnceCell::new(),
            }
        };
        let sessions = sessions.iter();
        Self {
            messages,
            sessions: sessions
                .map(|session| (session.name.clone(), asked(session)))
                .collect(),
        }
    }

    /// The prefix of the robot that is meant of a session.
    ///
    /// # Errors
    /// A user fault where several may be; as reading the log.
    pub async fn of(&self, session: &str) -> Result<String, Fault> {
        match self.sessions.get(session) {
            Some(asked) => {
                let read = || asked.read(self.messages);
                asked.robot.get_or_try_init(read).await.cloned()
            }
            None => Ok(String::new()),
        }
    }
}

impl Asked {
    async fn read(&self, messages: Messages) -> Result<String, Fault> {
        let mut robots = Robots::default();
        for (part, topic) in &self.places {
            let mut batches = batches::<Robot>(messages, part, topic, AT_ONCE)?;
            while !robots.has(self.vehicle.robot())
                && let Some(batch) = batches.try_next().await.or_fault()?
            {
                let found = rows::<Robot>(&batch)?;
                found.iter().for_each(|robot| robots.add(&robot.frame));
            }
        }
        let meant = robots.meant(self.vehicle.robot()).map(str::to_owned);
        meant.map_err(|fault| match self.places.first() {
            Some((part, topic)) => fault.at(format!("topic {topic}")).at(&part.url),
            None => fault,
        })
    }
}

/// Whether a topic's messages in a file are of a type that tells of robots.
fn tells(robots: &Messages, part: &LogPart, topic: &str) -> bool {
    part.channels_of(topic).any(|channel| {
        let schema = part.index.schema_of(channel);
        let typed = schema.map(|schema| Topic::new(topic, &schema.name, 0).message_type);
        typed.is_some_and(|found| robots.types.contains(&found.as_str()))
    })
}
