//! A problem taken apart: unknown blocks, who sees what, and who meets whom.

use super::schur::{FIXED, Schur, Sight};
use super::vehicle::Vehicles;
use super::{Options, Problem};
use crate::solving::least_squares::SystemError;

/// The sessions of a problem, of which a part of one may know others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sessions {
    /// So many first ones are held near what odometry is expected to be.
    pub(super) held: usize,
    /// So many first ones are unknowns; no odometry is of another.
    pub(super) unknown: usize,
}

/// A problem taken apart for its equations.
pub(super) struct Decomposition<'a> {
    pub(super) bundle: Vehicles<'a>,
    /// Unknown blocks.
    pub(super) blocks: usize,
    pub(super) landmarks: Vec<[f64; 3]>,
    pub(super) sights: Vec<Sight>,
    /// Blocks that meet without landmarks.
    pub(super) pairs: Vec<(u32, u32)>,
}

/// A checked problem, ready for the loop.
pub(super) fn schur<'a>(
    problem: &'a Problem,
    options: &'a Options,
) -> Result<Schur<6, Vehicles<'a>>, SystemError> {
    let sessions = Sessions {
        held: problem.sessions.len(),
        unknown: problem.sessions.len(),
    };
    let Decomposition {
        bundle,
        blocks,
        landmarks,
        sights,
        pairs,
    } = take(problem, options, sessions);
    let solver = options.linear_solver;
    Schur::new(bundle, blocks, landmarks, sights, &pairs, solver)
}

/// Takes a checked problem apart.
pub(super) fn take<'a>(
    problem: &'a Problem,
    options: &'a Options,
    sessions: Sessions,
) -> Decomposition<'a> {
    let mut free = 0;
    let blocks: Vec<u32> = problem
        .poses
        .iter()
        .map(|pose| {
            if pose.fixed {
                return FIXED;
            }
            free += 1;
            free - 1
        })
        .collect();
    let first_session = free as usize;
    let sights = problem.observations.iter().enumerate();
    let sights = sights
        .map(|(index, seen)| Sight {
            landmark: seen.landmark as u32,
            block: blocks[seen.pose],
            observation: index as u32,
        })
        .collect();
    Decomposition {
        pairs: pairs(problem, &blocks, first_session),
        landmarks: problem.landmarks.iter().map(|p| (*p).into()).collect(),
        sights,
        blocks: first_session + sessions.unknown,
        bundle: Vehicles::new(problem, options, (blocks, first_session), sessions.held),
    }
}

/// Blocks that meet in odometry.
fn pairs(problem: &Problem, blocks: &[u32], first_session: usize) -> Vec<(u32, u32)> {
    let mut pairs = Vec::with_capacity(3 * problem.odometry.len());
    for step in &problem.odometry {
        let session = (first_session + problem.poses[step.from].session) as u32;
        let (from, to) = (blocks[step.from], blocks[step.to]);
        for (a, b) in [(from, to), (from, session), (to, session)] {
            if a != FIXED && b != FIXED {
                pairs.push((a, b));
            }
        }
    }
    pairs
}
