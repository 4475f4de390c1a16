//! What it is worth that a view is found, learnt from a drive itself.
//!
//! A drive says how far its views are from each other. So each is looked for among those that are not quite where it is,
//! once with its place among them and once without, and whether what is found is right is known: nobody has to say where
//! another visit was. Two views of another drive differ more than two of one, so that what is learnt here errs on the side of
//! doubt.

use std::ops::Range;

use nalgebra::Vector3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::view_map::{Hit, Query, ViewMap};
use crate::learning::calibration::Calibration;
use crate::semantic_map::semantic_graph::Graph;

/// What is learnt from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct CalibrationOptions {
    /// Views nearer than this to a query are not compared with it (m), as another visit takes another line: by default what
    /// two cars, 2 m wide, can be apart in a lane of 3 m.
    #[schemars(range(min = 0.01, max = 1e6))]
    pub near_m: f64,
    /// A view that is no farther than this from a query shows its place (m), by default as in paper 2; one that is farther
    /// than twice as much shows another.
    #[schemars(range(min = 0.01, max = 1e6))]
    pub within_m: f64,
    /// Views of a drive that are looked for, evenly from all. Of 200 the share that is right is known to 3 %.
    #[schemars(range(min = 1, max = 100_000))]
    pub queries: u32,
}

impl Default for CalibrationOptions {
    fn default() -> Self {
        Self {
            near_m: 1.0,
            within_m: 5.0,
            queries: 200,
        }
    }
}

/// A drive's views, looked for in their own drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SelfSearch {
    /// Views that were looked for: those with a view of their place and one of another to be compared with.
    pub queries: u32,
    /// The share of them that were found where they were taken.
    pub recall: f64,
    /// What the [`distinctness`] of a hit is worth; `None` where it tells nothing.
    pub calibration: Option<Calibration>,
}

/// By how much a hit is better than the best of the views of other places, as a share of its score: 0 when it is no better, 1
/// when no other is alike. `best` finds it among those that it is allowed; `None` where there is no other place.
pub fn distinctness(
    hit: &Hit,
    mut views: Range<u32>,
    is_elsewhere: impl Fn(u32) -> bool,
    best: impl FnOnce(&dyn Fn(u32) -> bool) -> Vec<Hit>,
) -> Option<f64> {
    if !views.any(&is_elsewhere) {
        return None;
    }
    let elsewhere = best(&is_elsewhere);
    let other = elsewhere.first().map_or(0.0, |other| other.score);
    Some(if hit.score > 0.0 {
        1.0 - other / hit.score
    } else {
        0.0
    })
}

/// Whether two views show different places: those taken farther apart than twice `within_m`.
pub fn are_apart(a: &Vector3<f64>, b: &Vector3<f64>, within_m: f64) -> bool {
    (a - b).norm() > 2.0 * within_m
}

/// Looks for views in their own drive, `map`; `graphs` and `positions` (m, any one frame) are its views, in its order. `None`
/// where no view has both its own place and another one to be compared with.
///
/// The place of a view is in the map for one half of the questions and not for the other: a probability is that of a hit
/// whose place is as likely mapped as not.
pub fn self_search(
    map: &ViewMap,
    graphs: &[Graph],
    positions: &[Vector3<f64>],
    options: &CalibrationOptions,
) -> Option<SelfSearch> {
    let lesson = Lesson {
        map,
        positions,
        options,
    };
    let views = graphs.len().min(positions.len()) as u32;
    let step = views.div_ceil(options.queries.max(1)).max(1) as usize;
    let all: Vec<u32> = (0..views).step_by(step).collect();
    let answers = all.par_iter().filter(|query| lesson.teaches(**query));
    let answers: Vec<[Option<Answer>; 2]> = answers
        .map(|query| lesson.answers(*query, &map.query(&graphs[*query as usize])))
        .collect();
    let found = answers
        .iter()
        .filter(|[with, _]| with.is_some_and(|(_, right)| right));
    let known: Vec<Answer> = answers.iter().flatten().flatten().copied().collect();
    let queries = answers.len();
    (queries > 0).then(|| SelfSearch {
        queries: queries as u32,
        recall: found.count() as f64 / queries as f64,
        calibration: Calibration::learn(&known),
    })
}

/// How distinct what was found is, and whether it is right.
type Answer = (f64, bool);

struct Lesson<'a> {
    map: &'a ViewMap,
    positions: &'a [Vector3<f64>],
    options: &'a CalibrationOptions,
}

impl Lesson<'_> {
    fn apart_m(&self, a: u32, b: u32) -> f64 {
        (self.positions[a as usize] - self.positions[b as usize]).norm()
    }

    fn are_apart(&self, a: u32, b: u32) -> bool {
        let [a, b] = [a, b].map(|view| &self.positions[view as usize]);
        are_apart(a, b, self.options.within_m)
    }

    /// Whether there is a view of the query's place and one of another.
    fn teaches(&self, query: u32) -> bool {
        let near = self.options.near_m..=self.options.within_m;
        let mut views = 0..self.positions.len() as u32;
        views
            .clone()
            .any(|view| near.contains(&self.apart_m(query, view)))
            && views.any(|view| self.are_apart(query, view))
    }

    /// What is found with the query's place in the map, and without.
    fn answers(&self, query: u32, asked: &Query) -> [Option<Answer>; 2] {
        let beside = |view: u32| self.apart_m(query, view) >= self.options.near_m;
        let away = |view: u32| self.are_apart(query, view);
        [
            self.answer(query, asked, &beside),
            self.answer(query, asked, &away),
        ]
    }

    fn answer(&self, query: u32, asked: &Query, allowed: &dyn Fn(u32) -> bool) -> Option<Answer> {
        let hits = self.map.search(asked, 1, allowed);
        let hit = hits.first()?;
        let is_elsewhere = |view: u32| allowed(view) && self.are_apart(hit.view, view);
        let views = 0..self.positions.len() as u32;
        let best = |allowed: &dyn Fn(u32) -> bool| self.map.search(asked, 1, allowed);
        let distinctness = distinctness(hit, views, is_elsewhere, best)?;
        let right = self.apart_m(query, hit.view) <= self.options.within_m;
        Some((distinctness, right))
    }
}
