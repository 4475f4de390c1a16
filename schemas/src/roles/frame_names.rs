//! Names of coordinate frames. ROS 1 puts a slash in front of them; where several robots may drive, the frames of each have
//! a prefix of its own: `robot1/odom`, `robot1/base_link`.

use std::collections::BTreeSet;

/// A frame's name without the slash in front.
pub fn plain(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

/// The prefix of a frame's name and what stands behind it, `robot1` and `base_link`; the prefix is empty where there is
/// none.
pub fn split(frame: &str) -> (&str, &str) {
    let frame = plain(frame);
    frame.rsplit_once('/').unwrap_or(("", frame))
}

/// Letters of a name that a person is told.
const LETTERS: usize = 120;

/// A frame's name as a person is told it: a forged one may have any length.
pub fn shown(frame: &str) -> String {
    frame.chars().take(LETTERS).collect()
}

/// Whether two frames are of two robots: their prefixes differ, and neither is within the other, as that of an arm is
/// within its robot's. A frame without a prefix may be of any.
pub fn are_of_two_robots(one: &str, other: &str) -> bool {
    let (one, other) = (split(one).0, split(other).0);
    let is_within = |inner: &str, outer: &str| {
        let rest = inner.strip_prefix(outer);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    };
    let is_known = !one.is_empty() && !other.is_empty();
    is_known && !is_within(one, other) && !is_within(other, one)
}

/// The frame that a name means, of those that there are: that of the very name; else, where the name has no prefix, the
/// only one that is called so behind a prefix. `None` where none is, or several are.
pub fn meant<'f>(name: &str, frames: impl IntoIterator<Item = &'f str>) -> Option<&'f str> {
    let wanted = plain(name);
    let mut prefixed = BTreeSet::new();
    for frame in frames.into_iter().map(plain) {
        if frame == wanted {
            return Some(frame);
        }
        if split(frame).1 == wanted {
            prefixed.insert(frame);
        }
    }
    match prefixed.len() {
        1 => prefixed.pop_first(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_a_prefix_or_none() {
        assert_eq!(split("base_link"), ("", "base_link"));
        assert_eq!(split("/base_link"), ("", "base_link"));
        assert_eq!(split("/fleet/robot1/odom"), ("fleet/robot1", "odom"));
    }

    #[test]
    fn frames_of_two_robots_have_prefixes_that_differ() {
        for (one, other, two) in [
            ("a/base_link", "b/base_link", true),
            ("/a/base_link", "b/lidar", true),
            ("fleet/a/odom", "fleet/b/odom", true),
            ("a/base_link", "ab/base_link", true),
            ("a/base_link", "/a/lidar", false),
            ("a/base_link", "a/arm/tool", false),
            ("a/base_link", "base_link", false),
            ("", "a/base_link", false),
        ] {
            assert_eq!(are_of_two_robots(one, other), two, "{one} {other}");
            assert_eq!(are_of_two_robots(other, one), two, "{other} {one}");
        }
    }

    #[test]
    fn a_name_without_a_prefix_means_the_only_frame_that_has_it_behind_one() {
        let frames = ["map", "/a/base_link", "a/base_link", "a/front"];
        assert_eq!(meant("base_link", frames), Some("a/base_link"));
        assert_eq!(meant("/a/front", frames), Some("a/front"));
        let two = ["a/base_link", "b/base_link"];
        assert_eq!(meant("base_link", two), None);
        assert_eq!(meant("b/base_link", two), Some("b/base_link"));
        assert_eq!(meant("c/base_link", two), None);
        let own = ["a/base_link", "base_link"];
        assert_eq!(meant("base_link", own), Some("base_link"));
    }
}
