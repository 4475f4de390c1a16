//! Which robot the rows of a role are of, where its topics may tell of several: read from all their messages, unless the
//! first ones settle it.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::roles::{Choice, Messages, Motion, OdometryOf, Robots, Role, Topic};
use evermap_schemas::{Fault, rows};
use futures::TryStreamExt;
use tokio::sync::OnceCell;

use crate::fault::OrFault;
use crate::losses::{Loss, Reason};
use crate::manifest::Vehicle;
use crate::roles::ahead::{AT_ONCE, batches};
use crate::roles::rows::{Meant, SessionFacts};
use crate::session::{LogPart, Session};

/// Messages of odometry that say which frames those of their topic are of. The very first may be sent before its sender
/// knows them.
const FIRST: usize = 16;

/// The robots that are meant, by session.
#[derive(Debug)]
pub(super) struct RobotOf {
    /// How messages become the motions of robots.
    messages: Messages,
    /// How messages of odometry do.
    odometry: Option<&'static Messages>,
    sessions: BTreeMap<Arc<str>, SessionRobot>,
}

/// What a session says of its robot.
#[derive(Debug)]
struct SessionRobot {
    /// The vehicle that its manifest names, if any.
    vehicle: Vehicle,
    /// Files and topics of it that have robots.
    places: Vec<(Arc<LogPart>, String)>,
    /// Those that have odometry of one vehicle, where somebody asked for them.
    odometry: Vec<(Arc<LogPart>, String)>,
    /// The odometry that is meant, once somebody asked.
    meant: OnceCell<Meant>,
}

impl RobotOf {
    /// Those of a role; its topics' messages become the motions of robots so, transforms and odometry.
    pub fn new(
        messages: Messages,
        odometry: Option<&'static Messages>,
        role: &str,
        sessions: &[Session],
    ) -> Self {
        let sessions = sessions.iter();
        Self {
            messages,
            odometry,
            sessions: sessions
                .map(|session| {
                    let mut robot = SessionRobot::of(&messages, role, session);
                    robot.odometry = places(odometry, role, session);
                    (session.name.clone(), robot)
                })
                .collect(),
        }
    }

    /// The odometry that is meant of a session. Where there is none among its transforms it is counted, with the
    /// transforms that there are.
    ///
    /// # Errors
    /// A user fault where several may be; as reading the log.
    pub async fn of(&self, session: &str) -> Result<Meant, Fault> {
        match self.sessions.get(session) {
            Some(robot) => {
                let read = || async {
                    match (robot.places.is_empty(), self.odometry) {
                        (true, Some(odometry)) => Ok(robot.usual(*odometry).await),
                        _ => robot.meant(self.messages).await,
                    }
                };
                robot.meant.get_or_try_init(read).await.cloned()
            }
            None => Ok(Meant::default()),
        }
    }
}

/// The topics that play a role in place of those whose transforms move no vehicle, where others would do and nobody
/// chose; and a sentence that says so. `None` where the role stays with its topics.
///
/// # Errors
/// A fault of ours.
pub(crate) async fn instead(
    role: &Role,
    session: &Session,
    topics: &[Topic],
) -> Result<Option<(Vec<Choice>, String)>, Fault> {
    let Some(robots) = role.messages().and_then(|messages| messages.robots) else {
        return Ok(None);
    };
    let others = topics.iter().filter(|topic| !may_tell(robots, topic));
    let others: Vec<Topic> = others.cloned().collect();
    let mut choices = role.infer(&others);
    choices.retain(|choice| !session.is_silent(&choice.topic));
    let robot = SessionRobot::of(robots, role.name, session);
    if choices.is_empty() || robot.places.is_empty() {
        return Ok(None);
    }
    let Some(missing) = robot.missing(*robots).await else {
        return Ok(None);
    };
    let names = |names: &mut dyn Iterator<Item = &String>| {
        let names: Vec<&str> = names.map(String::as_str).collect();
        names.join(", ")
    };
    let note = format!(
        "{} is read from {}: {} moves no vehicle ({})",
        role.name,
        names(&mut choices.iter().map(|choice| &choice.topic)),
        names(&mut session.roles.topics(role.name).iter()),
        missing,
    );
    Ok(Some((choices, note)))
}

/// Why nothing comes of the topics that play a role, as their transforms move no vehicle, and what a manifest may say; `None`
/// where they do, or where reading the role's rows tells.
pub(crate) async fn unmoved(role: &Role, session: &Session) -> Option<String> {
    let robots = role.messages()?.robots?;
    let robot = SessionRobot::of(robots, role.name, session);
    let mut topics = robot.places.iter().map(|(_, topic)| topic);
    if topics.all(|topic| session.is_silent(topic)) {
        return None;
    }
    robot.missing(*robots).await
}

/// Whether there is any robot, even if a manifest must say which one is meant.
fn has_any(robots: &Robots, frame: &str) -> bool {
    !matches!(robots.meant(frame), Ok(None))
}

impl SessionRobot {
    fn of(messages: &Messages, role: &str, session: &Session) -> Self {
        Self {
            vehicle: session.vehicle.clone(),
            places: places(Some(messages), role, session),
            odometry: Vec::new(),
            meant: OnceCell::new(),
        }
    }

    async fn meant(&self, messages: Messages) -> Result<Meant, Fault> {
        let Some((part, topic)) = self.places.first() else {
            return Ok(Meant::default());
        };
        let frame = self.vehicle.frame();
        let robots = self.read(messages, Robots::settle).await?;
        match robots.meant(frame) {
            Ok(Some(odometry)) => Ok(Meant {
                motion: robots.motion_of(&odometry),
                odometry,
            }),
            Ok(None) => {
                let (loss, why) = (Loss::one(0), robots.missing(frame));
                let losses = &part.losses;
                losses.note_topic(Reason::NoVehicle, topic, 0, loss, why);
                Ok(Meant::default())
            }
            Err(fault) => Err(fault.at(format!("topic {topic}")).at(&part.url)),
        }
    }

    /// The odometry that most of the first messages have. What cannot be read is told where rows are read.
    async fn usual(&self, messages: Messages) -> Meant {
        for (part, topic) in &self.odometry {
            let batches = batches::<Motion>(messages, part, topic, SessionFacts::default(), FIRST);
            let Ok(mut batches) = batches else { continue };
            let mut found = Vec::new();
            while found.len() < FIRST
                && let Ok(Some(batch)) = batches.try_next().await
            {
                found.extend(rows::<Motion>(&batch).unwrap_or_default());
            }
            if let Some(Motion { parent, child }) = most(&found) {
                let odometry = OdometryOf::Frame { parent, child };
                return Meant {
                    odometry,
                    motion: None,
                };
            }
        }
        Meant::default()
    }

    /// Why its topics move no vehicle, with what a manifest may say. `None` where they have a robot: whether it is the one
    /// that is meant, reading the role's rows tells; and so it does of a topic that cannot be read.
    async fn missing(&self, messages: Messages) -> Option<String> {
        let found = self.read(messages, has_any).await.ok()?;
        let frame = self.vehicle.frame();
        (!has_any(&found, frame)).then(|| found.missing(frame))
    }

    /// The robots of its topics, until they are enough for the vehicle's frame.
    async fn read(
        &self,
        messages: Messages,
        enough: fn(&Robots, &str) -> bool,
    ) -> Result<Robots, Fault> {
        let mut robots = Robots::default();
        for (part, topic) in &self.places {
            let mut batches =
                batches::<Motion>(messages, part, topic, SessionFacts::default(), AT_ONCE)?;
            while !enough(&robots, self.vehicle.frame())
                && let Some(batch) = batches.try_next().await.or_fault()?
            {
                let found = rows::<Motion>(&batch)?;
                let found = found.iter();
                found.for_each(|motion| robots.add(&motion.parent, &motion.child));
            }
        }
        Ok(robots)
    }
}

/// The frames that most messages have; of as many, the first.
fn most(found: &[Motion]) -> Option<Motion> {
    let like = |one: &&Motion| Reverse(found.iter().filter(|other| other == one).count());
    found.iter().min_by_key(like).cloned()
}

/// Files and topics that play a role in a session, with messages of such types.
fn places(
    messages: Option<&Messages>,
    role: &str,
    session: &Session,
) -> Vec<(Arc<LogPart>, String)> {
    let Some(messages) = messages else {
        return Vec::new();
    };
    let topics = session.roles.topics(role).iter();
    let places = topics.flat_map(|topic| {
        let parts = session.parts.iter();
        let telling = parts.filter(move |part| tells(messages, part, topic));
        telling.map(move |part| (part.clone(), topic.clone()))
    });
    places.collect()
}

/// Whether a topic's messages in a file are of a type that tells of robots, or of a vehicle.
pub(super) fn tells(robots: &Messages, part: &LogPart, topic: &str) -> bool {
    part.channels_of(topic).any(|channel| {
        let schema = part.index.schema_of(channel);
        schema.is_some_and(|schema| may_tell(robots, &Topic::new(topic, &schema.name, 0)))
    })
}

fn may_tell(robots: &Messages, topic: &Topic) -> bool {
    robots.types.contains(&topic.message_type.as_str())
}

/// Whether rows of a session depend on which robot is the vehicle.
pub(crate) fn matter(roles: &[Role], session: &Session) -> bool {
    roles.iter().any(|role| {
        let robots = role.messages().and_then(|messages| messages.robots);
        robots.is_some_and(|robots| {
            !SessionRobot::of(robots, role.name, session)
                .places
                .is_empty()
        })
    })
}
