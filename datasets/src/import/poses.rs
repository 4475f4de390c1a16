//! Files of poses and of times.

use std::path::Path;

use evermap_schemas::Fault;
use nalgebra::{Isometry3, Matrix4};
use serde::Deserialize;

use crate::import::{from_pose, read, rigid};

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

/// Reads poses, one per line; empty lines and comments are skipped.
pub(super) fn read_text(text: &str, format: PoseFormat) -> Result<Vec<Posed>, Fault> {
    let mut poses = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let pose = pose(line, format).map_err(|fault| fault.at(format!("line {}", number + 1)))?;
        poses.push(pose);
    }
    Ok(poses)
}

/// Reads a file of poses.
pub(super) fn read_file(path: &Path, format: PoseFormat) -> Result<Vec<Posed>, Fault> {
    read_text(&read(path)?, format).map_err(|fault| fault.at(path.display()))
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

/// Stamps from a file with one per line, s.
pub(super) fn times(path: &Path) -> Result<Vec<u64>, Fault> {
    let text = read(path)?;
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    let stamp = |line: &str| match numbers(line)?.as_slice() {
        [stamp, ..] => nanoseconds(*stamp),
        [] => Err(Fault::user("expected a stamp")),
    };
    let stamps: Result<Vec<u64>, Fault> = lines.map(stamp).collect();
    stamps.map_err(|fault| fault.at(path.display()))
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

/// Poses with stamps: their own, or those of the images in order.
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
