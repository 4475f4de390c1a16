//! A problem adjusted region by region, to the answer that it has in one piece.
//!
//! ```text
//!            ┌─ region ─ look, eliminate ─┐                    ┌─ substitute ─┐
//!  Problem ──┼─ region ─ look, eliminate ─┼─► boundary, solved ┼─ substitute ─┼─► trial, its cost
//!            └─ region ─ look, eliminate ─┘                    └─ substitute ─┘
//!                  one visit                    one system          one visit
//! ```
//!
//! A region is some hundred keyframes that see the same landmarks ([`partition`]). It owns the landmarks that it sees most
//! of, and has a copy of each pose outside that sees one of them, too: such poses are *shared*, and with the sessions that
//! lead through several regions they are the boundary. In each step a region eliminates its landmarks, then the poses that
//! it alone has ([`condensed`]); what is left of all regions adds up to one system for the boundary ([`boundary`]), and
//! its solution goes back into the regions. That is block elimination in another order and nothing else: steps, damping
//! and end are those of [`least_squares::minimise`] on the whole, to rounding.
//!
//! Between visits a region is its part of the problem and a matrix of its own unknowns by the shared ones. What is known
//! of single observations exists for the [`AT_A_TIME`] regions only that are visited; so memory follows the size of a
//! region and of the boundary, and derivatives are formed three times a step instead of once. A visit reads nothing but
//! the region and the boundary's steps, and gives numbers that are added in the order of regions.
//!
//! Sources: Przemieniecki, *Matrix structural analysis of substructures* (1963); Brown, *A solution to the general problem
//! of multiple station analytical stereotriangulation* (1958) for the elimination of poses; Ni, Steedly & Dellaert,
//! *Out-of-core bundle adjustment for large-scale 3D reconstruction* (ICCV 2007) for submaps with separators.

mod boundary;
mod condensed;
mod partition;
mod region;
mod subproblem;

use rayon::prelude::*;

use self::boundary::Boundary;
use self::region::{Evaluation, Failed, Moved, Region};
use self::subproblem::Subproblem;
use super::equations::add_decrease;
use super::{Options, Problem, ProblemError};
use crate::solving::least_squares::{
    self, Linearisation, Summary, SystemError, TrialStep, absolute_max, damped_diagonal,
};

/// Regions that are visited side by side, whatever threads there are: what they need at the time is in memory together.
const AT_A_TIME: usize = 8;

/// How a problem was cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cut {
    /// Regions.
    pub regions: usize,
    /// Poses and sessions that several regions share.
    pub shared: usize,
}

/// Adjusts a checked problem by regions of at most `keyframes` poses.
pub(super) fn solve(
    problem: &mut Problem,
    options: &Options,
    keyframes: usize,
) -> Result<(Summary, Cut), ProblemError> {
    let homes = partition::homes(problem, keyframes);
    let mut regions = Regions::new(problem, &homes, options)?;
    let summary = least_squares::minimise(&mut regions, &options.least_squares);
    if let Some(failed) = regions.failed {
        return Err(failed.into());
    }
    for (region, number) in regions.regions.iter().zip(0..) {
        region.part.give_back(problem, &homes, number);
    }
    let cut = Cut {
        regions: regions.regions.len(),
        shared: regions.boundary.unknowns(),
    };
    Ok((summary, cut))
}

/// All regions as the optimiser's loop sees them.
struct Regions<'a> {
    regions: Vec<Region>,
    boundary: Boundary<6>,
    options: &'a Options,
    /// What is known at the estimate, and at the trial.
    at: Option<Together>,
    trial: Option<Together>,
    /// A system that did not fit.
    failed: Option<SystemError>,
}

/// What regions say of an estimate, together.
struct Together {
    cost: f64,
    /// Largest entry of the gradient of what regions have alone.
    gradient_max: f64,
    /// Gradient of the boundary.
    gradient: Vec<[f64; 6]>,
    /// Diagonal of the boundary's part of the Hessian.
    diagonal: Vec<[f64; 6]>,
}

impl Together {
    fn new(shared: usize) -> Self {
        Self {
            cost: 0.0,
            gradient_max: 0.0,
            gradient: vec![[0.0; 6]; shared],
            diagonal: vec![[0.0; 6]; shared],
        }
    }

    fn add(&mut self, part: &Subproblem, evaluation: &Evaluation) {
        self.cost += evaluation.cost;
        self.gradient_max = absolute_max([self.gradient_max, evaluation.gradient_max]);
        for ((shared, gradient), diagonal) in part
            .shared
            .iter()
            .zip(&evaluation.gradient)
            .zip(&evaluation.diagonal)
        {
            for c in 0..6 {
                self.gradient[*shared as usize][c] += gradient[c];
                self.diagonal[*shared as usize][c] += diagonal[c];
            }
        }
    }
}

impl<'a> Regions<'a> {
    fn new(
        problem: &Problem,
        homes: &partition::Homes,
        options: &'a Options,
    ) -> Result<Self, SystemError> {
        let (parts, shared) = subproblem::split(problem, homes);
        let boundary = Boundary::new(shared, parts.iter().map(|part| part.shared.as_slice()))?;
        Ok(Self {
            regions: parts.into_iter().map(Region::new).collect(),
            boundary,
            options,
            at: None,
            trial: None,
            failed: None,
        })
    }

    /// Eliminates what regions have alone, and solves for the boundary.
    fn join(&mut self, damping: f64) -> Option<()> {
        let options = self.options;
        self.boundary.clear();
        let (boundary, mut failed) = (&mut self.boundary, None);
        visit(
            &mut self.regions,
            |region| region.eliminate(options, damping),
            |region, found| match found {
                Ok(condensed) => boundary.add(&region.part.shared, &condensed),
                Err(why) => failed = Some(why),
            },
        );
        match failed {
            Some(Failed::System(why)) => {
                self.failed = Some(why);
                return None;
            }
            Some(Failed::NotPositive) => return None,
            None => self.failed = None,
        }
        let diagonal = &self.at.as_ref()?.diagonal;
        let added = diagonal.iter();
        let added = added.map(|own| own.map(|entry| damping * damped_diagonal(entry)));
        self.boundary.solve(added)
    }
}

/// Calls `work` with every region, some side by side, and `take` with what it gives, in the order of regions.
fn visit<T: Send, R: Send>(
    regions: &mut [T],
    work: impl Fn(&mut T) -> R + Sync,
    mut take: impl FnMut(&T, R),
) {
    for some in regions.chunks_mut(AT_A_TIME) {
        let found: Vec<R> = some.par_iter_mut().map(&work).collect();
        for (region, found) in some.iter().zip(found) {
            take(region, found);
        }
    }
}

impl least_squares::Problem for Regions<'_> {
    fn linearise(&mut self) -> Linearisation {
        let (options, shared) = (self.options, self.boundary.unknowns());
        let regions = &mut self.regions;
        let at = self.at.get_or_insert_with(|| {
            let mut all = Together::new(shared);
            visit(
                regions,
                |region| region.evaluate(options),
                |region, evaluation| all.add(&region.part, &evaluation),
            );
            all
        });
        let shared = at.gradient.as_flattened().iter();
        Linearisation {
            cost: at.cost,
            gradient_max: absolute_max(shared.chain([&at.gradient_max])),
        }
    }

    fn solve(&mut self, damping: f64) -> Option<TrialStep> {
        self.join(damping)?;
        let (options, at, steps) = (self.options, self.at.as_ref()?, self.boundary.steps());
        let mut step = TrialStep {
            predicted_decrease: 0.0,
            moved: 0.0,
        };
        let predicted = &mut step.predicted_decrease;
        for (own, diagonal) in steps.iter().zip(&at.gradient).zip(&at.diagonal) {
            add_decrease(predicted, own, diagonal, damping);
        }
        let mut all = Together::new(steps.len());
        visit(
            &mut self.regions,
            |region| region.substitute(options, steps, damping),
            |region, moved: Moved| {
                step.predicted_decrease += moved.predicted_decrease;
                step.moved = absolute_max([step.moved, moved.moved]);
                all.add(&region.part, &moved.evaluation);
            },
        );
        self.trial = Some(all);
        Some(step)
    }

    fn trial_cost(&mut self) -> f64 {
        self.trial.as_ref().map_or(f64::NAN, |trial| trial.cost)
    }

    fn accept(&mut self) {
        self.at = self.trial.take();
        self.regions.iter_mut().for_each(Region::accept);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::atomic::{AtomicUsize, Ordering};

    use rayon::prelude::*;

    use super::*;

    #[test]
    fn no_more_regions_are_visited_at_a_time_however_many_threads_there_are() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(32).build();
        let (inside, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let work = |region: &mut usize| {
            most.fetch_max(1 + inside.fetch_add(1, Ordering::SeqCst), Ordering::SeqCst);
            // A thread that waits for others takes what work there is.
            (0..64_u64).into_par_iter().for_each(|_| {
                std::thread::sleep(std::time::Duration::from_micros(50));
            });
            inside.fetch_sub(1, Ordering::SeqCst);
            10 * *region
        };
        let mut regions: Vec<usize> = (0..50).collect();
        let mut taken = Vec::new();
        pool.unwrap().install(|| {
            visit(&mut regions, work, |region, found| {
                taken.push((*region, found));
            });
        });
        assert!((2..=AT_A_TIME).contains(&most.load(Ordering::SeqCst)));
        assert!(
            taken
                .into_iter()
                .eq((0..50).map(|region| (region, 10 * region)))
        );
    }
}
