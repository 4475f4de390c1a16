//! Drives as samples with a course: evenly spaced, smoothed, each with the direction of travel.
//!
//! The course comes from positions, over `COURSE` samples each way: a vehicle that reverses, or one that moves sideways,
//! travels where it goes and not where it looks, and poses of any source have positions.

use super::super::cells::{distance, mean};
use super::super::thinning::LONGEST_FILLED_STEP;
use super::Reach;
use super::plane::{ahead, unit};

/// From one sample to the next, in spacings. A vehicle that stands and trembles by less gives none.
const STEP: f64 = 0.5;

/// Samples on each side that a position is averaged over: one spacing each way, which takes the noise of a pose to under
/// a half and leaves a bend of 5 m within 1 cm.
const SMOOTHED: usize = 2;

/// Samples on each side that the course is taken from: two spacings each way.
const COURSE: usize = 4;

/// A turn on the spot goes in and out of a radius once and a few times to and fro; who goes farther within it stands.
const STANDING: f64 = 6.0;

/// A position with its number in the drive.
type NumberedPosition = (u32, [f64; 3]);

/// A place along a drive.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) position: [f64; 3],
    /// Direction of travel, a unit vector from above.
    pub(super) course: [f64; 2],
    /// Path from the start of the part, metres.
    pub(super) path_m: f64,
    /// The poses that it lies between, or is; as counted in `Trace::positions`.
    pub(super) first: u32,
    pub(super) last: u32,
}

/// The samples of an unbroken part of a drive; cut where nothing is known for a long way.
pub(super) fn samples(part: &[NumberedPosition], reach: &Reach) -> Vec<Vec<Sample>> {
    let longest_m = LONGEST_FILLED_STEP * reach.spacing_m;
    let known = |a: &NumberedPosition, b: &NumberedPosition| distance(&a.1, &b.1) <= longest_m;
    let runs = part.chunk_by(known).map(|poses| {
        let moving = moving(poses, reach.connect_m);
        with_course(&spaced(&moving, reach.spacing_m * STEP), reach.spacing_m)
    });
    runs.filter(|run| run.len() > 1).collect()
}

/// The poses without those of a vehicle that stands and trembles: that goes to and fro within a radius for more than
/// `STANDING` times that path.
fn moving(poses: &[NumberedPosition], radius_m: f64) -> Vec<NumberedPosition> {
    let mut kept: Vec<NumberedPosition> = Vec::new();
    let mut begin = 0;
    while begin < poses.len() {
        let anchor = poses[begin].1;
        let inside = |pose: &&NumberedPosition| distance(&anchor, &pose.1) <= radius_m;
        let end = begin + poses[begin..].iter().take_while(inside).count();
        let path_m: f64 = poses[begin..end]
            .windows(2)
            .map(|p| distance(&p[0].1, &p[1].1))
            .sum();
        if path_m > STANDING * radius_m {
            kept.push(poses[begin]);
            if end == poses.len() {
                kept.push(poses[end - 1]);
            }
        } else {
            kept.extend(&poses[begin..end]);
        }
        begin = end.max(begin + 1);
    }
    kept
}

/// Positions a step apart, each with the poses that it lies between; the last pose is the last position.
fn spaced(poses: &[NumberedPosition], step_m: f64) -> Vec<([f64; 3], u32, u32)> {
    let mut kept: Vec<([f64; 3], u32, u32)> = Vec::new();
    let mut left = None;
    for &(at, position) in poses {
        let Some(before) = left.replace(at) else {
            kept.push((position, at, at));
            continue;
        };
        while let Some(last) = kept.last_mut() {
            let away = distance(&last.0, &position);
            if away < step_m {
                last.2 = at;
                break;
            }
            let t = step_m / away;
            let next = [0, 1, 2].map(|k| last.0[k] + t * (position[k] - last.0[k]));
            // So far from the origin that the next number is more than a step away.
            if next == last.0 {
                break;
            }
            kept.push((next, before, at));
        }
    }
    if let (Some(&(at, position)), true) = (poses.last(), kept.len() > 1)
        && let Some(last) = kept.last_mut()
    {
        *last = (position, last.1, at);
    }
    kept
}

/// The positions averaged over their neighbours, as many before as after, with the course over more of them.
fn with_course(steps: &[([f64; 3], u32, u32)], spacing_m: f64) -> Vec<Sample> {
    let smooth: Vec<[f64; 3]> = (0..steps.len())
        .map(|at| {
            let reach = SMOOTHED.min(at).min(steps.len() - 1 - at);
            mean(steps[at - reach..=at + reach].iter().map(|step| &step.0))
        })
        .collect();
    let chord = |at: usize| {
        let to = (at + COURSE).min(smooth.len() - 1);
        let chord = ahead(&smooth[at.saturating_sub(COURSE)], &smooth[to]);
        (chord[0].hypot(chord[1]) >= STEP * spacing_m).then(|| unit(chord))
    };
    let Some(mut course) = (0..smooth.len()).find_map(chord) else {
        return Vec::new();
    };
    let mut samples: Vec<Sample> = Vec::with_capacity(smooth.len());
    for (at, &position) in smooth.iter().enumerate() {
        course = chord(at).unwrap_or(course);
        let before = samples.last();
        let (_, first, last) = steps[at];
        samples.push(Sample {
            position,
            course,
            path_m: before.map_or(0.0, |before| {
                before.path_m + distance(&before.position, &position)
            }),
            first,
            last,
        });
    }
    samples
}
