//! A symmetric positive definite system of blocks, factorised: dense where nearly everything meets everything, else sparse.

use nalgebra::SMatrix;

use super::blocks::{Block, Dense};
use crate::solving::least_squares::{BlockSystem, Slot, Structure, SystemError};

/// The sparse factor must have less than this part of the dense one's entries to be worth its
/// bookkeeping.
const SPARSE_BELOW: f64 = 0.6;

pub(super) enum Factor<const C: usize> {
    Dense(Dense),
    Sparse(Box<BlockSystem<C>>),
}

impl<const C: usize> Factor<C> {
    /// All zero.
    pub(super) fn new(structure: Structure<C>) -> Result<Self, SystemError> {
        if is_dense(&structure) {
            let dense = Dense::new(structure.unknowns() * C);
            return Ok(Self::Dense(dense.ok_or(SystemError::OutOfMemory)?));
        }
        Ok(Self::Sparse(Box::new(BlockSystem::new(structure)?)))
    }

    /// All entries become zero.
    pub(super) fn clear(&mut self) {
        match self {
            Self::Dense(dense) => dense.clear(),
            Self::Sparse(system) => system.clear(),
        }
    }

    /// Where the block of two unknowns goes; `None` where that needs no slot.
    pub(super) fn slot(&self, row: usize, column: usize) -> Option<Slot> {
        match self {
            Self::Dense(_) => None,
            Self::Sparse(_) if row == column => None,
            Self::Sparse(system) => system.structure().slot(row, column),
        }
    }

    /// Adds to the block of `row <= column`, whose slot is `slot`.
    pub(super) fn add(&mut self, row: usize, column: usize, slot: Option<Slot>, block: &Block<C>) {
        match self {
            Self::Dense(dense) => dense.add(row, column, block),
            Self::Sparse(system) => {
                // nalgebra is column-major: our rows are its columns.
                let transposed = SMatrix::<f64, C, C>::from(*block);
                match slot {
                    Some(slot) => system.add(slot, &transposed.transpose()),
                    None => system.add_diagonal(row, &transposed),
                }
            }
        }
    }

    /// `None` when the matrix is not positive definite.
    pub(super) fn factorise(&mut self) -> Option<()> {
        match self {
            Self::Dense(dense) => dense.factorise(),
            Self::Sparse(system) => system.factorise(0.0).map(|_| ()),
        }
    }

    /// Replaces right-hand sides, one after the other, by solutions; `None` when they are not finite, or without memory.
    pub(super) fn solve(&mut self, right: &mut [f64]) -> Option<()> {
        match self {
            Self::Dense(dense) => dense.solve(right),
            Self::Sparse(system) => system.solve_many(right)?,
        }
        right.iter().all(|x| x.is_finite()).then_some(())
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
