//! Robots that share a log and have their topics behind a namespace each, `/robot1/odom` and `/robot2/odom`: their frames
//! may be called alike.

use std::collections::{BTreeMap, BTreeSet};

use super::told;
use crate::roles::frame_names::{shown, split};
use crate::roles::{ALL, Choice, Robots, Role, Topic, odometry, transforms};

/// The robots of a session that have a namespace each: none, or several.
///
/// One has odometry, and beside it a topic that plays a role and is called as one of another's: `/robot1/front/image` and
/// `/robot2/front/image`. A camera with odometry of its own is no robot beside the wheels.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Namespaces {
    /// What stands before the names of all: `/`.
    above: String,
    /// By namespace, with a slash behind it: `/robot1/`.
    robots: BTreeMap<String, Namespaced>,
    /// Whether there are transforms of none of them, so that all their frames are of one tree.
    share_transforms: bool,
}

/// The robot of a namespace.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Namespaced {
    /// The topic with its odometry.
    odometry: String,
    /// Messages of that topic.
    messages: u64,
    /// The frame that its odometry is of; empty where nobody has said it.
    frame: String,
    /// Roles that its other topics play.
    roles: BTreeSet<&'static str>,
    /// What these topics are called behind the namespace.
    names: BTreeSet<String>,
}

impl Namespaces {
    /// The robots of a session's topics, as far as the names of topics tell.
    pub fn of(topics: &[Topic]) -> Self {
        let messages = topics.iter().filter(|topic| topic.messages > 0);
        let messages: BTreeMap<&str, u64> = messages
            .map(|topic| (topic.name.as_str(), topic.messages))
            .collect();
        let played = |role: &Role| {
            let mut played = ranked(role, topics);
            played.retain(|topic| messages.contains_key(topic.as_str()));
            played
        };
        let of_odometry = played(&odometry::ROLE);
        let mut found = Self {
            above: above(&of_odometry),
            ..Self::default()
        };
        for topic in of_odometry {
            // Odometry beside the namespaces may be anybody's.
            let Some(namespace) = found.namespace(&topic).map(str::to_owned) else {
                return Self::default();
            };
            let robot = Namespaced {
                messages: messages.get(topic.as_str()).copied().unwrap_or(0),
                odometry: topic,
                frame: String::new(),
                roles: BTreeSet::new(),
                names: BTreeSet::new(),
            };
            found.robots.entry(namespace).or_insert(robot);
        }
        if found.robots.len() < 2 {
            return Self::default();
        }
        for role in ALL.iter().filter(|role| role.name != odometry::ROLE.name) {
            for topic in played(role) {
                found.add(role.name, &topic);
            }
        }
        found.drop_unlike();
        let shared = |topic: &String| found.of_topic(topic).is_none();
        found.share_transforms = played(&transforms::ROLE).iter().any(shared);
        match found.robots.len() {
            0 | 1 => Self::default(),
            _ => found,
        }
    }

    /// Notes that a topic plays a role.
    fn add(&mut self, role: &'static str, topic: &str) {
        let Some(namespace) = self.namespace(topic) else {
            return;
        };
        let name = topic.strip_prefix(namespace).unwrap_or_default();
        if let Some(robot) = self.robots.get_mut(namespace) {
            robot.roles.insert(role);
            robot.names.insert(name.to_owned());
        }
    }

    /// Drops those that have no topic which is called as one of another's.
    fn drop_unlike(&mut self) {
        let mut seen = BTreeMap::<String, usize>::new();
        for name in self.robots.values().flat_map(|robot| &robot.names) {
            *seen.entry(name.clone()).or_default() += 1;
        }
        let is_shared = |name: &String| seen.get(name).is_some_and(|robots| *robots > 1);
        self.robots
            .retain(|_, robot| robot.names.iter().any(is_shared));
    }

    /// What a topic's name begins with as far as the first word that tells robots apart.
    fn namespace<'n>(&self, topic: &'n str) -> Option<&'n str> {
        let rest = topic.strip_prefix(&self.above)?;
        let (word, _) = rest.split_once('/')?;
        topic.get(..self.above.len() + word.len() + 1)
    }

    /// The namespace that a topic is of; `None` where it is none of these robots'.
    pub fn of_topic(&self, topic: &str) -> Option<&str> {
        let namespace = self.namespace(topic)?;
        let found = self.robots.get_key_value(namespace);
        found.map(|(namespace, _)| namespace.as_str())
    }

    /// The namespace that topics are of, but for those that are no robot's; `None` where they are of several, or of none.
    pub fn of_all(&self, topics: &[String]) -> Option<&str> {
        let mut found = topics.iter().filter_map(|topic| self.of_topic(topic));
        let first = found.next()?;
        found.all(|other| other == first).then_some(first)
    }

    /// The topic with the odometry of each, by namespace.
    pub fn odometry(&self) -> BTreeMap<String, String> {
        let robots = self.robots.iter();
        robots
            .map(|(namespace, robot)| (namespace.clone(), robot.odometry.clone()))
            .collect()
    }

    /// Notes the frame that the odometry of a namespace is of.
    pub fn name(&mut self, namespace: &str, frame: String) {
        if let Some(robot) = self.robots.get_mut(namespace) {
            robot.frame = frame;
        }
    }

    /// Whether each has frames of its own, behind a prefix.
    fn have_prefixes(&self) -> bool {
        let prefixes = self.robots.values().map(|robot| split(&robot.frame).0);
        let prefixes: BTreeSet<&str> = prefixes.filter(|prefix| !prefix.is_empty()).collect();
        prefixes.len() == self.robots.len()
    }

    /// Whether they may be parts of one vehicle, unless cameras of two have one frame: all their frames are of one tree, and
    /// have no prefixes.
    pub fn may_be_one(&self) -> bool {
        self.share_transforms && !self.have_prefixes()
    }

    /// The namespace that is read where nobody chooses: that of most roles, then of most messages with odometry, then the
    /// first by name. `None` where there are none.
    pub fn usual(&self) -> Option<&str> {
        let robots = self.robots.iter().rev();
        let most = robots.max_by_key(|(_, robot)| (robot.roles.len(), robot.messages));
        most.map(|(namespace, _)| namespace.as_str())
    }

    /// Those of some topics that are no other robot's than that of a namespace.
    pub fn own(&self, namespace: &str, topics: &[Topic]) -> Vec<Topic> {
        let topics = topics.iter().filter(|topic| {
            let of_topic = self.of_topic(&topic.name);
            of_topic.is_none_or(|found| found == namespace)
        });
        topics.cloned().collect()
    }

    /// The topics that play a role for the robot of a namespace: no other robot's. One that a single topic plays is played
    /// by the robot's own, where it has one with messages.
    pub fn infer(&self, namespace: &str, role: &Role, topics: &[Topic]) -> Vec<Choice> {
        let own = self.own(namespace, topics);
        if role.messages().is_some_and(|messages| messages.single) {
            let within = |topic: &&Topic| {
                topic.messages > 0 && self.of_topic(&topic.name) == Some(namespace)
            };
            let within: Vec<Topic> = own.iter().filter(within).cloned().collect();
            let choices = role.infer(&within);
            if !choices.is_empty() {
                return choices;
            }
        }
        role.infer(&own)
    }

    /// A topic of another robot than that of a namespace, among those that play a role: where all that are some robot's are
    /// of others, or any is and frames of robots are called alike. `None` where none is so, or the robot has no topic that
    /// would do.
    pub fn stray<'t>(
        &self,
        namespace: &str,
        role: &Role,
        played: &'t [String],
        topics: &[Topic],
    ) -> Option<Stray<'t>> {
        let is_of = |topic: &&String, own: bool| {
            let of_topic = self.of_topic(topic);
            of_topic.is_some_and(|found| (found == namespace) == own)
        };
        let stray = played.iter().find(|topic| is_of(topic, false))?;
        if self.have_prefixes() && played.iter().any(|topic| is_of(&topic, true)) {
            return None;
        }
        let own = self.infer(namespace, role, topics).into_iter();
        let own = own
            .map(|choice| choice.topic)
            .find(|topic| is_of(&topic, true))?;
        Some(Stray { topic: stray, own })
    }

    /// That the robot of a namespace was taken for the vehicle, which others might be, and how a person chooses one.
    pub fn note(&self, namespace: &str) -> String {
        let others = || {
            let robots = self.robots.iter();
            robots.filter(move |(other, _)| other.as_str() != namespace)
        };
        let names = others().map(|(other, _)| told_name(other));
        let names = told(names, self.robots.len().saturating_sub(1));
        let choice = others().next().map(|(other, _)| self.choice(other));
        format!(
            "topics of several robots would do: those behind {} are read, and none behind {names}; {}",
            told_name(namespace),
            choice.unwrap_or_default(),
        )
    }

    /// How a person says that the robot of a namespace is the vehicle.
    pub fn choice(&self, namespace: &str) -> String {
        let robot = self.robots.get(namespace);
        match robot {
            Some(robot) if self.have_prefixes() => Robots::choice(&robot.frame),
            _ => format!(
                "say which one is the vehicle in a session manifest: `roles: {{ {}: {} }}`",
                odometry::ROLE.name,
                shown(robot.map_or("", |robot| robot.odometry.as_str())),
            ),
        }
    }
}

/// A topic of another robot than the vehicle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stray<'t> {
    /// Its name.
    pub topic: &'t str,
    /// A topic of the vehicle that would do in its place.
    pub own: String,
}

/// A namespace as a person is told it: `/robot1`.
pub fn told_name(namespace: &str) -> String {
    shown(namespace.trim_end_matches('/'))
}

/// The topics that may play a role, as it ranks them.
fn ranked(role: &Role, topics: &[Topic]) -> Vec<String> {
    let choices = role.infer(topics).into_iter();
    let ranked = choices.map(|choice| [vec![choice.topic], choice.passed_over].concat());
    ranked.collect::<Vec<_>>().concat()
}

/// What the names of all topics begin with, as far as the last slash.
fn above(topics: &[String]) -> String {
    let mut names = topics.iter().map(String::as_str);
    let first = names.next().unwrap_or_default();
    let shared = names.fold(first, |shared, name| {
        let same = shared.bytes().zip(name.bytes());
        let same = same.take_while(|(one, other)| one == other).enumerate();
        let slash = same.filter(|(_, (byte, _))| *byte == b'/').last();
        let end = slash.map_or(0, |(at, _)| at + 1);
        shared.get(..end).unwrap_or_default()
    });
    shared.to_owned()
}

#[cfg(test)]
mod tests;
