//! Where a detector of windows finds people, one place for each.
//!
//! Windows that score are candidates; of those that show the same part of the image, the best. Each is then moved to where a
//! person is likeliest: by the score, by how high people are, and by how far the ground may be from the vehicle's plane.
//! Feet and size both tell the range, and where one is hidden or blurred the other one counts.

use super::upright::{Stance, Upright};
use super::{PeopleParams, WindowDetector, placing};
use crate::ground::projection::GrayView;

/// Log odds of a person by the score of a window: slope, and the score at which a window that was searched for in a whole
/// image is as likely as not a person. The slope is that of a logistic curve (Platt 1999) through the scores of OpenCV's
/// detector on 823 windows of the INRIA test set. Windows that were searched for score higher than that, people or not: of
/// those at 1.3 in the images of a simulated car park, half are people.
const SLOPE: f64 = 4.2;
const EVEN: f64 = 1.3;
/// How much a score may grow when the window is moved: what is worse by more is not looked at again.
const GROWS: f64 = 1.3;
/// Windows that share more than this of their area show one person, before and after they are moved.
const SAME: [f64; 2] = [0.3, 0.4];
/// Width of a person over height.
pub(super) const SLENDER: f64 = 0.4;
/// Who is said to be nearer to the camera than this (m), or farther than this times what is looked for, is not looked at.
const NEAREST_M: f64 = 0.5;
const FARTHEST: f64 = 2.0;
/// Rounds of moving, and its first steps: aside and up (m), and of range and height (parts).
const ROUNDS: usize = 6;
const STEPS: [f64; 4] = [0.1, 0.05, 0.08, 0.05];

/// A person in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Person {
    /// Where the feet are in the vehicle frame (m).
    pub position: [f64; 2],
    /// Variance of x, covariance of x and y, variance of y (m²).
    pub covariance: [f64; 3],
    /// Distance from the camera along the ground (m).
    pub range_m: f64,
    /// Rectangle of the image: least column and row, largest column and row (px).
    pub rectangle: [f64; 4],
    /// Score of the window.
    pub score: f64,
    /// Probability that it is a person.
    pub probability: f64,
    /// What the window shows, as the detector describes it.
    pub description: Vec<f32>,
}

/// How probably a window with a score is a person.
pub fn probability(score: f64) -> f64 {
    1.0 / (1.0 + (-SLOPE * (score - EVEN)).exp())
}

/// The people in an image, the likeliest first.
pub fn people(
    upright: &Upright,
    image: &GrayView<'_>,
    detector: &mut impl WindowDetector,
    params: &PeopleParams,
) -> Vec<Person> {
    let mut windows = Vec::new();
    for (picture, stance) in upright.strips(image) {
        let found = detector.scan(&picture, EVEN - GROWS);
        windows.extend(found.into_iter().map(|(at, score)| (stance(at), score)));
    }
    let candidates = one_each(windows, SAME[0], upright.eye_m());
    let mut search = Search {
        upright,
        image,
        detector,
        params,
    };
    let moved = candidates.into_iter();
    let moved = moved.map(|(stance, _)| search.likeliest(stance)).collect();
    let mut moved = one_each(moved, SAME[1], upright.eye_m());
    let reached = params.nearest_m..=params.farthest_m;
    moved.retain(|(stance, score)| {
        probability(*score) >= params.least_probability && reached.contains(&stance.range_m)
    });
    let moved = moved.iter();
    moved
        .filter_map(|(stance, score)| search.person(stance, *score))
        .collect()
}

/// The person whom somebody says to stand at a point of the vehicle frame (m), moved to where they are likeliest, whatever
/// they score; `None` where the image does not show that point.
pub fn person_at(
    upright: &Upright,
    image: &GrayView<'_>,
    detector: &mut impl WindowDetector,
    params: &PeopleParams,
    position: [f64; 2],
) -> Option<Person> {
    let [azimuth, range_m] = upright.sight(position);
    if !(NEAREST_M..=FARTHEST * params.farthest_m).contains(&range_m) {
        return None;
    }
    let mut search = Search {
        upright,
        image,
        detector,
        params,
    };
    let (stance, score) = search.likeliest(Stance {
        azimuth,
        range_m,
        foot_m: 0.0,
        height_m: params.height_m,
    });
    let found = search.person(&stance, score);
    found.filter(|one| one.score.is_finite())
}

/// The best of those that show the same, in order of their scores.
fn one_each(mut found: Vec<(Stance, f64)>, same: f64, eye_m: f64) -> Vec<(Stance, f64)> {
    found.retain(|(_, score)| score.is_finite());
    let order = |one: &(Stance, f64)| (one.1, one.0.range_m, one.0.azimuth);
    found.sort_by(|a, b| {
        let (a, b) = (order(a), order(b));
        let best_first = b.0.total_cmp(&a.0);
        best_first
            .then(a.1.total_cmp(&b.1))
            .then(a.2.total_cmp(&b.2))
    });
    let mut kept: Vec<(Stance, f64)> = Vec::new();
    for one in found {
        let seen = Outline::new(&one.0, eye_m);
        let known = |other: &(Stance, f64)| Outline::new(&other.0, eye_m).overlap(&seen) > same;
        if !kept.iter().any(known) {
            kept.push(one);
        }
    }
    kept
}

/// What of the view a person takes: direction and half the width (rad), and slopes of the sight to feet and head.
struct Outline {
    azimuth: f64,
    aside: f64,
    slopes: [f64; 2],
}

impl Outline {
    fn new(of: &Stance, eye_m: f64) -> Self {
        let slope = |height: f64| (height - eye_m) / of.range_m;
        Self {
            azimuth: of.azimuth,
            aside: 0.5 * SLENDER * of.height_m / of.range_m,
            slopes: [slope(of.foot_m), slope(of.foot_m + of.height_m)],
        }
    }

    fn area(&self) -> f64 {
        2.0 * self.aside * (self.slopes[1] - self.slopes[0])
    }

    /// Intersection over union.
    fn overlap(&self, other: &Self) -> f64 {
        let turn = (self.azimuth - other.azimuth).rem_euclid(std::f64::consts::TAU);
        let apart = turn.min(std::f64::consts::TAU - turn);
        let across = (self.aside + other.aside - apart)
            .min(2.0 * self.aside.min(other.aside))
            .max(0.0);
        let up = self.slopes[1].min(other.slopes[1]) - self.slopes[0].max(other.slopes[0]);
        let both = across * up.max(0.0);
        both / (self.area() + other.area() - both)
    }
}

struct Search<'a, D> {
    upright: &'a Upright,
    image: &'a GrayView<'a>,
    detector: &'a mut D,
    params: &'a PeopleParams,
}

impl<D: WindowDetector> Search<'_, D> {
    /// Where the person of a window is likeliest, and the score there.
    fn likeliest(&mut self, seen: Stance) -> (Stance, f64) {
        let standing = |range_m: f64| Stance {
            range_m,
            foot_m: 0.0,
            height_m: self.params.height_m,
            ..seen
        };
        // From where the feet, the size, and both say that they stand.
        let by_feet = placing::range_by_feet(&seen, self.upright.eye_m());
        let by_size = seen.range_m * self.params.height_m / seen.height_m;
        let starts = [by_size, by_feet, (by_size * by_feet).sqrt()].map(standing);
        let mut best = (seen, f64::NEG_INFINITY, f64::NEG_INFINITY);
        for start in starts {
            self.compare(start, &mut best);
        }
        let mut steps = STEPS;
        for _ in 0..ROUNDS {
            let before = best.2;
            for (axis, step) in steps.iter().enumerate() {
                for by in [-step, *step] {
                    self.compare(moved(&best.0, axis, by), &mut best);
                }
            }
            if best.2 <= before {
                steps = steps.map(|step| 0.5 * step);
            }
        }
        (best.0, best.1)
    }

    /// The person of a window; `None` where the image shows neither feet nor head.
    fn person(&mut self, stance: &Stance, score: f64) -> Option<Person> {
        let (upright, width_m) = (self.upright, SLENDER * stance.height_m);
        let rectangle = upright.rectangle(stance, width_m)?;
        let window = upright.window(self.image, stance);
        Some(Person {
            position: upright.on_ground(stance.azimuth, stance.range_m),
            covariance: placing::covariance(upright, stance, self.params),
            range_m: stance.range_m,
            rectangle,
            score,
            probability: probability(score),
            description: self.detector.describe(&window),
        })
    }

    /// Keeps what is likelier.
    fn compare(&mut self, stance: Stance, best: &mut (Stance, f64, f64)) {
        let window = self.upright.window(self.image, &stance);
        let score = self.detector.score(&window);
        let tall = (stance.height_m / self.params.height_m).ln()
            / (self.params.height_sd_m / self.params.height_m);
        let high = stance.foot_m / placing::ground_sd_m(stance.range_m, self.params);
        let likelihood = SLOPE * score - 0.5 * (tall * tall + high * high);
        if likelihood > best.2 {
            *best = (stance, score, likelihood);
        }
    }
}

fn moved(stance: &Stance, axis: usize, by: f64) -> Stance {
    let mut to = *stance;
    match axis {
        0 => to.azimuth += by / stance.range_m,
        1 => to.foot_m += by,
        2 => to.range_m *= by.exp(),
        _ => to.height_m *= by.exp(),
    }
    to
}
