//! The system that is left when the landmarks are eliminated, formed and factorised.
//!
//! Rows are filled side by side, each by one thread and in a fixed order, so a sum never depends
//! on how many threads there are. Then the rows go to a dense Cholesky where nearly everything
//! sees everything, else to the sparse one of [`BlockSystem`].

use nalgebra::{SMatrix, SVector};

use super::blocks::{Blocks, Dense};
use super::elimination::{Layout, Sighted, fill};
use crate::solving::least_squares::{BlockSystem, Slot, Structure, SystemError};

/// The sparse factor must have less than this part of the dense one's entries to be worth its
/// bookkeeping.
const SPARSE_BELOW: f64 = 0.6;

/// `S δ = b` with `S` symmetric positive definite.
pub(super) struct Reduced<const C: usize> {
    matrix: Blocks<C>,
    solver: Solver<C>,
}

enum Solver<const C: usize> {
    Dense(Dense),
    Sparse {
        system: Box<BlockSystem<C>>,
        /// For every block off the diagonal its place, for those on it `None`.
        slots: Vec<Option<Slot>>,
    },
}

impl<const C: usize> Reduced<C> {
    /// All zero, for the pairs of unknowns (smaller first, sorted, unique, without `(i, i)`) that meet.
    pub(super) fn new(structure: Structure<C>, pairs: &[(u32, u32)]) -> Result<Self, SystemError> {
        let matrix = Blocks::new(structure.unknowns(), pairs);
        let solver = Solver::new(structure, &matrix)?;
        Ok(Self { matrix, solver })
    }

    /// As [`super::system::System::solve`].
    pub(super) fn solve(
        &mut self,
        layout: &Layout,
        sighted: &[Sighted<C>],
        own: (&Blocks<C>, &[[f64; C]]),
        right: &mut [[f64; C]],
    ) -> Option<()> {
        fill(&mut self.matrix, layout, sighted, own);
        match &mut self.solver {
            Solver::Dense(dense) => {
                dense.clear();
                for (row, column, block) in self.matrix.iter() {
                    dense.add(row, column, block);
                }
                dense.factorise()?;
                dense.solve(right.as_flattened_mut());
            }
            Solver::Sparse { system, slots } => {
                system.clear();
                fill_sparse(system, slots, &self.matrix, right);
                system.solve(0.0)?;
                for (unknown, right) in right.iter_mut().enumerate() {
                    *right = system.step(unknown).into();
                }
            }
        }
        let finite = right.as_flattened().iter().all(|x| x.is_finite());
        finite.then_some(())
    }
}

/// Products of two numbers in a factorisation, roughly: a factor of `e` entries in `n` columns of even length takes
/// `e² / n`.
pub(super) fn work<const C: usize>(structure: &Structure<C>) -> f64 {
    let entries = if is_dense(structure) {
        dense_entries(structure)
    } else {
        structure.factor_entries() as f64
    };
    entries * entries / ((structure.unknowns() * C) as f64).max(1.0)
}

fn is_dense<const C: usize>(structure: &Structure<C>) -> bool {
    structure.factor_entries() as f64 > SPARSE_BELOW * dense_entries(structure)
}

fn dense_entries<const C: usize>(structure: &Structure<C>) -> f64 {
    0.5 * ((structure.unknowns() * C) as f64).powi(2)
}

impl<const C: usize> Solver<C> {
    fn new(structure: Structure<C>, matrix: &Blocks<C>) -> Result<Self, SystemError> {
        if is_dense(&structure) {
            let dense = Dense::new(structure.unknowns() * C);
            return Ok(Solver::Dense(dense.ok_or(SystemError::OutOfMemory)?));
        }
        let slots = matrix.iter().map(|(row, column, _)| {
            let off = column != row;
            off.then(|| structure.slot(row, column)).flatten()
        });
        Ok(Solver::Sparse {
            slots: slots.collect(),
            system: Box::new(BlockSystem::new(structure)?),
        })
    }
}

fn fill_sparse<const C: usize>(
    system: &mut BlockSystem<C>,
    slots: &[Option<Slot>],
    matrix: &Blocks<C>,
    right: &[[f64; C]],
) {
    for ((row, _, block), slot) in matrix.iter().zip(slots) {
        // nalgebra is column-major: our rows are its columns.
        let transposed = SMatrix::<f64, C, C>::from(*block);
        match slot {
            Some(slot) => system.add(*slot, &transposed.transpose()),
            None => system.add_diagonal(row, &transposed),
        }
    }
    for (row, right) in right.iter().enumerate() {
        system.add_gradient(row, &-SVector::<f64, C>::from(*right));
    }
}
