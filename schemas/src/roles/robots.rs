//! Robots that share a log: whose odometry is among its transforms, and whose is meant.

mod namespaces;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use crate::roles::frame_names::{self, shown};
use crate::roles::transforms;
use crate::roles::{FromMessage, Message};
use crate::{Fault, record};

pub use namespaces::{Namespaces, Stray, told_name};

record! {
    /// A frame in another, as a message of transforms or of odometry says: it may be that a robot's odometry moves it.
    #[layer("motions", key(parent, child))]
    pub struct Motion {
        /// The frame that it moves in, as all frames without the slash that ROS 1 puts in front: `robot1/odom`.
        parent: String,
        /// The frame that moves: `robot1/base_link`; empty where a message of odometry names none.
        child: String,
    }
}

impl FromMessage for Motion {
    const MEMBERS: &'static [&'static str] = &[
        "transforms",
        "header",
        "timestamp",
        "parent_frame_id",
        "child_frame_id",
        "translation",
        "rotation",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let Some(transforms) = transforms::all(message) else {
            return Ok(vec![Self::of_odometry(message)]);
        };
        // What makes no sense is the business of the roles that read it.
        let sound = transforms.into_iter().flatten();
        let found: BTreeSet<_> = sound.map(|found| (found.parent, found.child)).collect();
        let motion = |(parent, child)| Self { parent, child };
        Ok(found.into_iter().map(motion).collect())
    }
}

impl Motion {
    /// The frames of a message of odometry, which has one pose.
    pub(super) fn of_odometry(message: &Message<'_>) -> Self {
        let child = message.fields.text(&["child_frame_id"]);
        Self {
            parent: message.frame(),
            child: frame_names::plain(&child.unwrap_or_default()).to_owned(),
        }
    }
}

/// The robot whose odometry a transform is, as REP 105 names the two frames: from `odom` (or `odom_combined` …) to
/// `base_link` (or `base_footprint` …), both behind the robot's prefix. The prefix; empty where they have none, `None`
/// for any other transform.
fn moved<'f>(parent: &'f str, child: &'f str) -> Option<&'f str> {
    let ((prefix, parent), (same, child)) = (frame_names::split(parent), frame_names::split(child));
    let is_odometry = parent.starts_with("odom") && child.starts_with("base");
    (is_odometry && prefix == same).then_some(prefix)
}

/// Which transforms are the odometry of the robot that is meant.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OdometryOf {
    /// Those that REP 105 names so, behind the robot's prefix.
    Robot(String),
    /// Those of one frame in another, which a manifest names, or most messages of odometry.
    Frame {
        /// The frame that the vehicle moves in.
        parent: String,
        /// The vehicle.
        child: String,
    },
}

impl Default for OdometryOf {
    /// That of the robot whose frames have no prefix.
    fn default() -> Self {
        Self::Robot(String::new())
    }
}

impl OdometryOf {
    /// Whether a transform between two frames is.
    pub fn is(&self, parent: &str, child: &str) -> bool {
        match self {
            Self::Robot(prefix) => moved(parent, child) == Some(prefix.as_str()),
            Self::Frame {
                parent: from,
                child: to,
            } => frame_names::plain(parent) == from && frame_names::plain(child) == to,
        }
    }

    /// That a message of odometry has the pose of another frame, or in another one, than most do: in words. `None` for
    /// those that most are like, and where that is not known.
    pub(super) fn stray(&self, found: &Motion) -> Option<String> {
        let Self::Frame { parent, child } = self else {
            return None;
        };
        (!self.is(&found.parent, &found.child)).then(|| {
            let Motion { parent: from, child: to } = found;
            format!("expected the pose of {child:?} in {parent:?}, as most messages have it, found that of {to:?} in {from:?}")
        })
    }

    /// That a transform moves what `read`, a transform of this odometry, moves, but in another frame: in words. A frame has
    /// one parent (REP 105). `None` for any other transform, and for a joint of the vehicle.
    pub fn contradiction(&self, read: &Motion, other: &Motion) -> Option<String> {
        let is_joint = frame_names::split(&other.parent).1.starts_with("base");
        let is_other = other.child == read.child && !self.is(&other.parent, &other.child);
        (is_other && !is_joint).then(|| {
            let [from, to, too] = [&read.parent, &read.child, &other.parent].map(|f| shown(f));
            format!("{to} moves in {too}, too; odometry is read of {from} -> {to}")
        })
    }
}

/// Robots, and frames that move, that are told apart; of a forged log that has more, the others are not. Nor are frames
/// of so many bytes.
const MOST: usize = 1000;
const LONGEST: usize = 1000;

/// Robots, or transforms, that a person is told.
const TOLD: usize = 8;

/// The robots whose odometry is among some transforms.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Robots {
    /// A frame of each that odometry moves, by the prefix of its frames.
    frames: BTreeMap<String, String>,
    /// Every frame that moves in another: the other, and the frame.
    motions: BTreeSet<(String, String)>,
}

impl Robots {
    /// Adds a transform: the frame that moves in another, and its robot where it is the odometry of one.
    pub fn add(&mut self, parent: &str, child: &str) {
        if parent.len().max(child.len()) > LONGEST {
            return;
        }
        let [parent, child] = [parent, child].map(frame_names::plain);
        if let Some(prefix) = moved(parent, child)
            && self.frames.len() < MOST
        {
            let first = || child.to_owned();
            self.frames.entry(prefix.to_owned()).or_insert_with(first);
        }
        if self.motions.len() < MOST {
            self.motions.insert((parent.to_owned(), child.to_owned()));
        }
    }

    /// Whether more transforms would not change which robot is meant where a manifest names this frame (empty where it
    /// names none), if the first ones tell of every frame.
    pub fn settle(&self, frame: &str) -> bool {
        let (prefix, _) = frame_names::split(frame);
        self.frames.contains_key(prefix) || self.leading_to(frame).is_some()
    }

    /// The odometry that is meant. Where a manifest names the vehicle's frame (else it is empty): the transform that ends
    /// in it, or the odometry, by REP 105, that the frame hangs off. Else that of the robot with the frame's prefix, else
    /// of the one whose frames have none, else of the only one. `None` where there is no robot.
    ///
    /// # Errors
    /// A user fault that names the robots, where it would be a guess.
    pub fn meant(&self, frame: &str) -> Result<Option<OdometryOf>, Fault> {
        let leading = self.leading_to(frame);
        if leading.is_some() {
            return Ok(leading);
        }
        let (named, _) = frame_names::split(frame);
        let known = |prefix: &str| self.frames.get_key_value(prefix);
        let only = || {
            let is_only = named.is_empty() && self.frames.len() == 1;
            self.frames.first_key_value().filter(|_| is_only)
        };
        match known(named).or_else(|| known("")).or_else(only) {
            Some((prefix, _)) => Ok(Some(OdometryOf::Robot(prefix.clone()))),
            None if self.frames.is_empty() => Ok(None),
            None => Err(self.unknown(named)),
        }
    }

    /// The first transform of this odometry by name; `None` where none was added.
    pub fn motion_of(&self, odometry: &OdometryOf) -> Option<Motion> {
        let mut motions = self.motions.iter();
        let (parent, child) = motions.find(|(parent, child)| odometry.is(parent, child))?;
        Some(Motion {
            parent: parent.clone(),
            child: child.clone(),
        })
    }

    /// The transform that a frame hangs off and that REP 105 calls odometry, else the one that ends in it.
    fn leading_to(&self, frame: &str) -> Option<OdometryOf> {
        let frame = Some(frame_names::plain(frame)).filter(|frame| !frame.is_empty());
        let last = self.ending_in(frame?)?;
        let (mut seen, mut at) = (BTreeSet::new(), Some(last));
        // Forged transforms may go round in circles.
        while let Some(motion) = at
            && seen.insert(motion)
        {
            if moved(&motion.0, &motion.1).is_some() {
                return Some(odometry(motion));
            }
            at = self.ending_in(&motion.0);
        }
        Some(odometry(last))
    }

    /// The transform that ends in a frame; odometry before others.
    fn ending_in(&self, frame: &str) -> Option<&(String, String)> {
        let all = || self.motions.iter().filter(move |(_, child)| child == frame);
        let found = all().find(|(parent, child)| moved(parent, child).is_some());
        found.or_else(|| all().next())
    }

    /// Why no odometry is found where a manifest names this frame (empty where it names none), which transforms there
    /// are, and how a manifest chooses one.
    pub fn missing(&self, frame: &str) -> String {
        let wanted = match frame_names::plain(frame) {
            "" => "a transform from odom to base_link".to_owned(),
            frame => format!("a transform that ends in {}", shown(frame)),
        };
        let expected = format!("expected {wanted}, found");
        let is_parent = |frame: &str| self.motions.iter().any(|(parent, _)| parent == frame);
        let odom = |parent: &str| frame_names::split(parent).1.starts_with("odom");
        // What moves on a vehicle, as wheels do, is not the vehicle.
        let mounted = |parent: &str| frame_names::split(parent).1.starts_with("base");
        let vehicles = self.motions.iter().filter(|(parent, _)| !mounted(parent));
        let likely = vehicles.min_by_key(|(parent, child)| (!odom(parent), is_parent(child)));
        match (self.motions.is_empty(), likely) {
            (true, _) => format!("{expected} none"),
            (false, None) => format!(
                "{expected} {}; give the role odometry another topic in a session manifest",
                self.motions_in_words()
            ),
            (false, Some((_, child))) => format!(
                "{expected} {}; {}",
                self.motions_in_words(),
                Self::choice(child)
            ),
        }
    }

    /// The transforms, as far as a person is told: `odom -> chassis, chassis -> wheel`.
    pub fn motions_in_words(&self) -> String {
        let motions = self.motions.iter();
        let motions =
            motions.map(|(parent, child)| format!("{} -> {}", shown(parent), shown(child)));
        told(motions, self.motions.len())
    }

    /// A frame of each, where nobody can tell which one is meant unless it is named; else none.
    pub fn several(&self) -> Vec<&str> {
        match self.meant("") {
            Ok(_) => Vec::new(),
            Err(_) => self.frames.values().map(String::as_str).collect(),
        }
    }

    fn unknown(&self, named: &str) -> Fault {
        let wanted = match named {
            "" => "one robot".to_owned(),
            named => shown(named),
        };
        let found = self.in_words();
        let fault =
            format!("expected the odometry of {wanted} among transforms, found that of {found}");
        let first = self.frames.values().next().map_or("", String::as_str);
        Fault::user(fault).next(Self::choice(first))
    }

    /// How a person says whose odometry is meant.
    pub fn choice(frame: &str) -> String {
        let frame = shown(frame);
        format!(
            "say which one is the vehicle in a session manifest: `defaults: {{ vehicle_frame: {frame} }}`"
        )
    }

    fn in_words(&self) -> String {
        let frames = self.frames.values().map(|frame| shown(frame));
        told(frames, self.frames.len())
    }
}

fn odometry((parent, child): &(String, String)) -> OdometryOf {
    OdometryOf::Frame {
        parent: parent.clone(),
        child: child.clone(),
    }
}

/// The first of so many, and how many more there are.
fn told(words: impl Iterator<Item = String>, all: usize) -> String {
    let words = words.take(TOLD).collect::<Vec<_>>().join(", ");
    match all.saturating_sub(TOLD) {
        0 => words,
        more => format!("{words} and {more} more"),
    }
}
