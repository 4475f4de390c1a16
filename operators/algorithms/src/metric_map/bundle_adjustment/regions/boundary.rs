//! The system of what regions share.

use super::super::blocks::{Block, diagonal};
use super::super::factor::Factor;
use super::condensed::Condensed;
use crate::solving::least_squares::{Structure, SystemError};

/// The sum of what regions leave, and its solution.
pub(super) struct Boundary<const C: usize> {
    factor: Factor<C>,
    /// The right-hand side, then the steps.
    steps: Vec<[f64; C]>,
}

impl<const C: usize> Boundary<C> {
    /// For so many unknowns, and those that each region shares.
    ///
    /// # Errors
    /// [`SystemError`] when its factor does not fit.
    pub(super) fn new<'a>(
        unknowns: usize,
        regions: impl Iterator<Item = &'a [u32]>,
    ) -> Result<Self, SystemError> {
        let mut pairs = Vec::new();
        for shared in regions {
            for (at, row) in shared.iter().enumerate() {
                let onward = shared[at + 1..].iter();
                pairs.extend(onward.map(|column| (*row as usize, *column as usize)));
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        Ok(Self {
            factor: Factor::new(Structure::new(unknowns, pairs)?)?,
            steps: vec![[0.0; C]; unknowns],
        })
    }

    pub(super) fn unknowns(&self) -> usize {
        self.steps.len()
    }

    /// Forgets all regions.
    pub(super) fn clear(&mut self) {
        self.factor.clear();
        self.steps.fill([0.0; C]);
    }

    /// Adds what a region leaves of its shared unknowns, which ascend.
    pub(super) fn add(&mut self, shared: &[u32], left: &Condensed<C>) {
        for ((at, row), blocks) in shared.iter().enumerate().zip(&left.rows) {
            for (column, block) in shared[at..].iter().zip(blocks) {
                self.add_block(*row as usize, *column as usize, block);
            }
        }
        for (row, right) in shared.iter().zip(&left.right) {
            let sum = &mut self.steps[*row as usize];
            (0..C).for_each(|c| sum[c] += right[c]);
        }
    }

    fn add_block(&mut self, row: usize, column: usize, block: &Block<C>) {
        let slot = self.factor.slot(row, column);
        self.factor.add(row, column, slot, block);
    }

    /// Solves for the steps, with so much added to the diagonal; `None` when the matrix is not positive definite.
    pub(super) fn solve(&mut self, added: impl Iterator<Item = [f64; C]>) -> Option<()> {
        for (row, added) in added.enumerate() {
            self.add_block(row, row, &diagonal(&added));
        }
        self.factor.factorise()?;
        self.factor.solve(self.steps.as_flattened_mut())
    }

    /// The last solution.
    pub(super) fn steps(&self) -> &[[f64; C]] {
        &self.steps
    }
}
