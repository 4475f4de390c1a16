//! Files of poses and of times.

use std::collections::BTreeSet;
use std::path::Path;

use evermap_schemas::Fault;
use nalgebra::{Isometry3, Matrix4};
use serde::Deserialize;

use crate::import::placement::{from_pose, rigid};
use crate::import::read;

/// Format of a file of poses, one per line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PoseFormat {
    /// `stamp x y z qx qy qz qw`, s and m.
    Tum,
    /// Twelve numbers, the upper three rows of the matrix; stamps are those of the images.
    Kitti,
}

/// A pose, with its stamp in ns where the file says it.
pub(super) type Posed = (Option<u64>, Isometry3<f64>);

/// What each line says; empty lines and comments are skipped, and a fault names its line.
fn each_line<T>(
    text: &str,
    mut said: impl FnMut(&str) -> Result<T, Fault>,
) -> Result<Vec<T>, Fault> {
    let lines = text.lines().map(str::trim).enumerate();
    let lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let found = lines
        .map(|(above, line)| said(line).map_err(|fault| fault.at(format!("line {}", above + 1))));
    found.collect()
}

/// Reads a file of poses, at least one, one per line.
pub(super) fn read_file(path: &Path, format: PoseFormat) -> Result<Vec<Posed>, Fault> {
    let poses = each_line(&read(path)?, |line| pose(line, format));
    let poses = poses.and_then(|poses| match poses.is_empty() {
        true => Err(Fault::user("expected a pose per line, found none")),
        false => Ok(poses),
    });
    poses.map_err(|fault| fault.at(path.display()))
}

fn pose(line: &str, format: PoseFormat) -> Result<Posed, Fault> {
    let numbers = numbers(line)?;
    match (format, numbers.as_slice()) {
        (PoseFormat::Tum, &[stamp, x, y, z, qx, qy, qz, qw]) => {
            let pose = from_pose(&[x, y, z, qx, qy, qz, qw])?;
            Ok((Some(nanoseconds(stamp)?), pose))
        }
        (PoseFormat::Kitti, numbers) if numbers.len() == 12 => {
            let rows = [numbers, &[0.0, 0.0, 0.0, 1.0]].concat();
            Ok((None, rigid(&Matrix4::from_row_slice(&rows))?))
        }
        (PoseFormat::Tum, numbers) => Err(Fault::user(format!(
            "expected 8 numbers (stamp x y z qx qy qz qw), found {}",
            numbers.len()
        ))),
        (PoseFormat::Kitti, numbers) => Err(Fault::user(format!(
            "expected 12 numbers, found {}",
            numbers.len()
        ))),
    }
}

/// Numbers between blanks or commas, all of them finite.
pub(super) fn numbers(line: &str) -> Result<Vec<f64>, Fault> {
    let words = line.split([' ', '\t', ',']).filter(|word| !word.is_empty());
    let number = |word: &str| {
        let number = word.parse::<f64>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| Fault::user(format!("expected a number, found {word}")))
    };
    words.map(number).collect()
}

/// Stamps, ns, from a file with one per line, s; no two are equal.
pub(super) fn times(path: &Path) -> Result<Vec<u64>, Fault> {
    let mut seen = BTreeSet::new();
    let stamps = each_line(&read(path)?, |line| {
        let stamp = time(line)?;
        match seen.insert(stamp) {
            true => Ok(stamp),
            false => Err(Fault::user(format!(
                "expected a stamp of its own for each image, found {line} again"
            ))),
        }
    });
    stamps.map_err(|fault| fault.at(path.display()))
}

/// The one stamp of a line, ns.
fn time(line: &str) -> Result<u64, Fault> {
    match numbers(line)?.as_slice() {
        [stamp] => nanoseconds(*stamp),
        found => Err(
            Fault::user(format!("expected one stamp, found {} numbers", found.len()))
                .next("write one stamp per line, in seconds, with a decimal point"),
        ),
    }
}

/// Seconds as a log's nanoseconds.
pub(super) fn nanoseconds(seconds: f64) -> Result<u64, Fault> {
    let nanoseconds = (seconds * 1e9).round();
    if !(0.0..9e18).contains(&nanoseconds) {
        return Err(Fault::user(format!(
            "expected a stamp in seconds since 1970, found {seconds}"
        )));
    }
    Ok(nanoseconds as u64)
}

/// Poses with stamps: their own, or those of the images, both in the order in which they are given.
pub(super) fn stamped(
    poses: Vec<Posed>,
    stamps: &[u64],
) -> Result<Vec<(u64, Isometry3<f64>)>, Fault> {
    let own = poses.iter().all(|(stamp, _)| stamp.is_some());
    if !own && poses.len() != stamps.len() {
        return Err(Fault::user(format!(
            "expected a pose for each of {} images, found {}",
            stamps.len(),
            poses.len()
        )));
    }
    let others = stamps.iter().copied().chain(std::iter::repeat(0));
    let poses = poses.into_iter().zip(others);
    Ok(poses
        .map(|((stamp, pose), other)| (stamp.unwrap_or(other), pose))
        .collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn times_of(text: &str) -> Result<Vec<u64>, Fault> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("times.txt");
        std::fs::write(&path, text).unwrap();
        times(&path)
    }

    #[test]
    fn a_line_of_times_is_one_stamp_and_no_stamp_comes_twice() {
        let stamps = times_of("10.25\r\n\n10\n").unwrap();
        assert_eq!(stamps, [10_250_000_000, 10_000_000_000]);
        for (text, said) in [
            ("10,1\n10,2\n", "found 2 numbers (at FILE: line 1)"),
            ("10.1\n10.2 10.3\n", "found 2 numbers (at FILE: line 2)"),
            ("10.0\n11\n10\n", "found 10 again (at FILE: line 3)"),
            ("10.1\nten\n", "found ten (at FILE: line 2)"),
            ("-1\n", "found -1 (at FILE: line 1)"),
        ] {
            let fault = times_of(text).unwrap_err().to_string();
            let (before, after) = said.split_once("FILE").unwrap();
            assert!(fault.contains(before), "{fault}");
            assert!(fault.contains(&format!("times.txt{after}")), "{fault}");
        }
    }

    #[test]
    fn a_byte_order_mark_and_comments_are_no_times() {
        let stamps = times_of("\u{feff}10.5\n # a comment\n11\n").unwrap();
        assert_eq!(stamps, [10_500_000_000, 11_000_000_000]);
        assert_eq!(times_of("\u{feff}# t\n10\n").unwrap(), [10_000_000_000]);
    }

    #[test]
    fn poses_without_stamps_are_at_those_of_the_images_in_their_order() {
        let pose = |x: f64| (None, Isometry3::translation(x, 0.0, 0.0));
        let poses = stamped(vec![pose(1.0), pose(2.0)], &[20, 10]).unwrap();
        let found: Vec<_> = poses.iter().map(|(t, p)| (*t, p.translation.x)).collect();
        assert_eq!(found, [(20, 1.0), (10, 2.0)]);
        let fault = stamped(vec![pose(1.0)], &[20, 10]).unwrap_err().to_string();
        assert!(fault.contains("each of 2 images, found 1"), "{fault}");
    }
}
