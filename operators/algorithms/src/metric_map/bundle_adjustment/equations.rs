//! The normal equations of a bundle, or of a part of one: what is known of each observation, landmark and unknown
//! while a step is sought. Who solves for the camera side is up to the caller.

use rayon::prelude::*;

use super::blocks::Blocks;
use super::elimination::{Layout, Point, Sighted, pieces, right_of_block};
use super::schur::{Bundle, Linear, Terms};
use crate::solving::least_squares::damped_diagonal;

pub(super) struct Equations<const C: usize, B> {
    /// The camera side.
    pub(super) bundle: B,
    /// The landmarks' estimates.
    pub(super) landmarks: Vec<[f64; 3]>,
    trial: Vec<[f64; 3]>,
    pub(super) layout: Layout,
    pub(super) sighted: Vec<Sighted<C>>,
    pub(super) points: Vec<Point>,
    /// The terms without landmarks.
    pub(super) terms: Blocks<C>,
    terms_gradient: Vec<[f64; C]>,
    /// Of the camera side.
    pub(super) gradient: Vec<[f64; C]>,
    /// Of the camera side's Hessian.
    pub(super) diagonal: Vec<[f64; C]>,
    /// The right-hand side of the reduced system, then its solution.
    pub(super) steps: Vec<[f64; C]>,
}

impl<const C: usize, B: Bundle<C>> Equations<C, B> {
    /// `terms` has a place for every pair of unknowns that meet without landmarks.
    pub(super) fn new(
        bundle: B,
        landmarks: Vec<[f64; 3]>,
        layout: Layout,
        terms: Blocks<C>,
    ) -> Self {
        let blocks = layout.by_block.len();
        Self {
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
            steps: vec![[0.0; C]; blocks],
        }
    }

    /// Residuals, derivatives, gradient and diagonal at the estimate; gives the cost.
    pub(super) fn linearise(&mut self) -> f64 {
        let cost = self.linearise_landmarks() + self.linearise_terms();
        self.gather_blocks();
        cost
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

    /// The landmarks' part of the gradient.
    pub(super) fn landmark_gradient(&self) -> impl Iterator<Item = &f64> {
        self.points.iter().flat_map(|point| &point.gradient)
    }

    /// Eliminates the landmarks: `steps` becomes the right-hand side of the reduced system. Gives what damping adds to the
    /// diagonal.
    pub(super) fn eliminate(&mut self, damping: f64) -> Vec<[f64; C]> {
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
        added.collect()
    }

    /// The trial, from the camera side's steps.
    pub(super) fn substitute(&mut self) {
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
        self.bundle.step(&self.steps);
    }

    /// By how much the quadratic model falls, as far as these unknowns and the landmarks make it.
    pub(super) fn predicted_decrease(
        &self,
        blocks: impl Iterator<Item = usize>,
        damping: f64,
    ) -> f64 {
        let mut predicted = 0.0;
        for block in blocks {
            let (step, gradient) = (&self.steps[block], &self.gradient[block]);
            add_decrease(
                &mut predicted,
                (step, gradient),
                &self.diagonal[block],
                damping,
            );
        }
        for point in &self.points {
            let own = (&point.step, &point.gradient);
            add_decrease(&mut predicted, own, &point.diagonal(), damping);
        }
        predicted
    }

    /// `½ Σ ρ` at the trial.
    pub(super) fn trial_cost(&mut self) -> f64 {
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

    /// The estimate becomes the trial.
    pub(super) fn accept(&mut self) {
        self.bundle.accept();
        self.landmarks.copy_from_slice(&self.trial);
    }
}

/// Adds the part of an unknown to the decrease that is predicted: `½ δᵀ (damping · D δ - g)`.
pub(super) fn add_decrease<const N: usize>(
    predicted: &mut f64,
    (step, gradient): (&[f64; N], &[f64; N]),
    diagonal: &[f64; N],
    damping: f64,
) {
    for n in 0..N {
        let damped = damping * damped_diagonal(diagonal[n]) * step[n];
        *predicted += 0.5 * step[n] * (damped - gradient[n]);
    }
}
