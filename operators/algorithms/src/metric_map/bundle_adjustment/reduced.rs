//! The system that is left when the landmarks are eliminated, formed and factorised.
//!
//! Rows are filled side by side, each by one thread and in a fixed order, so a sum never depends
//! on how many threads there are.

use super::blocks::Blocks;
use super::elimination::{Layout, Sighted, fill};
use super::factor::Factor;
use crate::solving::least_squares::{Slot, Structure, SystemError};

/// `S δ = b` with `S` symmetric positive definite.
pub(super) struct Reduced<const C: usize> {
    matrix: Blocks<C>,
    /// Where each block goes.
    slots: Vec<Option<Slot>>,
    factor: Factor<C>,
}

impl<const C: usize> Reduced<C> {
    /// All zero, for the pairs of unknowns (smaller first, sorted, unique, without `(i, i)`) that meet.
    pub(super) fn new(structure: Structure<C>, pairs: &[(u32, u32)]) -> Result<Self, SystemError> {
        let matrix = Blocks::new(structure.unknowns(), pairs);
        let factor = Factor::new(structure)?;
        let slots = matrix
            .iter()
            .map(|(row, column, _)| factor.slot(row, column));
        Ok(Self {
            slots: slots.collect(),
            matrix,
            factor,
        })
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
        self.factor.clear();
        for ((row, column, block), slot) in self.matrix.iter().zip(&self.slots) {
            self.factor.add(row, column, *slot, block);
        }
        self.factor.factorise()?;
        self.factor.solve(right.as_flattened_mut())
    }
}
