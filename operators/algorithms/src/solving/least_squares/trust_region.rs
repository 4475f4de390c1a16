//! Levenberg–Marquardt: the loop that all optimisers share.

use std::borrow::Borrow;

/// A least-squares problem as the loop sees it. It keeps its own estimate, its matrices and its
/// unknowns; the loop only decides how much to damp and when to stop.
///
/// Called in this order, again and again: [`linearise`](Problem::linearise) at the estimate, one
/// or more [`solve`](Problem::solve) with growing damping, each followed by
/// [`trial_cost`](Problem::trial_cost), and [`accept`](Problem::accept) when that was better.
pub trait Problem {
    /// Computes residuals, gradient `g` and (Gauss–Newton) Hessian `H` at the estimate.
    fn linearise(&mut self) -> Linearisation;

    /// Solves `(H + damping · D) δ = -g` with `D` of [`damped_diagonal`] and keeps `δ`; `None`
    /// when the matrix is not positive definite, and the loop damps more.
    fn solve(&mut self, damping: f64) -> Option<TrialStep>;

    /// Cost `½ Σ ρ` at the estimate moved by the last `δ`. May be NaN or infinite, which counts
    /// as worse.
    fn trial_cost(&mut self) -> f64;

    /// Moves the estimate by the last `δ`.
    fn accept(&mut self);
}

/// What the loop needs to know about the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Linearisation {
    /// `½ Σ ρ(‖r‖²)`.
    pub cost: f64,
    /// Largest absolute entry of the gradient.
    pub gradient_max: f64,
}

/// What the loop needs to know about a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrialStep {
    /// By how much the quadratic model falls: `½ δᵀ (damping · D δ - g)`, at least 0.
    pub predicted_decrease: f64,
    /// How far `δ` moves the estimate, by the problem's own measure: the largest absolute entry, for instance.
    pub moved: f64,
}

/// Marquardt's damping follows the curvature: `D` is the diagonal of `H`, kept away from 0 so
/// that unknowns that nothing observes stay where they are.
#[inline]
pub fn damped_diagonal(diagonal: f64) -> f64 {
    diagonal.clamp(1e-6, 1e32)
}

/// The largest absolute entry, 0 of none; NaN where there is one, wherever it stands.
pub(crate) fn absolute_max<E: Borrow<f64>>(entries: impl IntoIterator<Item = E>) -> f64 {
    entries.into_iter().fold(0.0, |max: f64, entry| {
        let entry: &f64 = entry.borrow();
        let size = entry.abs();
        // `f64::max` would hide a NaN, and no comparison with one holds.
        if size > max || size.is_nan() {
            size
        } else {
            max
        }
    })
}

/// When to stop, and how carefully to begin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Accepted and refused steps together.
    pub max_iterations: usize,
    /// Stop when an accepted step lowers the cost by less than this part of it.
    pub cost_tolerance: f64,
    /// Stop when no entry of the gradient is larger.
    pub gradient_tolerance: f64,
    /// Stop after a step that moves the estimate no farther, by the problem's own measure.
    pub step_tolerance: f64,
    /// Damping of the first step, relative to the curvature: 1e-4 is nearly Gauss–Newton, 1 is
    /// cautious.
    pub initial_damping: f64,
}

impl Default for Options {
    /// Ceres' tolerances.
    fn default() -> Self {
        Self {
            max_iterations: 100,
            cost_tolerance: 1e-6,
            gradient_tolerance: 1e-10,
            step_tolerance: 1e-9,
            initial_damping: 1e-4,
        }
    }
}

/// Why the loop ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The cost does not fall any more.
    Cost,
    /// The gradient is nearly zero.
    Gradient,
    /// The steps are tiny.
    Step,
    /// All allowed iterations are used up.
    Iterations,
    /// No damping makes a step that lowers the cost, or the cost is not finite.
    Stuck,
}

/// What the loop did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Cost at the beginning.
    pub initial_cost: f64,
    /// Cost at the end.
    pub final_cost: f64,
    /// Steps that were accepted.
    pub accepted: usize,
    /// Steps that were refused.
    pub refused: usize,
    /// Why it ended.
    pub stop: Stop,
}

impl Summary {
    /// Did it find a minimum?
    pub fn converged(&self) -> bool {
        matches!(self.stop, Stop::Cost | Stop::Gradient | Stop::Step)
    }
}

/// Damping beyond this leaves no step worth trying.
const MAX_DAMPING: f64 = 1e16;

/// Damping below this is none.
const MIN_DAMPING: f64 = 1e-16;

/// Steps that fulfil less of the prediction than this are refused.
const MIN_GAIN: f64 = 1e-3;

/// The damping and how it grows: Nielsen, *Damping parameter in Marquardt's method* (1999).
struct Damping {
    value: f64,
    growth: f64,
}

impl Damping {
    fn accepted(&mut self, gain: f64) {
        let factor = (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0);
        // A model that predicts to within a quarter needs less damping still.
        let factor = if gain > 0.75 { factor.min(0.1) } else { factor };
        self.value = (self.value * factor).max(MIN_DAMPING);
        self.growth = 2.0;
    }

    fn refused(&mut self) {
        self.value *= self.growth;
        self.growth *= 2.0;
    }
}

/// Levenberg–Marquardt from the problem's estimate to a local minimum. The estimate never gets
/// worse, whatever the end.
pub fn minimise<P: Problem + ?Sized>(problem: &mut P, options: &Options) -> Summary {
    let mut at = problem.linearise();
    let mut summary = Summary {
        initial_cost: at.cost,
        final_cost: at.cost,
        accepted: 0,
        refused: 0,
        stop: Stop::Iterations,
    };
    let mut damping = Damping {
        value: options.initial_damping.max(MIN_DAMPING),
        growth: 2.0,
    };
    if !at.cost.is_finite() || !at.gradient_max.is_finite() {
        summary.stop = Stop::Stuck;
        return summary;
    }
    while summary.accepted + summary.refused < options.max_iterations {
        if at.gradient_max <= options.gradient_tolerance {
            summary.stop = Stop::Gradient;
            break;
        }
        let (attempt, moved) = attempt(problem, at.cost, damping.value);
        let arrived = moved.is_some_and(|moved| moved <= options.step_tolerance);
        match attempt {
            Attempt::Worse if arrived => {
                summary.stop = Stop::Step;
                break;
            }
            Attempt::Worse => {
                summary.refused += 1;
                damping.refused();
                if damping.value > MAX_DAMPING {
                    summary.stop = Stop::Stuck;
                    break;
                }
            }
            Attempt::Better { cost, gain } => {
                problem.accept();
                summary.accepted += 1;
                summary.final_cost = cost;
                damping.accepted(gain);
                let flat = at.cost - cost <= options.cost_tolerance * at.cost;
                if flat || arrived {
                    summary.stop = if arrived { Stop::Step } else { Stop::Cost };
                    break;
                }
                at = problem.linearise();
            }
        }
    }
    summary
}

enum Attempt {
    Worse,
    Better { cost: f64, gain: f64 },
}

/// A step, and how far it moves the estimate; `None` where there was none.
fn attempt<P: Problem + ?Sized>(
    problem: &mut P,
    cost: f64,
    damping: f64,
) -> (Attempt, Option<f64>) {
    let Some(step) = problem.solve(damping) else {
        return (Attempt::Worse, None);
    };
    let trial = problem.trial_cost();
    let gain = (cost - trial) / step.predicted_decrease;
    // Not `gain <= MIN_GAIN`: NaN is worse, too.
    let attempt = if gain > MIN_GAIN {
        Attempt::Better { cost: trial, gain }
    } else {
        Attempt::Worse
    };
    (attempt, Some(step.moved))
}
