//! The problem taken apart: a problem of its own for each region.

use rayon::prelude::*;

use super::super::decomposition::Sessions;
use super::super::{Observation, Odometry, Problem};
use super::condensed::BlockIndex;
use super::partition::{Homes, Lists};

/// A region's part of the problem.
pub(super) struct Subproblem {
    /// Its landmarks with their observations, the odometry from its poses, and copies of all poses and sessions that these
    /// name.
    pub(super) problem: Problem,
    /// Where its poses, sessions and landmarks are in the whole.
    poses: Vec<u32>,
    of_sessions: Vec<u32>,
    landmarks: Vec<u32>,
    /// Which of its sessions are unknowns, and which it answers for.
    pub(super) sessions: Sessions,
    /// For each unknown block where it is.
    pub(super) indices: Vec<BlockIndex>,
    /// For each that is shared its index in the boundary, ascending.
    pub(super) shared: Vec<u32>,
}

/// The parts, and how many unknowns they share.
pub(super) fn split(problem: &Problem, homes: &Homes) -> (Vec<Subproblem>, usize) {
    let whole = Whole::new(problem, homes);
    let parts = 0..homes.count;
    let mut parts: Vec<Subproblem> = parts.into_par_iter().map(|at| whole.part(at)).collect();
    let shared = share(&mut parts, problem);
    (parts, shared)
}

/// What belongs to whom.
struct Whole<'a> {
    problem: &'a Problem,
    /// By region.
    poses: Lists,
    landmarks: Lists,
    observations: Lists,
    odometry: Lists,
    /// The sessions that it answers for.
    sessions: Lists,
}

impl<'a> Whole<'a> {
    fn new(problem: &'a Problem, Homes { of: homes, count }: &Homes) -> Self {
        let owners = owners(problem, homes);
        let owner = |landmark: usize| owners[landmark].map(|owner| owner as usize);
        let by_home = |home: &u32| *home as usize;
        let landmarks =
            (0..problem.landmarks.len()).filter_map(|landmark| Some((owner(landmark)?, landmark)));
        let observations = problem.observations.iter().enumerate();
        let observations =
            observations.filter_map(|(index, seen)| Some((owner(seen.landmark)?, index)));
        let odometry = problem.odometry.iter().zip(0..);
        let odometry = odometry.map(|(step, index)| (by_home(&homes[step.from]), index));
        // The first region with odometry of a session answers for it.
        let mut answer: Vec<Option<usize>> = vec![None; problem.sessions.len()];
        for step in &problem.odometry {
            let home = by_home(&homes[step.from]);
            let answer = &mut answer[problem.poses[step.from].session];
            *answer = Some(answer.map_or(home, |first| first.min(home)));
        }
        let answer = answer.iter().map(|home| home.unwrap_or(0)).zip(0..);
        Self {
            problem,
            poses: Lists::new(*count, homes.iter().map(by_home).zip(0..)),
            landmarks: Lists::new(*count, landmarks),
            observations: Lists::new(*count, observations),
            odometry: Lists::new(*count, odometry),
            sessions: Lists::new(*count, answer),
        }
    }

    fn part(&self, at: usize) -> Subproblem {
        let whole = self.problem;
        let observations = self.observations.of(at).iter();
        let observations = observations.map(|index| &whole.observations[*index as usize]);
        let steps = self.odometry.of(at).iter();
        let steps = steps.map(|index| &whole.odometry[*index as usize]);
        let ends = steps.clone().flat_map(|step| [step.from, step.to]);
        let named = observations.clone().map(|seen| seen.pose).chain(ends);
        let own = self.poses.of(at).iter().copied();
        let poses = sorted(own.chain(named.map(|pose| pose as u32)));
        let session = |pose: usize| whole.poses[pose].session as u32;
        let driven = steps.clone().map(|step| session(step.from));
        let there = poses.iter().map(|pose| session(*pose as usize));
        let (of_sessions, sessions) = self.sessions(at, driven, there);
        let landmarks = self.landmarks.of(at).to_vec();
        let problem = Problem {
            rigs: whole.rigs.clone(),
            sessions: pick(&whole.sessions, &of_sessions),
            poses: pick(&whole.poses, &poses),
            landmarks: pick(&whole.landmarks, &landmarks),
            observations: observations
                .map(|seen| Observation {
                    pose: place(&poses, seen.pose),
                    landmark: place(&landmarks, seen.landmark),
                    ..*seen
                })
                .collect(),
            odometry: steps
                .map(|step| Odometry {
                    from: place(&poses, step.from),
                    to: place(&poses, step.to),
                    ..*step
                })
                .collect(),
        };
        Subproblem {
            problem: with_sessions(problem, &of_sessions),
            poses,
            of_sessions,
            landmarks,
            sessions,
            indices: Vec::new(),
            shared: Vec::new(),
        }
    }

    /// The sessions of a part: those that it answers for, others whose odometry it has, and those that only say with which
    /// rig a pose sees.
    fn sessions(
        &self,
        at: usize,
        driven: impl Iterator<Item = u32>,
        there: impl Iterator<Item = u32>,
    ) -> (Vec<u32>, Sessions) {
        let mut sessions = self.sessions.of(at).to_vec();
        let held = sessions.len();
        let others: Vec<u32> = sorted(driven);
        let answered = |session: &u32| self.sessions.of(at).binary_search(session).is_ok();
        sessions.extend(others.iter().filter(|session| !answered(session)));
        let unknown = sessions.len();
        let here = |session: &u32| answered(session) || others.binary_search(session).is_ok();
        sessions.extend(sorted(there).iter().filter(|session| !here(session)));
        (sessions, Sessions { held, unknown })
    }
}

/// The region that sees most of each landmark, of equals the first; `None` where nobody sees it.
fn owners(problem: &Problem, homes: &[u32]) -> Vec<Option<u32>> {
    let seen = problem.observations.iter();
    let seen = seen.map(|seen| (seen.landmark, homes[seen.pose] as usize));
    let seen = Lists::new(problem.landmarks.len(), seen);
    let landmarks = (0..problem.landmarks.len()).into_par_iter();
    let owner = |landmark: usize| {
        let mut regions = seen.of(landmark).to_vec();
        regions.sort_unstable();
        let runs = regions.chunk_by(|a, b| a == b);
        // Of equal ones `max_by_key` gives the last.
        runs.rev().max_by_key(|run| run.len())?.first().copied()
    };
    landmarks.map(owner).collect()
}

fn sorted(indices: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut sorted: Vec<u32> = indices.collect();
    sorted.sort_unstable();
    sorted.dedup();
    sorted
}

fn pick<T: Clone>(all: &[T], picked: &[u32]) -> Vec<T> {
    let picked = picked.iter();
    picked.map(|index| all[*index as usize].clone()).collect()
}

/// Where an index is among some.
fn place(sorted: &[u32], index: usize) -> usize {
    sorted.partition_point(|other| (*other as usize) < index)
}

/// Poses name sessions by their place in the part.
fn with_sessions(mut problem: Problem, of_sessions: &[u32]) -> Problem {
    for pose in &mut problem.poses {
        let mut named = of_sessions.iter();
        let found = named.position(|session| *session as usize == pose.session);
        pose.session = found.unwrap_or_default();
    }
    problem
}

/// Numbers what several parts have, and tells each part which of its unknowns that is.
fn share(parts: &mut [Subproblem], problem: &Problem) -> usize {
    let poses = problem.poses.len();
    let mut parts_with = vec![0_u32; poses + problem.sessions.len()];
    for part in &*parts {
        part.unknowns(poses)
            .for_each(|unknown| parts_with[unknown] += 1);
    }
    let mut count = 0;
    let numbers = parts_with.iter().map(|parts| {
        let number = (*parts > 1).then_some(count);
        count += u32::from(*parts > 1);
        number
    });
    let numbers: Vec<Option<u32>> = numbers.collect();
    for part in parts {
        let unknowns: Vec<usize> = part.unknowns(poses).collect();
        let shared = unknowns.iter().filter_map(|unknown| numbers[*unknown]);
        part.shared = sorted(shared);
        let mut own = 0;
        let indices = unknowns.iter().map(|unknown| match numbers[*unknown] {
            Some(number) => BlockIndex::Shared(place(&part.shared, number as usize) as u32),
            None => {
                own += 1;
                BlockIndex::Own(own - 1)
            }
        });
        part.indices = indices.collect();
    }
    count as usize
}

impl Subproblem {
    /// The unknown blocks that it has alone.
    pub(super) fn own(&self) -> impl Iterator<Item = usize> {
        let indices = self.indices.iter().enumerate();
        indices.filter_map(|(block, index)| matches!(index, BlockIndex::Own(_)).then_some(block))
    }

    /// Its unknown blocks in the whole: poses, then sessions.
    fn unknowns(&self, poses: usize) -> impl Iterator<Item = usize> {
        let free = self.problem.poses.iter().zip(&self.poses);
        let free = free.filter(|(pose, _)| !pose.fixed);
        let free = free.map(|(_, index)| *index as usize);
        let sessions = self.of_sessions[..self.sessions.unknown].iter();
        free.chain(sessions.map(move |index| poses + *index as usize))
    }

    /// Writes what is its own into the whole. All copies of what is shared are the same.
    pub(super) fn give_back(&self, whole: &mut Problem, homes: &Homes, number: u32) {
        for (pose, index) in self.problem.poses.iter().zip(&self.poses) {
            if homes.of[*index as usize] == number {
                whole.poses[*index as usize].map_from_vehicle = pose.map_from_vehicle;
            }
        }
        let held = self.of_sessions[..self.sessions.held].iter();
        for (session, index) in self.problem.sessions.iter().zip(held) {
            whole.sessions[*index as usize] = *session;
        }
        for (landmark, index) in self.problem.landmarks.iter().zip(&self.landmarks) {
            whole.landmarks[*index as usize] = *landmark;
        }
    }
}
