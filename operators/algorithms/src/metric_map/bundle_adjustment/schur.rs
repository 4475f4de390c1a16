//! Elimination of the landmarks: what makes bundle adjustment cheap.
//!
//! With camera-side unknowns `c` (poses, cameras, sessions) and landmarks `l`, the normal
//! equations are `[U W; Wᵀ V]`. `V` is one 3 × 3 block per landmark, so
//! `S = U - W V⁻¹ Wᵀ` is formed landmark by landmark and only `S` needs a real factorisation.
//! Source: Triggs, McLauchlan, Hartley, Fitzgibbon, *Bundle Adjustment: A Modern Synthesis*
//! (2000), section 6.1; Lourakis & Argyros, *SBA* (2009).
//!
//! `W` is never formed. An observation has two rows only, so with `V = L Lᵀ` and `B = Jₗ L⁻ᵀ` (2 × 3)
//! the block of two observations `o`, `p` of one landmark is `Jᵒᵀ (Bᵒ Bᵖᵀ) Jᵖ` with a 2 × 2 matrix in
//! the middle: fewer products than over the three rows of `L⁻¹ Wᵀ`, and less memory.
//!
//! [`Schur`] knows neither rigs nor lenses: a [`Bundle`] tells it what each observation says.

use super::blocks::Blocks;
use super::equations::Equations;
pub use super::system::LinearSolver;
use super::system::System;
use crate::solving::least_squares::{Linearisation, Problem, SystemError, TrialStep, absolute_max};

/// An observation, weighted: residual and derivatives.
#[derive(Debug, Clone, Copy)]
pub struct Linear<const C: usize> {
    /// By row: predicted less observed.
    pub residual: [f64; 2],
    /// By row: derivative by the camera-side unknown.
    pub camera: [[f64; C]; 2],
    /// By row: derivative by the landmark.
    pub landmark: [[f64; 3]; 2],
}

impl<const C: usize> Linear<C> {
    /// An observation that says nothing.
    pub const ZERO: Self = Self {
        residual: [0.0; 2],
        camera: [[0.0; C]; 2],
        landmark: [[0.0; 3]; 2],
    };
}

/// Which camera-side unknown sees which landmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Sight {
    /// Index of the landmark.
    pub landmark: u32,
    /// Index of the unknown; [`FIXED`] when it does not move.
    pub block: u32,
    /// The observation's index where it came from.
    pub observation: u32,
}

/// No unknown: a pose that stays where it is.
pub const FIXED: u32 = u32::MAX;

/// The camera side of a bundle: its unknowns, and what they make of landmarks. Keeps an estimate
/// and a trial.
pub trait Bundle<const C: usize>: Sync {
    /// `½ ρ` and the weighted derivatives of an observation at the estimate.
    fn linearise(&self, observation: usize, landmark: &[f64; 3]) -> (f64, Linear<C>);

    /// `½ ρ` of an observation at the trial.
    fn trial_cost(&self, observation: usize, landmark: &[f64; 3]) -> f64;

    /// Adds the terms without landmarks at the estimate; gives their `½ ρ`.
    fn add_terms(&self, terms: &mut Terms<'_, C>) -> f64;

    /// `½ ρ` of the terms without landmarks at the trial.
    fn trial_terms_cost(&self) -> f64;

    /// The trial becomes the estimate moved by these steps.
    fn step(&mut self, steps: &[[f64; C]]);

    /// The estimate becomes the trial.
    fn accept(&mut self);

    /// How far these steps move the estimate, by its own measure; landmarks follow. Unless told otherwise, by their
    /// largest absolute entry.
    fn moved(&self, steps: &[[f64; C]]) -> f64 {
        absolute_max(steps.as_flattened())
    }

    /// For each unknown, how it changes when all of its group (`groups[block]`) moves together: one column for each
    /// of up to `C` motions. Unless told otherwise, all unknowns of a group change alike.
    fn common_motions(&self, groups: &[u32]) -> Vec<[[f64; C]; C]> {
        let identity =
            std::array::from_fn(|r| std::array::from_fn(|c| f64::from(u8::from(r == c))));
        vec![identity; groups.len()]
    }

    /// The kin of each of so many unknowns, by small numbers: where unknowns of one kin see nothing, those that follow one
    /// another may move together. Unless told otherwise, all are of one kin.
    fn kin(&self, unknowns: usize) -> Vec<u32> {
        vec![0; unknowns]
    }
}

/// Hessian and gradient of the terms without landmarks.
pub struct Terms<'a, const C: usize> {
    pub(super) matrix: &'a mut Blocks<C>,
    pub(super) gradient: &'a mut [[f64; C]],
}

impl<const C: usize> Terms<'_, C> {
    /// `H[row, column] += block`, once for a pair; its mirror is implied.
    pub fn add(&mut self, row: usize, column: usize, block: impl Fn(usize, usize) -> f64) {
        if let Some((place, transposed)) = self.matrix.find(row, column) {
            for (r, entries) in self.matrix.entries[place].iter_mut().enumerate() {
                for (c, entry) in entries.iter_mut().enumerate() {
                    *entry += if transposed { block(c, r) } else { block(r, c) };
                }
            }
        }
    }

    /// `g[row] += part`.
    pub fn add_gradient(&mut self, row: usize, part: impl Fn(usize) -> f64) {
        if let Some(gradient) = self.gradient.get_mut(row) {
            for (c, entry) in gradient.iter_mut().enumerate() {
                *entry += part(c);
            }
        }
    }
}

/// Pairs as [`Blocks`] wants them.
pub(super) fn ordered(pairs: &[(u32, u32)]) -> Vec<(u32, u32)> {
    let different = pairs.iter().filter(|(a, b)| a != b);
    let mut ordered: Vec<_> = different.map(|(a, b)| (*a.min(b), *a.max(b))).collect();
    ordered.sort_unstable();
    ordered.dedup();
    ordered
}

/// A bundle as the optimiser's loop sees it.
pub struct Schur<const C: usize, B> {
    equations: Equations<C, B>,
    system: System<C>,
}

impl<const C: usize, B: Bundle<C>> Schur<C, B> {
    /// `blocks` camera-side unknowns; `pairs` of them that meet in terms without landmarks.
    ///
    /// # Errors
    /// [`SystemError`] when the reduced system does not fit.
    pub fn new(
        bundle: B,
        blocks: usize,
        landmarks: Vec<[f64; 3]>,
        sights: Vec<Sight>,
        pairs: &[(u32, u32)],
        solver: LinearSolver,
    ) -> Result<Self, SystemError> {
        let terms = Blocks::new(blocks, &ordered(pairs));
        let (layout, system) =
            System::choose(blocks, landmarks.len(), sights, &terms, &bundle, solver)?;
        Ok(Self {
            equations: Equations::new(bundle, landmarks, layout, terms),
            system,
        })
    }

    /// The camera side and the landmarks, as they are estimated.
    pub fn into_estimate(self) -> (B, Vec<[f64; 3]>) {
        (self.equations.bundle, self.equations.landmarks)
    }
}

impl<const C: usize, B: Bundle<C>> Problem for Schur<C, B> {
    fn linearise(&mut self) -> Linearisation {
        let cost = self.equations.linearise();
        let blocks = self.equations.gradient.as_flattened().iter();
        Linearisation {
            cost,
            gradient_max: absolute_max(blocks.chain(self.equations.landmark_gradient())),
        }
    }

    /// Solves for the camera side first; `None` when the reduced system is not positive definite.
    fn solve(&mut self, damping: f64) -> Option<TrialStep> {
        let equations = &mut self.equations;
        let added = equations.eliminate(damping);
        self.system.solve(
            &equations.layout,
            &equations.sighted,
            &mut equations.points,
            (&equations.terms, &added),
            &mut equations.steps,
        )?;
        equations.substitute();
        Some(TrialStep {
            predicted_decrease: equations.predicted_decrease(0..equations.steps.len(), damping),
            moved: equations.bundle.moved(&equations.steps),
        })
    }

    fn trial_cost(&mut self) -> f64 {
        self.equations.trial_cost()
    }

    fn accept(&mut self) {
        self.equations.accept();
    }
}
