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

use rayon::prelude::*;

use super::blocks::Blocks;
use super::elimination::{Layout, Point, Sighted, pieces, right_of_block};
pub use super::system::LinearSolver;
use super::system::System;
use crate::solving::least_squares::{
    Linearisation, Problem, SystemError, TrialStep, damped_diagonal,
};

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
        let entries = steps.as_flattened().iter();
        entries.fold(0.0, |most: f64, entry| most.max(entry.abs()))
    }

    /// For each unknown, how it changes when all of its group (`groups[block]`) moves together: one column for each
    /// of up to `C` motions. Unless told otherwise, all unknowns of a group change alike.
    fn common_motions(&self, groups: &[u32]) -> Vec<[[f64; C]; C]> {
        let identity =
            std::array::from_fn(|r| std::array::from_fn(|c| f64::from(u8::from(r == c))));
        vec![identity; groups.len()]
    }
}

/// Hessian and gradient of the terms without landmarks.
pub struct Terms<'a, const C: usize> {
    matrix: &'a mut Blocks<C>,
    gradient: &'a mut [[f64; C]],
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
    /// The camera side.
    pub bundle: B,
    /// The landmarks' estimates.
    pub landmarks: Vec<[f64; 3]>,
    layout: Layout,
    sighted: Vec<Sighted<C>>,
    points: Vec<Point>,
    trial: Vec<[f64; 3]>,
    /// The terms without landmarks.
    terms: Blocks<C>,
    terms_gradient: Vec<[f64; C]>,
    gradient: Vec<[f64; C]>,
    diagonal: Vec<[f64; C]>,
    system: System<C>,
    steps: Vec<[f64; C]>,
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
            bundle,
            sighted: vec![Sighted::ZERO; layout.sights.len()],
            points: vec![Point::default(); landmarks.len()],
            trial: landmarks.clone(),
            landmarks,
            layout,
            terms,
            terms_gradient: vec![[0.0; C]; blocks],
            gradient: vec![[0.0; C]; blocks],
            diagonal: vec![[0.0; C]; blocks],
            system,
            steps: vec![[0.0; C]; blocks],
        })
    }

    fn linearise_landmarks(&mut self) -> f64 {
        let (bundle, landmarks) = (&self.bundle, &self.landmarks);
        pieces(&self.layout, &mut self.points, &mut self.sighted)
            .into_par_iter()
            .for_each(|piece| {
                piece.each(|landmark, sights, point, sighted| {
                    point.cost = 0.0;
                    for (sight, sighted) in sights.iter().zip(sighted.iter_mut()) {
                        let observation = sight.observation as usize;
                        let (cost, linear) = bundle.linearise(observation, &landmarks[landmark]);
                        point.cost += cost;
                        sighted.linear = linear;
                    }
                    point.gather(sighted);
                });
            });
        self.points.iter().map(|point| point.cost).sum()
    }

    fn linearise_terms(&mut self) -> f64 {
        self.terms.entries.fill([[0.0; C]; C]);
        self.terms_gradient.fill([0.0; C]);
        self.bundle.add_terms(&mut Terms {
            matrix: &mut self.terms,
            gradient: &mut self.terms_gradient,
        })
    }

    /// Gradient and diagonal of the camera side.
    fn gather_blocks(&mut self) {
        let (sighted, matrix) = (&self.sighted, &self.terms);
        let all = self.gradient.par_iter_mut().zip(&mut self.diagonal);
        let terms = self.terms_gradient.par_iter();
        all.zip(terms)
            .zip(&self.layout.by_block)
            .enumerate()
            .for_each(|(block, (((gradient, diagonal), terms), sights))| {
                *gradient = *terms;
                let own = &matrix.entries[matrix.starts[block]];
                *diagonal = std::array::from_fn(|c| own[c][c]);
                for place in sights {
                    let Linear {
                        residual: [r, s],
                        camera: [j, k],
                        ..
                    } = &sighted[*place as usize].linear;
                    for c in 0..C {
                        gradient[c] += j[c] * r + k[c] * s;
                        diagonal[c] += j[c] * j[c] + k[c] * k[c];
                    }
                }
            });
    }

    /// Solves for the camera side; `None` when the reduced system is not positive definite.
    fn eliminate(&mut self, damping: f64) -> Option<()> {
        pieces(&self.layout, &mut self.points, &mut self.sighted)
            .into_par_iter()
            .for_each(|piece| {
                piece.each(|_, _, point, sighted| {
                    point.factorise(damping);
                    sighted.iter_mut().for_each(|s| s.eliminate(point));
                });
            });
        let (layout, sighted, points) = (&self.layout, &self.sighted, &self.points);
        let right = self.steps.par_iter_mut().zip(&self.terms_gradient);
        right.enumerate().for_each(|(block, (right, terms))| {
            *right = right_of_block(block, layout, sighted, points);
            (0..C).for_each(|c| right[c] -= terms[c]);
        });
        let added = self.diagonal.iter();
        let added = added.map(|own| own.map(|entry| damping * damped_diagonal(entry)));
        let added: Vec<[f64; C]> = added.collect();
        self.system.solve(
            &self.layout,
            &self.sighted,
            &mut self.points,
            (&self.terms, &added),
            &mut self.steps,
        )
    }

    /// The landmarks' steps, from those of the camera side.
    fn substitute(&mut self) {
        let steps = &self.steps;
        pieces(&self.layout, &mut self.points, &mut self.sighted)
            .into_par_iter()
            .for_each(|piece| {
                piece.each(|_, sights, point, sighted| point.substitute(sights, sighted, steps));
            });
        for ((trial, landmark), point) in
            self.trial.iter_mut().zip(&self.landmarks).zip(&self.points)
        {
            *trial = std::array::from_fn(|axis| landmark[axis] + point.step[axis]);
        }
    }

    fn trial_step(&self, damping: f64) -> TrialStep {
        let mut predicted = 0.0;
        let mut count = |step: f64, gradient: f64, diagonal: f64| {
            predicted += 0.5 * step * (damping * damped_diagonal(diagonal) * step - gradient);
        };
        for ((step, gradient), diagonal) in
            self.steps.iter().zip(&self.gradient).zip(&self.diagonal)
        {
            (0..C).for_each(|c| count(step[c], gradient[c], diagonal[c]));
        }
        for point in &self.points {
            let diagonal = point.diagonal();
            (0..3).for_each(|axis| count(point.step[axis], point.gradient[axis], diagonal[axis]));
        }
        TrialStep {
            predicted_decrease: predicted,
            moved: self.bundle.moved(&self.steps),
        }
    }
}

impl<const C: usize, B: Bundle<C>> Problem for Schur<C, B> {
    fn linearise(&mut self) -> Linearisation {
        let cost = self.linearise_landmarks() + self.linearise_terms();
        self.gather_blocks();
        let blocks = self.gradient.as_flattened().iter();
        let points = self.points.iter().flat_map(|point| &point.gradient);
        let gradient_max = blocks.chain(points).fold(0.0, |max: f64, entry| {
            // `f64::max` would hide a NaN.
            if entry.abs() <= max { max } else { entry.abs() }
        });
        Linearisation { cost, gradient_max }
    }

    fn solve(&mut self, damping: f64) -> Option<TrialStep> {
        self.eliminate(damping)?;
        self.substitute();
        self.bundle.step(&self.steps);
        Some(self.trial_step(damping))
    }

    fn trial_cost(&mut self) -> f64 {
        let (bundle, trial) = (&self.bundle, &self.trial);
        pieces(&self.layout, &mut self.points, &mut self.sighted)
            .into_par_iter()
            .for_each(|piece| {
                piece.each(|landmark, sights, point, _| {
                    let costs = sights.iter().map(|sight| {
                        bundle.trial_cost(sight.observation as usize, &trial[landmark])
                    });
                    point.cost = costs.sum();
                });
            });
        let landmarks: f64 = self.points.iter().map(|point| point.cost).sum();
        landmarks + self.bundle.trial_terms_cost()
    }

    fn accept(&mut self) {
        self.bundle.accept();
        self.landmarks.copy_from_slice(&self.trial);
    }
}
