//! Robots that share a log: whose odometry is among its transforms, and whose is meant.

use std::collections::{BTreeMap, BTreeSet};

use crate::roles::transforms::{self, Transform};
use crate::roles::{FromMessage, Message, frame_names};
use crate::{Fault, record};

record! {
    /// A robot whose odometry is among the transforms of a message.
    #[layer("robots", key(frame))]
    pub struct Robot {
        /// Its frame that odometry moves: `robot1/base_link`.
        frame: String,
    }
}

impl FromMessage for Robot {
    const MEMBERS: &'static [&'static str] = Transform::MEMBERS;

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        // What makes no sense is the business of the roles that read it.
        let transforms = transforms::all(message).unwrap_or_default();
        let sound = transforms.into_iter().flatten();
        let moving = sound.filter(|found| moved(&found.parent, &found.child).is_some());
        let frames: BTreeSet<String> = moving.map(|found| found.child).collect();
        Ok(frames.into_iter().map(|frame| Self { frame }).collect())
    }
}

/// The robot whose odometry a transform is, as REP 105 names the two frames: from `odom` (or `odom_combined` …) to
/// `base_link` (or `base_footprint` …), both behind the robot's prefix. The prefix; empty where they have none, `None`
/// for any other transform.
pub fn moved<'f>(parent: &'f str, child: &'f str) -> Option<&'f str> {
    let ((prefix, parent), (same, child)) = (frame_names::split(parent), frame_names::split(child));
    let is_odometry = parent.starts_with("odom") && child.starts_with("base");
    (is_odometry && prefix == same).then_some(prefix)
}

/// Robots that are told apart; of a forged log that has more, the others are not.
const MOST: usize = 1000;

/// Robots that a person is told, and letters of each.
const TOLD: usize = 8;
const LETTERS: usize = 120;

/// The robots whose odometry is among some transforms.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Robots {
    /// A frame of each that odometry moves, by the prefix of its frames.
    frames: BTreeMap<String, String>,
}

impl Robots {
    /// Adds the robot of a frame that odometry moves.
    pub fn add(&mut self, frame: &str) {
        let (prefix, _) = frame_names::split(frame);
        if self.frames.len() < MOST {
            let first = || frame_names::plain(frame).to_owned();
            self.frames.entry(prefix.to_owned()).or_insert_with(first);
        }
    }

    /// Whether it has the robot of a prefix.
    pub fn has(&self, prefix: &str) -> bool {
        self.frames.contains_key(prefix)
    }

    /// The prefix of the one that is meant: whom a manifest names by its prefix (empty where it names none), else the one
    /// whose frames have none, else the only one; empty where there is no robot.
    ///
    /// # Errors
    /// A user fault that names the robots, where it would be a guess.
    pub fn meant(&self, named: &str) -> Result<&str, Fault> {
        let known = |prefix: &str| self.frames.get_key_value(prefix);
        let only = || {
            let is_only = named.is_empty() && self.frames.len() == 1;
            self.frames.first_key_value().filter(|_| is_only)
        };
        match known(named).or_else(|| known("")).or_else(only) {
            Some((prefix, _)) => Ok(prefix),
            None if self.frames.is_empty() => Ok(""),
            None => Err(self.unknown(named)),
        }
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
        let frames = self.frames.values().take(TOLD);
        let words = frames.map(|frame| shown(frame)).collect::<Vec<_>>();
        match self.frames.len().saturating_sub(TOLD) {
            0 => words.join(", "),
            more => format!("{} and {more} more", words.join(", ")),
        }
    }
}

fn shown(frame: &str) -> String {
    frame.chars().take(LETTERS).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn robots(frames: &[&str]) -> Robots {
        let mut robots = Robots::default();
        frames.iter().for_each(|frame| robots.add(frame));
        robots
    }

    #[test]
    fn odometry_moves_a_base_in_an_odometry_frame_of_the_same_robot() {
        for (parent, child, robot) in [
            ("odom", "base_link", Some("")),
            ("/odom", "/base_footprint", Some("")),
            ("odom_combined", "base_link", Some("")),
            ("robot1/odom", "robot1/base_link", Some("robot1")),
            ("/fleet/a/odom", "fleet/a/base_footprint", Some("fleet/a")),
            ("odom", "robot1/base_link", None),
            ("robot1/odom", "robot2/base_link", None),
            ("map", "odom", None),
            ("robot1/base_link", "robot1/wheel", None),
        ] {
            assert_eq!(moved(parent, child), robot, "{parent} -> {child}");
        }
    }

    #[test]
    fn the_robot_that_is_meant_is_named_plain_or_the_only_one() {
        assert_eq!(robots(&[]).meant("").unwrap(), "");
        assert_eq!(robots(&[]).meant("a").unwrap(), "");
        assert_eq!(robots(&["a/base_link"]).meant("").unwrap(), "a");
        let both = robots(&["a/base_link", "a/base_footprint", "b/base_link"]);
        assert_eq!(both.meant("b").unwrap(), "b");
        assert_eq!(robots(&["a/base_link", "base_link"]).meant("").unwrap(), "");
        assert_eq!(robots(&["base_link"]).meant("a").unwrap(), "");
        let fault = both.meant("").unwrap_err().to_string();
        assert!(
            fault.contains("found that of a/base_link, b/base_link")
                && fault.contains("vehicle_frame: a/base_link"),
            "{fault}"
        );
        let fault = robots(&["a/base_link"]).meant("c").unwrap_err().to_string();
        assert!(fault.contains("the odometry of c"), "{fault}");
        assert!(robots(&["a/base_link"]).several().is_empty());
        assert_eq!(both.several(), ["a/base_link", "b/base_link"]);
    }

    #[test]
    fn a_forged_fleet_is_bounded() {
        let frames: Vec<String> = (0..2 * MOST).map(|n| format!("{n}/base_link")).collect();
        let frames: Vec<&str> = frames.iter().map(String::as_str).collect();
        let fleet = robots(&frames);
        assert_eq!(fleet.frames.len(), MOST);
        let fault = fleet.meant("").unwrap_err().to_string();
        assert!(fault.contains("and 992 more"), "{fault}");
    }
}
