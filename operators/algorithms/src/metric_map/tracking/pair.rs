//! Two views matched along arcs.

use super::arc::Arc;
use super::{Ready, Tracker};
use crate::geometry::pose::Pose;
use crate::metric_map::matching::{Match, MatchLimits};

/// Distances are accepted up to this many standard deviations.
pub(super) const SIGMAS: f64 = 3.0;

/// Two views in a row.
pub(super) struct Pair {
    /// How the camera moved; `None` where the views are too far apart to tell.
    pub(super) b_from_a: Option<Pose>,
    /// Features of a to features of b, each once at most, by feature of a.
    pub(super) matches: Vec<Match>,
}

impl Pair {
    pub(super) fn apart() -> Self {
        Self {
            b_from_a: None,
            matches: Vec::new(),
        }
    }
}

/// Best and second best of one feature's candidates, by descriptor.
#[derive(Clone, Copy)]
struct Best {
    with: u32,
    distance: u32,
    second: Option<u32>,
}

impl Best {
    fn offer(best: &mut Option<Self>, with: u32, distance: u32, runner_up: Option<u32>) {
        let lower = |a: Option<u32>, b: u32| Some(a.map_or(b, |a| a.min(b)));
        *best = Some(match *best {
            None => Self {
                with,
                distance,
                second: runner_up,
            },
            Some(known) if distance < known.distance => Self {
                with,
                distance,
                second: lower(runner_up, known.distance),
            },
            Some(known) => Self {
                second: lower(known.second, distance),
                ..known
            },
        });
    }

    fn accepted(&self, limits: &MatchLimits) -> bool {
        limits.accept(self.distance, self.second)
    }
}

/// Mutual matches of two views, given how the camera moved and how well its rotation is known.
/// `wanted` says which features of a take part.
pub(super) fn match_pair(
    tracker: &Tracker<'_>,
    (a, b): (&Ready<'_>, &Ready<'_>),
    b_from_a: &Pose,
    turn_sigma_rad: f64,
    wanted: &dyn Fn(u32) -> bool,
) -> Vec<Match> {
    let limits = &tracker.params.limits;
    let mut columns: Vec<Option<Best>> = vec![None; b.rays.len()];
    let mut rows: Vec<Option<Best>> = vec![None; a.rays.len()];
    for from in (0..a.rays.len() as u32).filter(|from| wanted(*from)) {
        let search = Search {
            tracker,
            a,
            b,
            b_from_a,
            turn_sigma_rad,
        };
        let Some(nearest) = search.nearest(from) else {
            continue;
        };
        rows[from as usize] = Some(Best {
            with: nearest.0,
            distance: nearest.1,
            second: nearest.2,
        });
        Best::offer(&mut columns[nearest.0 as usize], from, nearest.1, None);
    }
    let mutual = (0..).zip(rows).filter_map(|(from, row)| {
        let row = row.filter(|row| row.accepted(limits))?;
        let column = columns[row.with as usize].filter(|column| column.accepted(limits))?;
        (column.with == from).then_some(Match {
            query: from,
            found: row.with,
            distance: row.distance,
        })
    });
    mutual.collect()
}

struct Search<'a> {
    tracker: &'a Tracker<'a>,
    a: &'a Ready<'a>,
    b: &'a Ready<'a>,
    b_from_a: &'a Pose,
    turn_sigma_rad: f64,
}

impl Search<'_> {
    /// The feature of b on the arc of a feature of a that looks most alike: its index, distance,
    /// and the distance of the next best.
    fn nearest(&self, from: u32) -> Option<(u32, u32, Option<u32>)> {
        let (ray, sigma) = self.a.ray(from)?;
        let tracker = self.tracker;
        let arc = Arc::new(self.b_from_a, &ray, tracker.params.min_depth_m);
        // Odometry's error across its way turns the arc about its far end.
        let way_rad = tracker.params.way_sigma * arc.length_rad();
        let other = self.turn_sigma_rad.powi(2) + way_rad.powi(2) + sigma.powi(2);
        let within = |sigma: f64| SIGMAS * (other + sigma * sigma).sqrt();
        let accept = |to: u32| {
            let found = self.b.ray(to);
            found.is_some_and(|(ray, sigma)| arc.is_within(&ray, within(sigma)))
        };
        let widest = within(self.b.widest_rad());
        let (pixel, radius_px) = self.circle(&arc, widest)?;
        let descriptor = &self.a.features.features.get(from as usize)?.descriptor;
        let found = self.b.index.nearest(pixel, radius_px, descriptor, accept)?;
        Some((found.feature, found.distance, found.runner_up))
    }

    /// A circle of the image that holds the arc and what is within `margin_rad` of it.
    fn circle(&self, arc: &Arc, margin_rad: f64) -> Option<([f64; 2], f64)> {
        const SAMPLES: u32 = 4;
        let camera = self.tracker.camera;
        let sample = |k| arc.at(arc.length_rad() * f64::from(k) / f64::from(SAMPLES));
        let pixels: Vec<[f64; 2]> = (0..=SAMPLES)
            .filter_map(|k| camera.project(&sample(k)))
            .collect();
        let bound = |axis: usize, pick: fn(f64, f64) -> f64| {
            pixels.iter().map(|pixel| pixel[axis]).reduce(pick)
        };
        let low = [bound(0, f64::min)?, bound(1, f64::min)?];
        let high = [bound(0, f64::max)?, bound(1, f64::max)?];
        let centre = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
        let half = 0.5 * (high[0] - low[0]).hypot(high[1] - low[1]);
        // Lenses stretch towards their edges.
        Some((centre, half + 1.5 * margin_rad / self.tracker.rad_per_px))
    }
}
