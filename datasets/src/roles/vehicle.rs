//! Which topics are of the vehicle that a manifest, a plan or a setting names, where their messages name the vehicle that
//! they are of: the topic of that one plays the role, and one of another robot is refused.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use evermap_schemas::Fault;
use evermap_schemas::roles::frame_names::{are_of_two_robots, shown, split};
use evermap_schemas::roles::{Choice, Messages, OdometryFrame, Robots, Role, Topic};

use crate::manifest::{Roles, Vehicle, of_role};
use crate::roles::ahead::first;
use crate::roles::robots::tells;
use crate::roles::rows::Known;
use crate::session::{LogPart, Session};

/// Topics that are asked for their vehicle; of a forged log that has more, the others are not.
const MOST: usize = 100;

/// What the topics of a session are chosen by, where a manifest does not give them to a role.
#[derive(Debug)]
pub(crate) struct OfVehicle<'t> {
    topics: &'t [Topic],
    /// The topic of the vehicle, by the role that others would play too.
    by_frame: BTreeMap<&'static str, String>,
}

impl<'t> OfVehicle<'t> {
    /// Asks the topics of a session, but for roles that a manifest gives topics to.
    pub async fn of(
        roles: &[Role],
        parts: &[Arc<LogPart>],
        topics: &'t [Topic],
        named: &Roles,
        vehicle: &Vehicle,
    ) -> Self {
        let mut by_frame = BTreeMap::new();
        for role in roles {
            if !named.are_given(role.name)
                && let Some(topic) = topic_of(role, parts, topics, vehicle.frame()).await
            {
                by_frame.insert(role.name, topic);
            }
        }
        Self { topics, by_frame }
    }

    /// The topics that play a role.
    pub fn choices(&self, role: &Role) -> Vec<Choice> {
        match self.by_frame.get(role.name) {
            Some(topic) => vec![Choice {
                topic: topic.clone(),
                passed_over: Vec::new(),
                why: None,
            }],
            None => role.infer(self.topics),
        }
    }

    /// Whether another vehicle might have had other topics chosen.
    pub fn matters(&self) -> bool {
        !self.by_frame.is_empty()
    }
}

/// The topic that plays a role for the vehicle of this frame: the first whose messages are of that very frame, else of one
/// with its prefix. `None` where there is no choice, or none of them is.
async fn topic_of(
    role: &Role,
    parts: &[Arc<LogPart>],
    topics: &[Topic],
    frame: &str,
) -> Option<String> {
    let messages = role.messages()?.vehicle?;
    if frame.is_empty() {
        return None;
    }
    let candidates = candidates(role, messages, topics);
    if candidates.len() < 2 {
        return None;
    }
    let (prefix, _) = split(frame);
    let mut of_robot = None;
    for topic in candidates.into_iter().take(MOST) {
        let Some(named) = named_by(messages, parts, &topic).await else {
            continue;
        };
        if named == frame {
            return Some(topic);
        }
        if of_robot.is_none() && !prefix.is_empty() && split(&named).0 == prefix {
            of_robot = Some(topic);
        }
    }
    of_robot
}

/// The topics with messages that may play a role and name their vehicle, as the role ranks them.
fn candidates(role: &Role, messages: &Messages, topics: &[Topic]) -> Vec<String> {
    let telling = topics.iter().filter(|topic| {
        topic.messages > 0 && messages.types.contains(&topic.message_type.as_str())
    });
    let telling: BTreeSet<&str> = telling.map(|topic| topic.name.as_str()).collect();
    let choices = role.infer(topics).into_iter();
    let ranked = choices.flat_map(|choice| [vec![choice.topic], choice.passed_over].concat());
    ranked
        .filter(|topic| telling.contains(topic.as_str()))
        .collect()
}

/// The frame that the first message of a topic says it is of; `None` where it names none.
async fn named_by(messages: &Messages, parts: &[Arc<LogPart>], topic: &str) -> Option<String> {
    for part in parts {
        if !tells(messages, part, topic) {
            continue;
        }
        // What cannot be read of a topic is told where its rows are read.
        let found = first::<OdometryFrame>(*messages, part, topic, Known::default()).await;
        if let Ok(Some(found)) = found {
            return Some(found.frame).filter(|frame| !frame.is_empty());
        }
    }
    None
}

/// That no topic of a session plays a role whose messages are of another robot than its vehicle, as the prefixes of both
/// frames say. `is_given` says whether a manifest gives the role its topics.
///
/// # Errors
/// A user fault that names both.
pub(crate) async fn check(
    role: &Role,
    session: &Session,
    topics: &[Topic],
    is_given: bool,
) -> Result<(), Fault> {
    let frame = session.vehicle.frame();
    let Some(messages) = role.messages().and_then(|messages| messages.vehicle) else {
        return Ok(());
    };
    if split(frame).0.is_empty() {
        return Ok(());
    }
    for topic in session.roles.topics(role.name) {
        let named = named_by(messages, &session.parts, topic).await;
        let Some(named) = named.filter(|named| are_of_two_robots(named, frame)) else {
            continue;
        };
        let fault = Fault::user(format!(
            "expected {} of {}, found that of {} on {topic}, another robot's",
            role.name,
            shown(frame),
            shown(&named),
        ));
        let fault = match topic_of(role, &session.parts, topics, frame).await {
            Some(own) => fault.next(format!(
                "give the role {} the topic {own} in a session manifest",
                role.name
            )),
            None => fault.next(Robots::choice(&named)),
        };
        return Err(match is_given {
            true => of_role(fault, role.name),
            false => fault.at(format!("session {}", session.name)),
        });
    }
    Ok(())
}
