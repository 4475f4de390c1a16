//! Which topics of a session are of its vehicle, where those of several robots would do.
//!
//! A manifest, a plan or a setting may name the vehicle's frame, and messages of odometry the vehicle that they are of: the
//! topic of that one plays the role, and one of another robot is refused. Where robots have a namespace each, all roles are
//! played by topics of one.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use evermap_schemas::roles::frame_names::{are_of_two_robots, shown, split};
use evermap_schemas::roles::robots::told_name;
use evermap_schemas::roles::{
    CAMERA_FRAMES, CalibratedFrame, Choice, Messages, Motion, Namespaces, Robots, Role, Topic,
};
use evermap_schemas::{Fault, LayerRow};

use crate::manifest::{Roles, Vehicle, of_role};
use crate::roles::ahead::first;
use crate::roles::cameras;
use crate::roles::robots::tells;
use crate::roles::rows::SessionFacts;
use crate::session::{LogPart, Session};

/// Topics that are asked for their vehicle; of a forged log that has more, the others are not.
const MOST: usize = 100;

/// What the topics of a session are chosen by, where a manifest does not give them to a role.
#[derive(Debug)]
pub(crate) struct OfVehicle<'t> {
    topics: &'t [Topic],
    /// The topics of the vehicle whose frame is named, by the role that others would play too.
    by_frame: BTreeMap<&'static str, Vec<String>>,
    /// The robots that have a namespace each.
    robots: Namespaces,
    /// That of the vehicle, where there are any.
    namespace: Option<String>,
    /// That nobody said so.
    note: Option<String>,
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
            if !named.are_given(role.name) {
                let own = topics_of(role, parts, topics, vehicle.frame()).await;
                by_frame.insert(role.name, own);
            }
        }
        by_frame.retain(|_, own| !own.is_empty());
        let robots = robots(roles, parts, topics).await;
        let said = said(&robots, roles, named, &by_frame);
        let namespace = said.or_else(|| robots.usual()).map(str::to_owned);
        let unsaid = namespace.as_ref().filter(|_| said.is_none());
        Self {
            topics,
            by_frame,
            note: unsaid.map(|namespace| robots.note(namespace)),
            robots,
            namespace,
        }
    }

    /// The topics that are no other robot's.
    pub fn topics(&self) -> Vec<Topic> {
        match &self.namespace {
            Some(namespace) => self.robots.own(namespace, self.topics),
            None => self.topics.to_vec(),
        }
    }

    /// The topics that play a role.
    pub fn choices(&self, role: &Role) -> Vec<Choice> {
        let of_vehicle = |topic: &&String| {
            let of_topic = self.robots.of_topic(topic);
            of_topic.is_none_or(|found| Some(found) == self.namespace.as_deref())
        };
        let by_frame = self.by_frame.get(role.name).into_iter().flatten();
        let mut by_frame = by_frame.filter(of_vehicle).cloned();
        match (by_frame.next(), &self.namespace) {
            (Some(topic), _) => vec![Choice {
                topic,
                passed_over: by_frame.collect(),
                why: None,
            }],
            (None, Some(namespace)) => self.robots.infer(namespace, role, self.topics),
            (None, None) => role.infer(self.topics),
        }
    }

    /// Whether another vehicle might have had other topics chosen.
    pub fn matters(&self) -> bool {
        !self.by_frame.is_empty()
    }

    /// That one of several robots was taken for the vehicle, though nobody said so, and how a person chooses.
    pub fn note(&self) -> Option<&str> {
        self.note.as_deref()
    }

    /// That what a manifest gives to a role is not of another robot than what plays the others, where that one has a topic
    /// that would do.
    ///
    /// # Errors
    /// A user fault that names both.
    pub fn check(&self, role: &Role, played: &[String]) -> Result<(), Fault> {
        let Some(namespace) = &self.namespace else {
            return Ok(());
        };
        let stray = self.robots.stray(namespace, role, played, self.topics);
        let Some(stray) = stray else {
            return Ok(());
        };
        let other = self.robots.of_topic(stray.topic).unwrap_or_default();
        let own = told_name(namespace);
        let fault = format!(
            "expected topics of one robot, found {} for the role {}, and others behind {own}",
            shown(stray.topic),
            role.name,
        );
        let next = format!(
            "give it topics behind {own}, such as {}, or read all behind {}: {}",
            shown(&stray.own),
            told_name(other),
            self.robots.choice(other),
        );
        Err(of_role(Fault::user(fault).next(next), role.name))
    }
}

/// The robots of a session that have a namespace each, where their frames do not say that they are one vehicle.
async fn robots(roles: &[Role], parts: &[Arc<LogPart>], topics: &[Topic]) -> Namespaces {
    let mut robots = Namespaces::of(topics);
    let telling = roles.iter().find_map(|role| role.messages()?.vehicle);
    let Some(messages) = telling else {
        return Namespaces::default();
    };
    for (namespace, topic) in robots.odometry().into_iter().take(MOST) {
        if let Some(frame) = named_by(messages, parts, &topic).await {
            robots.name(&namespace, frame);
        }
    }
    match robots.may_be_one() && !share_cameras(&robots, parts, topics).await {
        true => Namespaces::default(),
        false => robots,
    }
}

/// Whether calibrations of two robots name one frame.
async fn share_cameras(robots: &Namespaces, parts: &[Arc<LogPart>], topics: &[Topic]) -> bool {
    let mut of_frame = BTreeMap::<String, &str>::new();
    let calibrations = cameras::ROLE.infer(topics).into_iter().take(MOST);
    for topic in calibrations.map(|choice| choice.topic).collect::<Vec<_>>() {
        let Some(namespace) = robots.of_topic(&topic) else {
            continue;
        };
        let found = first_row::<CalibratedFrame>(&CAMERA_FRAMES, parts, &topic).await;
        let Some(CalibratedFrame { frame }) = found else {
            continue;
        };
        if *of_frame.entry(frame).or_insert(namespace) != namespace {
            return true;
        }
    }
    false
}

/// The namespace of the vehicle, as a person says it: that of the odometry that a manifest names, or that is of the frame
/// that is named, else of other topics that a manifest names.
fn said<'r>(
    robots: &'r Namespaces,
    roles: &[Role],
    named: &Roles,
    by_frame: &BTreeMap<&'static str, Vec<String>>,
) -> Option<&'r str> {
    let tells = |role: &&Role| role.messages().is_some_and(|told| told.vehicle.is_some());
    let (odometry, others): (Vec<&Role>, Vec<&Role>) = roles.iter().partition(tells);
    let given = |roles: &[&Role]| {
        let mut roles = roles.iter();
        roles.find_map(|role| robots.of_all(named.topics(role.name)))
    };
    let by_frame = || by_frame.values().find_map(|topics| robots.of_all(topics));
    given(&odometry)
        .or_else(by_frame)
        .or_else(|| given(&others))
}

/// The topics that may play a role for the vehicle of this frame, as the role ranks them: those whose messages are of that
/// very frame, else of one with its prefix. None where there is no choice among topics, or all of them do.
async fn topics_of(
    role: &Role,
    parts: &[Arc<LogPart>],
    topics: &[Topic],
    frame: &str,
) -> Vec<String> {
    let messages = role.messages().and_then(|messages| messages.vehicle);
    let Some(messages) = messages.filter(|_| !frame.is_empty()) else {
        return Vec::new();
    };
    let candidates = candidates(role, messages, topics);
    if candidates.len() < 2 {
        return Vec::new();
    }
    let (all, (prefix, _)) = (candidates.len(), split(frame));
    let (mut of_frame, mut of_robot) = (Vec::new(), Vec::new());
    for topic in candidates.into_iter().take(MOST) {
        let named = named_by(messages, parts, &topic).await;
        let named = named.unwrap_or_default();
        if named == frame {
            of_frame.push(topic);
        } else if !prefix.is_empty() && split(&named).0 == prefix {
            of_robot.push(topic);
        }
    }
    let mut found = match of_frame.is_empty() {
        true => of_robot,
        false => of_frame,
    };
    if found.len() == all {
        found.clear();
    }
    found
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
    let Motion { child, .. } = first_row(messages, parts, topic).await?;
    (!child.is_empty()).then_some(child)
}

/// The first row that a topic's messages become.
async fn first_row<T: LayerRow>(
    messages: &Messages,
    parts: &[Arc<LogPart>],
    topic: &str,
) -> Option<T> {
    for part in parts {
        if !tells(messages, part, topic) {
            continue;
        }
        // What cannot be read of a topic is told where its rows are read.
        let found = first::<T>(*messages, part, topic, SessionFacts::default()).await;
        if let Ok(Some(found)) = found {
            return Some(found);
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
        let own = topics_of(role, &session.parts, topics, frame).await;
        let fault = match own.first() {
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
