//! The reduced system's two ways to a solution, and the choice between them.
//!
//! Formed and factorised it costs the square of a landmark's sightings and more than the square of the poses that meet:
//! little on a drive that never returns, too much where many drives overlap. Conjugate gradients never form it, and a
//! step costs some passes over the observations, however they overlap. A drive on odometry alone is a chain: its factor is
//! as long as the drive.

use super::blocks::Blocks;
use super::elimination::{Layout, Point, Sighted};
use super::factor;
use super::iterative::Iterative;
use super::reduced::Reduced;
use super::schur::{Bundle, Sight};
use crate::solving::least_squares::{Structure, SystemError};

/// Work of an iterative step in products of two numbers, for each observation, and for each block of the terms without
/// landmarks, which a pass reads too: passes, times what one costs while memory is what bounds it. Measured on drives
/// that overlap (`solve_bundle --drive N --drives K`).
const ITERATIVE_PER_OBSERVATION: f64 = 12_000.0;

/// Products of two numbers for a pair of observations of one landmark, when the system is formed.
const FORMED_PER_PAIR: f64 = 250.0;

/// How the camera side of a step is found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum LinearSolver {
    /// Whichever takes less, by the number of observations, of pairs of them, of unknowns that meet without landmarks, and
    /// of the factor's entries.
    #[default]
    Cheaper,
    /// The reduced system is formed and factorised.
    Factorised,
    /// Preconditioned conjugate gradients: a residual of a thousandth is left.
    Iterative,
}

pub(super) enum System<const C: usize> {
    Direct(Reduced<C>),
    Iterative(Box<Iterative<C>>),
}

impl<const C: usize> System<C> {
    /// The cheaper of both, and the order of observations that it wants.
    pub(super) fn choose<B: Bundle<C>>(
        blocks: usize,
        landmarks: usize,
        sights: Vec<Sight>,
        terms: &Blocks<C>,
        bundle: &B,
        solver: LinearSolver,
    ) -> Result<(Layout, Self), SystemError> {
        let identity: Vec<u32> = (0..blocks as u32).collect();
        let layout = Layout::new(landmarks, sights, &identity);
        let read = layout.sights.len() + terms.entries.len();
        let iterative = ITERATIVE_PER_OBSERVATION * read as f64;
        let formed = FORMED_PER_PAIR * layout.pairs_of_sights();
        if solver == LinearSolver::Factorised
            || solver == LinearSolver::Cheaper && formed < iterative
        {
            let pairs = layout.meeting(terms);
            let named = pairs.iter().map(|(a, b)| (*a as usize, *b as usize));
            let structure = Structure::new(blocks, named);
            let cheaper = |found: &Structure<C>| formed + factor::work(found) < iterative;
            // A factor that does not fit is not the cheaper one.
            if solver == LinearSolver::Factorised || structure.as_ref().is_ok_and(cheaper) {
                return Ok((layout, Self::Direct(Reduced::new(structure?, &pairs)?)));
            }
        }
        let (layout, iterative) = Iterative::new(landmarks, layout, bundle)?;
        Ok((layout, Self::Iterative(Box::new(iterative))))
    }

    /// Replaces the right-hand side by the solution; `None` when the matrix is not positive definite. `own` are the
    /// terms without landmarks, and what damping adds to the diagonal.
    pub(super) fn solve(
        &mut self,
        layout: &Layout,
        sighted: &[Sighted<C>],
        points: &mut [Point],
        own: (&Blocks<C>, &[[f64; C]]),
        right: &mut [[f64; C]],
    ) -> Option<()> {
        match self {
            Self::Direct(reduced) => reduced.solve(layout, sighted, own, right),
            Self::Iterative(iterative) => iterative.solve(layout, sighted, points, own, right),
        }
    }
}
