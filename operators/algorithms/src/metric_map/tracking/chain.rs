//! Links to chains, and chains cut where no point of the world explains them.

use nalgebra::{Matrix3, Vector3};

use super::pair::{Pair, SIGMAS, match_pair};
use super::{Sighting, Tracker};
use crate::geometry::pose::Pose;

/// A chain is checked over this many of its last sightings: more would show odometry's drift.
const WINDOW: usize = 4;

/// Rays that are parallel to this (squared sine) still give a point, far away.
const PARALLEL: f64 = 1e-10;

impl Tracker<'_> {
    /// Chains of matches from step to step and over gaps, cut by [`Tracker::explained`].
    pub(super) fn chains(&self, steps: &[Pair]) -> Vec<Vec<Sighting>> {
        let poses = local_poses(steps);
        let successors = self.successors(steps);
        let mut begun: Vec<Vec<bool>> = self.each(|_| true);
        for links in &successors {
            for next in links.iter().flatten() {
                begun[next.view as usize][next.feature as usize] = false;
            }
        }
        let mut tracks = Vec::new();
        for (view, begun) in (0..).zip(&begun) {
            for (feature, _) in (0..).zip(begun).filter(|(_, begun)| **begun) {
                self.cut(Sighting { view, feature }, &successors, &poses, &mut tracks);
            }
        }
        tracks.sort_unstable();
        tracks
    }

    fn each<T: Clone>(&self, value: impl Fn(usize) -> T) -> Vec<Vec<T>> {
        let lengths = self.ready.iter().map(|ready| ready.rays.len());
        lengths
            .enumerate()
            .map(|(view, length)| vec![value(view); length])
            .collect()
    }

    /// The next sighting of each feature of each view: in the view after, else over a gap.
    fn successors(&self, steps: &[Pair]) -> Vec<Vec<Option<Sighting>>> {
        let mut next: Vec<Vec<Option<Sighting>>> = self.each(|_| None);
        let mut taken: Vec<Vec<bool>> = self.each(|_| false);
        let mut link = |next: &mut Vec<Vec<Option<Sighting>>>, from: [usize; 2], to: [usize; 2]| {
            let known = &mut next[from[0]][from[1]];
            let taken = &mut taken[to[0]][to[1]];
            if known.is_none() && !*taken {
                *known = Some(Sighting {
                    view: to[0] as u32,
                    feature: to[1] as u32,
                });
                *taken = true;
            }
        };
        for (view, pair) in steps.iter().enumerate() {
            for found in &pair.matches {
                let (from, to) = (found.query as usize, found.found as usize);
                link(&mut next, [view, from], [view + 1, to]);
            }
        }
        for missed in 1..=self.params.gap as usize {
            for to in missed + 1..self.views.len() {
                let from = to - missed - 1;
                let Some(pose) = over(steps, from, to) else {
                    continue;
                };
                let ended = |feature: u32| next[from][feature as usize].is_none();
                let turn_rad = self.params.turn_sigma_rad * 0.5;
                let ready = (&self.ready[from], &self.ready[to]);
                for found in match_pair(self, ready, &pose, turn_rad, &ended) {
                    let (a, b) = (found.query as usize, found.found as usize);
                    link(&mut next, [from, a], [to, b]);
                }
            }
        }
        next
    }

    /// Follows a chain from its first sighting; what can be explained is a track.
    fn cut(
        &self,
        first: Sighting,
        successors: &[Vec<Option<Sighting>>],
        poses: &[Pose],
        tracks: &mut Vec<Vec<Sighting>>,
    ) {
        let mut track = vec![first];
        let mut last = first;
        while let Some(next) = successors[last.view as usize][last.feature as usize] {
            let full = track.len() >= self.params.max_points.max(2) as usize;
            let from = track.len().saturating_sub(WINDOW - 1);
            let window: Vec<Sighting> = track[from..].iter().copied().chain([next]).collect();
            if full || !self.explained(&window, poses) {
                self.keep(std::mem::take(&mut track), tracks);
            }
            track.push(next);
            last = next;
        }
        self.keep(track, tracks);
    }

    fn keep(&self, track: Vec<Sighting>, tracks: &mut Vec<Vec<Sighting>>) {
        if track.len() >= self.params.min_points.max(2) as usize {
            tracks.push(track);
        }
    }

    /// Whether one point of the world, perhaps an infinitely far one, is where all sightings say.
    fn explained(&self, window: &[Sighting], poses: &[Pose]) -> bool {
        let rays: Option<Vec<Ray>> = window
            .iter()
            .map(|sighting| {
                let (ray, sigma) = self.ready[sighting.view as usize].ray(sighting.feature)?;
                let pose = poses.get(sighting.view as usize)?;
                Some(Ray {
                    from: pose.translation,
                    along: pose.rotation * ray,
                    sigma,
                })
            })
            .collect();
        rays.is_some_and(|rays| {
            let nearby = intersection(&rays)
                .is_some_and(|point| rays.iter().all(|ray| ray.meets(&(point - ray.from))));
            let mean: Vector3<f64> = rays.iter().map(|ray| ray.along).sum();
            nearby || rays.iter().all(|ray| ray.meets(&mean))
        })
    }
}

/// A sighting's ray in the frame that the views share.
struct Ray {
    from: Vector3<f64>,
    along: Vector3<f64>,
    sigma: f64,
}

impl Ray {
    fn meets(&self, direction: &Vector3<f64>) -> bool {
        self.along.angle(direction) <= SIGMAS * self.sigma
    }
}

/// The point nearest to all rays, in least squares.
fn intersection(rays: &[Ray]) -> Option<Vector3<f64>> {
    let (mut across, mut sum) = (Matrix3::identity() * PARALLEL, Vector3::zeros());
    let origin = rays.first()?.from;
    for ray in rays {
        let projection = Matrix3::identity() - ray.along * ray.along.transpose();
        across += projection;
        sum += projection * (ray.from - origin);
    }
    Some(across.cholesky()?.solve(&sum) + origin)
}

/// Each view's camera in one frame, by the refined steps; over a step that cannot be told, at the place of the view
/// before (no track crosses it).
fn local_poses(steps: &[Pair]) -> Vec<Pose> {
    let mut poses = vec![Pose::identity()];
    let mut last = Pose::identity();
    for step in steps {
        if let Some(b_from_a) = step.b_from_a {
            last = last.compose(&b_from_a.inverse());
        }
        poses.push(last);
    }
    poses
}

/// `b_from_a` over several steps.
fn over(steps: &[Pair], from: usize, to: usize) -> Option<Pose> {
    let chain = steps.get(from..to)?.iter().map(|step| step.b_from_a);
    chain.reduce(|so_far, next| Some(next?.compose(&so_far?)))?
}
