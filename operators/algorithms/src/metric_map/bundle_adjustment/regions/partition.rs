//! Which region a pose belongs to.
//!
//! Poses are dealt out by halving: from a pose at one end of what is seen in common, always the pose is taken next whose
//! landmarks and odometry steps are most of them those of poses taken before, until half are. The front stays short, so few
//! poses see landmarks of both sides; drives through one place come together, as they see the same. Source: Karypis & Kumar,
//! *A fast and high quality multilevel scheme for partitioning irregular graphs* (1998), greedy graph growing; theirs
//! counts edges between vertices, which here would grow with the square of a landmark's sightings.

use std::collections::VecDeque;

use super::super::Problem;

/// The region of each pose, and how many regions there are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Homes {
    pub(super) of: Vec<u32>,
    pub(super) count: usize,
}

/// Lists of indices, one for each key.
pub(super) struct Lists {
    starts: Vec<usize>,
    items: Vec<u32>,
}

impl Lists {
    /// From pairs of key and item, which keep their order.
    pub(super) fn new(keys: usize, pairs: impl Iterator<Item = (usize, usize)> + Clone) -> Self {
        let mut starts = vec![0; keys + 1];
        for (key, _) in pairs.clone() {
            starts[key + 1] += 1;
        }
        for key in 0..keys {
            starts[key + 1] += starts[key];
        }
        let mut next = starts.clone();
        let mut items = vec![0; starts[keys]];
        for (key, item) in pairs {
            items[next[key]] = item as u32;
            next[key] += 1;
        }
        Self { starts, items }
    }

    pub(super) fn of(&self, key: usize) -> &[u32] {
        &self.items[self.starts[key]..self.starts[key + 1]]
    }
}

/// Regions of at most `most` poses, each about as large.
pub(super) fn homes(problem: &Problem, most: usize) -> Homes {
    let mut halving = Halving::new(problem);
    let all: Vec<u32> = (0..problem.poses.len() as u32).collect();
    let regions = all.len().div_ceil(most.max(1)).max(1);
    let mut rest = vec![(all, regions)];
    let mut homes = Homes {
        of: vec![0; problem.poses.len()],
        count: 0,
    };
    while let Some((poses, regions)) = rest.pop() {
        if regions == 1 {
            for pose in poses {
                homes.of[pose as usize] = homes.count as u32;
            }
            homes.count += 1;
            continue;
        }
        let mut near = halving.near_one_end(&poses);
        let half = regions / 2;
        let far = near.split_off(near.len() * half / regions);
        rest.push((far, regions - half));
        rest.push((near, half));
    }
    homes
}

/// Shares of a pose's things that are told apart.
const SHARES: usize = 32;

/// What poses have in common: landmarks first, then odometry steps.
struct Halving {
    poses: Lists,
    of_pose: Lists,
    /// The subset that a pose is in.
    subset: Vec<u32>,
    subsets: u32,
    /// The sweep that met a thing last.
    met_by: Vec<u32>,
    sweeps: u32,
    /// By pose: how many of its things the sweep has met; [`TAKEN`] when it is taken itself.
    met: Vec<u32>,
    /// Poses by the share of their things that is met. Those that moved on are still where they were.
    waiting: Vec<VecDeque<u32>>,
}

/// No number of things.
const TAKEN: u32 = u32::MAX;

impl Halving {
    fn new(problem: &Problem) -> Self {
        let landmarks = problem.landmarks.len();
        let things = landmarks + problem.odometry.len();
        let seen = problem.observations.iter();
        let seen = seen.map(|seen| (seen.landmark, seen.pose));
        let steps = problem.odometry.iter().zip(landmarks..);
        let steps = steps.flat_map(|(step, thing)| [(thing, step.from), (thing, step.to)]);
        let pairs = seen.chain(steps);
        Self {
            poses: Lists::new(things, pairs.clone()),
            of_pose: Lists::new(
                problem.poses.len(),
                pairs.map(|(thing, pose)| (pose, thing)),
            ),
            subset: vec![0; problem.poses.len()],
            subsets: 0,
            met_by: vec![0; things],
            sweeps: 0,
            met: vec![0; problem.poses.len()],
            waiting: vec![VecDeque::new(); SHARES + 1],
        }
    }

    /// The poses in the order in which they are taken from one end.
    fn near_one_end(&mut self, poses: &[u32]) -> Vec<u32> {
        self.subsets += 1;
        for pose in poses {
            self.subset[*pose as usize] = self.subsets;
        }
        let there = self.sweep(poses, poses.first().copied());
        self.sweep(poses, there.last().copied())
    }

    /// From `start`; what is not connected with it follows.
    fn sweep(&mut self, poses: &[u32], start: Option<u32>) -> Vec<u32> {
        self.sweeps += 1;
        poses.iter().for_each(|pose| self.met[*pose as usize] = 0);
        let mut order = Vec::with_capacity(poses.len());
        for seed in start.into_iter().chain(poses.iter().copied()) {
            let mut next = Some(seed);
            while let Some(pose) = next {
                if self.met[pose as usize] != TAKEN {
                    self.met[pose as usize] = TAKEN;
                    order.push(pose);
                    self.meet_things(pose as usize);
                }
                next = self.fullest();
            }
        }
        order
    }

    /// The pose of which most is met; of equals the first.
    fn fullest(&mut self) -> Option<u32> {
        let mut fullest = self.waiting.iter_mut().rev();
        fullest.find_map(VecDeque::pop_front)
    }

    fn meet_things(&mut self, pose: usize) {
        for at in 0..self.of_pose.of(pose).len() {
            let thing = self.of_pose.of(pose)[at] as usize;
            if std::mem::replace(&mut self.met_by[thing], self.sweeps) == self.sweeps {
                continue;
            }
            for at in 0..self.poses.of(thing).len() {
                self.count(self.poses.of(thing)[at] as usize);
            }
        }
    }

    /// One more of a pose's things is met.
    fn count(&mut self, pose: usize) {
        let met = self.met[pose] as usize;
        if self.met[pose] == TAKEN || self.subset[pose] != self.subsets {
            return;
        }
        self.met[pose] += 1;
        let share = |met: usize| met * SHARES / self.of_pose.of(pose).len();
        let now = share(met + 1);
        if met == 0 || now > share(met) {
            self.waiting[now].push_back(pose as u32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose::Pose;
    use crate::metric_map::bundle_adjustment::{Keyframe, Observation, SessionState};

    /// A road of poses in any order, each landmark seen from five in a row.
    fn road(poses: usize) -> (Problem, Vec<usize>) {
        let order: Vec<usize> = (0..poses).map(|at| at * 7 % poses).collect();
        let seen = (0..poses - 4)
            .flat_map(|landmark| (landmark..landmark + 5).map(move |at| (landmark, at)));
        let observation = |(landmark, at): (usize, usize)| Observation {
            pose: order[at],
            camera: 0,
            landmark,
            pixel: [0.0; 2],
            sigma_px: 1.0,
        };
        let problem = Problem {
            sessions: vec![SessionState::new(0)],
            poses: vec![
                Keyframe {
                    session: 0,
                    map_from_vehicle: Pose::identity(),
                    fixed: false,
                };
                poses
            ],
            landmarks: vec![Default::default(); poses - 4],
            observations: seen.map(observation).collect(),
            ..Problem::default()
        };
        (problem, order)
    }

    #[test]
    fn a_road_is_cut_across() {
        let (problem, order) = road(100);
        let homes = homes(&problem, 30);
        assert_eq!(homes.count, 4);
        let along: Vec<u32> = order.iter().map(|pose| homes.of[*pose]).collect();
        let cuts = along.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert_eq!(cuts, 3, "{along:?}");
        for region in 0..4 {
            assert_eq!(along.iter().filter(|home| **home == region).count(), 25);
        }
    }

    #[test]
    fn regions_are_no_larger_than_asked_for() {
        let (mut problem, _) = road(101);
        // What nothing connects is dealt out, too.
        problem.observations.truncate(200);
        for most in [1, 2, 3, 7, 50, 100, 101, 500] {
            let homes = homes(&problem, most);
            assert_eq!(homes.count, 101_usize.div_ceil(most));
            for region in 0..homes.count as u32 {
                let own = homes.of.iter().filter(|home| **home == region).count();
                assert!((1..=most).contains(&own), "{region} of {most}: {own}");
            }
        }
        assert_eq!(super::homes(&Problem::default(), 5).count, 1);
    }
}
