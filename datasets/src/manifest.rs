//! Session manifests: which files are which session, which topics play which role, and what holds for the vehicle.
//!
//! ```yaml
//! site: car_park
//! sessions:
//!   - name: monday
//!     files: [logs/monday_*.mcap]      # parts of one recording; relative to the manifest
//! roles:
//!   frames: ["/camera/*/image_raw/compressed"]
//!   odometry: /odom
//!   transforms: [/tf, /tf_static]
//! bits: { "/camera/*/image_raw": 12 }
//! defaults:
//!   vehicle_frame: base_footprint
//! ```
//!
//! Everything is optional. Roles ([`evermap_schemas::roles`]) that are not given are inferred from message types.
//! `docs/manifests.md` is for people.

mod bits;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use evermap_schemas::Fault;
use evermap_schemas::roles::{self, Choice, Role, Topic, frame_names};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value, json};

use crate::stores::read_text;
use crate::yaml::from_yaml;

pub use bits::{BITS, Bits, TopicBits};

/// A session manifest.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "evermap session manifest")]
pub struct Manifest {
    /// Site of every session that names none itself. Sessions of one site make one map; where nobody says a site, each
    /// session is a site of its own.
    pub site: Option<String>,
    /// Sessions, in addition to those given on the command line.
    pub sessions: Vec<SessionFiles>,
    /// Topics by role, for all sessions. A topic may be a pattern, in which `*` stands for anything.
    #[serde(deserialize_with = "topics_by_role")]
    #[schemars(schema_with = "roles_schema")]
    pub roles: BTreeMap<String, Vec<String>>,
    /// How many bits the samples of raw images have, by topic.
    #[serde(skip_serializing_if = "Bits::is_empty")]
    #[schemars(schema_with = "Bits::schema")]
    pub bits: Bits,
    /// What holds for the vehicle: parameters of all steps that have them, in place of the plan's own `defaults`. What a
    /// plan says of a step holds.
    #[serde(
        deserialize_with = "nothing_or",
        skip_serializing_if = "BTreeMap::is_empty"
    )]
    pub defaults: BTreeMap<String, Value>,
}

/// One session of a manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionFiles {
    /// Name, unique in the manifest.
    pub name: String,
    /// Files, globs or URLs: the parts of one recording.
    pub files: Vec<String>,
    /// Site that was driven, where it differs from the manifest's.
    #[serde(default)]
    pub site: Option<String>,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "expected a topic, or a list of topics")]
enum Topics {
    One(String),
    Many(Vec<String>),
}

/// A role without topics is one that is not given.
fn topics_by_role<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<BTreeMap<String, Vec<String>>, D::Error> {
    let given = BTreeMap::<String, Option<Topics>>::deserialize(deserializer)?;
    let topics = given
        .into_iter()
        .filter_map(|(role, topics)| match topics? {
            Topics::One(topic) => Some((role, vec![topic])),
            Topics::Many(topics) => Some((role, topics)),
        });
    Ok(topics.collect())
}

/// `defaults:` without anything is none.
fn nothing_or<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<BTreeMap<String, Value>, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or_default())
}

/// The roles that messages play, each with a topic or a list of topics.
fn roles_schema(_: &mut SchemaGenerator) -> Schema {
    let played = roles::ALL.iter().filter(|role| role.messages().is_some());
    let role = |role: &Role| {
        let topics = json!({
            "description": role.doc,
            "type": ["string", "array", "null"],
            "items": {"type": "string"},
        });
        (role.name.to_owned(), topics)
    };
    json_schema!({
        "description": "Topics by role, for all sessions; what is left out is inferred from message types. A topic may be a pattern, in which `*` stands for anything.",
        "type": "object",
        "properties": played.map(role).collect::<Map<String, Value>>(),
        "additionalProperties": false,
    })
}

impl Manifest {
    /// The JSON Schema (draft 2020-12) of manifests. Which parameters there are for `defaults` is not known here.
    pub fn json_schema() -> Value {
        schemars::schema_for!(Self).to_value()
    }

    /// Reads a manifest's text.
    ///
    /// # Errors
    /// A user fault with line and column.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        if text.trim().is_empty() {
            return Ok(Self::default());
        }
        from_yaml(text, "a session manifest")
    }

    /// Reads a manifest file; its relative paths become relative to the manifest's folder.
    ///
    /// # Errors
    /// A user fault when the file cannot be read or is no manifest.
    pub fn load(path: &Path) -> Result<Self, Fault> {
        let at = |fault: Fault| fault.at(path.display());
        let mut manifest = Self::parse(&Self::text(path)?).map_err(at)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for file in manifest.sessions.iter_mut().flat_map(|s| &mut s.files) {
            if !file.contains("://") && !Path::new(file).is_absolute() {
                *file = folder.join(&*file).to_string_lossy().into_owned();
            }
        }
        Ok(manifest)
    }

    /// The vehicle, as far as `defaults` name it.
    pub fn vehicle(&self) -> Vehicle {
        let frame = self.defaults.get(Vehicle::PARAMETER);
        Vehicle::of_frame(frame.and_then(Value::as_str).unwrap_or_default())
    }

    /// The text of a manifest file.
    ///
    /// # Errors
    /// A user fault when it cannot be read.
    pub fn text(path: &Path) -> Result<String, Fault> {
        read_text(path).map_err(|error| {
            let fault = format!("expected a session manifest, found {error}");
            Fault::user(fault).at(path.display())
        })
    }
}

/// The vehicle, by the frame that poses are of; no name where nobody says it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Vehicle(Arc<str>);

impl Vehicle {
    /// The parameter of steps, and so the key of `defaults`, that says which frame poses are of.
    pub const PARAMETER: &'static str = "vehicle_frame";

    /// The vehicle whose frame is called so; one that nobody names where that is empty.
    pub fn of_frame(frame: &str) -> Self {
        Self(frame.into())
    }

    /// The frame, without the slash that ROS 1 puts in front; empty where nobody names it.
    pub fn frame(&self) -> &str {
        frame_names::plain(&self.0)
    }

    /// As a manifest gives it, to read the same rows of a log again; nothing where nobody names it.
    pub fn to_manifest(&self) -> BTreeMap<String, Value> {
        let named = !self.frame().is_empty();
        let frame = named.then(|| (Self::PARAMETER.to_owned(), Value::from(&*self.0)));
        frame.into_iter().collect()
    }
}

/// Which topics of one session play which role.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Roles(BTreeMap<&'static str, Vec<String>>);

impl Roles {
    /// The topics of a role, by the role's name; ascending.
    pub fn topics(&self, role: &str) -> &[String] {
        self.0.get(role).map_or(&[], Vec::as_slice)
    }

    /// Whether the role has been given topics, or none.
    pub(crate) fn are_given(&self, role: &str) -> bool {
        self.0.contains_key(role)
    }

    /// Gives a role other topics.
    pub(crate) fn give(&mut self, role: &Role, choices: Vec<Choice>) {
        let topics = choices.into_iter().map(|choice| choice.topic);
        self.0.insert(role.name, topics.collect());
    }

    /// As a manifest gives them, to choose the same topics again.
    pub fn to_manifest(&self) -> BTreeMap<String, Vec<String>> {
        let played = self.0.iter().filter(|(_, topics)| !topics.is_empty());
        let exact = |topic: &String| glob::Pattern::escape(topic);
        played
            .map(|(role, topics)| ((*role).to_owned(), topics.iter().map(exact).collect()))
            .collect()
    }

    /// The topics, of those of a session, that a manifest gives to roles.
    ///
    /// # Errors
    /// A user fault when a pattern is malformed, two topics match the pattern of a role that only one plays, those that
    /// match are of types that only other roles are played by, or none of them has fields and the role is read by them.
    pub(crate) fn named(
        roles: &[Role],
        given: &BTreeMap<String, Vec<String>>,
        topics: &[Topic],
    ) -> Result<Self, Fault> {
        let mut named = BTreeMap::new();
        for role in roles {
            if let Some(patterns) = given.get(role.name) {
                named.insert(role.name, matching(roles, role, patterns, topics)?);
            }
        }
        Ok(Self(named))
    }

    /// Gives the roles that a manifest leaves out the topics that are chosen for them. Choices that another reader might
    /// have made differently are told in the notes.
    pub(crate) fn infer(
        &mut self,
        roles: &[Role],
        choose: impl Fn(&Role) -> Vec<Choice>,
    ) -> Vec<String> {
        let mut notes = Vec::new();
        for role in roles {
            if self.are_given(role.name) {
                continue;
            }
            let choices = choose(role);
            notes.extend(choices.iter().filter_map(|choice| note(role, choice)));
            self.give(role, choices);
        }
        notes
    }
}

fn note(role: &Role, choice: &Choice) -> Option<String> {
    let (name, others) = (role.name, choice.passed_over.join(", "));
    let why = choice
        .why
        .map_or_else(String::new, |why| format!(", {why}"));
    (!others.is_empty()).then(|| {
        format!(
            "{name} is read from {}{why}; {others} would do too: say roles.{name} in a session manifest to choose",
            choice.topic,
        )
    })
}

/// Where a fault is that is of what a manifest says of a role.
pub(crate) const ROLES: &str = "roles.";

/// A fault of what a manifest says of a role.
pub(crate) fn of_role(fault: Fault, role: &str) -> Fault {
    fault.at(format!("{ROLES}{role}"))
}

/// The role that a manifest says something wrong of, where that is what a fault of opening logs is about.
pub fn faulty_role(fault: &Fault) -> Option<&str> {
    fault.place.strip_prefix(ROLES)
}

/// How it begins where a fault is in what a manifest says of a session; what follows is the path of the entry.
const SESSIONS: &str = "sessions[";

/// A fault of a file of a manifest's session, both by their place in the manifest.
pub(crate) fn of_file(fault: Fault, session: usize, file: usize) -> Fault {
    fault.at(format!("{SESSIONS}{session}].files[{file}]"))
}

/// A fault of the name of a manifest's session.
pub(crate) fn of_name(fault: Fault, session: usize) -> Fault {
    fault.at(format!("{SESSIONS}{session}].name"))
}

/// The path of what a manifest says wrong of a session, such as `sessions[0].files[1]`, where that is what a fault of
/// finding logs is about, and where else the fault is.
pub fn faulty_session(fault: &Fault) -> Option<(&str, &str)> {
    let place = fault.place.as_str();
    let is_session = place.starts_with(SESSIONS);
    is_session.then(|| place.split_once(": ").unwrap_or((place, "")))
}

/// The fault of finding logs by a manifest that nobody wrote, so that nobody is sent there.
pub fn unwritten(fault: Fault) -> Fault {
    match faulty_session(&fault).map(|(_, place)| place.to_owned()) {
        Some(place) => Fault { place, ..fault },
        None => fault,
    }
}

/// The topics that fit a manifest's patterns; those of a type that only other roles are played by are left out.
fn matching(
    roles: &[Role],
    role: &Role,
    patterns: &[String],
    topics: &[Topic],
) -> Result<Vec<String>, Fault> {
    let at = |fault: Fault| of_role(fault, role.name);
    let compiled = patterns.iter().map(|pattern| {
        glob::Pattern::new(pattern)
            .map_err(|error| at(Fault::user(format!("the topic pattern {pattern}: {error}"))))
    });
    let compiled = compiled.collect::<Result<Vec<_>, _>>()?;
    let fits = |topic: &&Topic| compiled.iter().any(|pattern| pattern.matches(&topic.name));
    let (others, found): (Vec<_>, Vec<_>) = topics
        .iter()
        .filter(fits)
        .partition(|topic| is_of_others(roles, role, topic));
    if let ([], [other, ..]) = (found.as_slice(), others.as_slice()) {
        let types = role.messages().map_or(&[][..], |messages| messages.types);
        return Err(at(Fault::user(format!(
            "expected a topic of {} for the role {}, found {} of {}",
            types.join(" or "),
            role.name,
            other.name,
            other.message_type,
        ))));
    }
    // Where others play the role too, what cannot be read of one is counted.
    if let [first, ..] = found.as_slice()
        && found.iter().all(|topic| role.unfit(topic).is_some())
        && let Some(why) = role.unfit(first)
    {
        let fault = format!(
            "expected a topic for the role {} whose messages have fields, found {}: {why}",
            role.name, first.name
        );
        return Err(at(
            Fault::user(fault).next("record it with a schema that names them")
        ));
    }
    let found: Vec<String> = found.iter().map(|topic| topic.name.clone()).collect();
    let single = role.messages().is_some_and(|messages| messages.single);
    match found.len() > 1 && single {
        true => Err(at(Fault::user(format!(
            "expected one topic, found {}",
            found.join(", ")
        )))),
        false => Ok(found),
    }
}

/// Whether a topic's type is known to play roles, but not this one. A type that nobody knows may hold anything.
fn is_of_others(roles: &[Role], role: &Role, topic: &Topic) -> bool {
    let plays = |role: &Role| {
        let messages = role.messages();
        messages.is_some_and(|messages| messages.types.contains(&topic.message_type.as_str()))
    };
    !plays(role) && roles.iter().any(plays)
}

#[cfg(test)]
mod tests;
