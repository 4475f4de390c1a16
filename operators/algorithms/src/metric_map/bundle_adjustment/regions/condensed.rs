//! A region's unknowns eliminated, but for those that it shares.
//!
//! With the reduced system `[A B; Bᵀ D]` of what it has alone and what it shares, right-hand side `(a, d)`:
//!
//! ```text
//! D - Bᵀ A⁻¹ B,  d - Bᵀ A⁻¹ a      what is left for the boundary
//! A⁻¹ a - (A⁻¹ B) δ                 its own steps, from those of the boundary
//! ```

use rayon::prelude::*;

use super::super::blocks::{Block, Blocks, transposed};
use super::super::factor::Factor;
use super::region::Failed;
use crate::processor::vectorised;
use crate::solving::least_squares::{Structure, SystemError};

/// Where an unknown of a region is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BlockIndex {
    /// Among those that it has alone.
    Own(u32),
    /// Among those that it shares.
    Shared(u32),
}

/// What is left for the boundary.
pub(super) struct Condensed<const C: usize> {
    /// By row, from the diagonal on.
    pub(super) rows: Vec<Vec<Block<C>>>,
    pub(super) right: Vec<[f64; C]>,
}

/// What gives a region's own steps.
pub(super) struct Interior<const C: usize> {
    unknowns: usize,
    /// Columns of `A⁻¹ B`, then `A⁻¹ a`.
    columns: Vec<f64>,
}

/// Blocks of `B` in the columns of one shared unknown, by row.
type Coupling<const C: usize> = Vec<(u32, Block<C>)>;

/// Eliminates the unknowns that a region has alone. `indices` are those of all, each kind ascending as they do.
pub(super) fn condense<const C: usize>(
    indices: &[BlockIndex],
    matrix: &Blocks<C>,
    right: &[[f64; C]],
) -> Result<(Interior<C>, Condensed<C>), Failed> {
    let shared = indices
        .iter()
        .filter(|index| matches!(index, BlockIndex::Shared(_)));
    let shared = shared.count();
    let own = indices.len() - shared;
    let mut left = Condensed {
        rows: (0..shared)
            .map(|row| vec![[[0.0; C]; C]; shared - row])
            .collect(),
        right: vec![[0.0; C]; shared],
    };
    let mut couplings: Vec<Coupling<C>> = vec![Vec::new(); shared];
    let mut inner = Vec::new();
    for (row, column, block) in matrix.iter() {
        match (indices[row], indices[column]) {
            (BlockIndex::Own(row), BlockIndex::Own(column)) => inner.push((row, column, block)),
            (BlockIndex::Own(row), BlockIndex::Shared(column)) => {
                couplings[column as usize].push((row, *block));
            }
            (BlockIndex::Shared(row), BlockIndex::Own(column)) => {
                couplings[row as usize].push((column, transposed(block)));
            }
            (BlockIndex::Shared(row), BlockIndex::Shared(column)) => left.set(row, column, block),
        }
    }
    let mut columns = columns(own, &couplings)?;
    for (index, right) in indices.iter().zip(right) {
        match index {
            BlockIndex::Own(row) => {
                let last = columns.len() - (own - *row as usize) * C;
                columns[last..last + C].copy_from_slice(right);
            }
            BlockIndex::Shared(row) => left.right[*row as usize] = *right,
        }
    }
    if own > 0 {
        let solved = factorised(own, &inner)?.solve(&mut columns);
        solved.ok_or(Failed::NotPositive)?;
    }
    let interior = Interior {
        unknowns: own,
        columns,
    };
    left.subtract(&interior, &couplings);
    Ok((interior, left))
}

/// `B`, and room for one column more.
fn columns<const C: usize>(own: usize, couplings: &[Coupling<C>]) -> Result<Vec<f64>, Failed> {
    let height = own * C;
    let entries = height * (couplings.len() * C + 1);
    let mut columns = Vec::new();
    let room = columns.try_reserve_exact(entries);
    room.map_err(|_| Failed::System(SystemError::OutOfMemory))?;
    columns.resize(entries, 0.0);
    for (shared, blocks) in couplings.iter().enumerate() {
        for (row, block) in blocks {
            for (r, values) in block.iter().enumerate() {
                for (c, value) in values.iter().enumerate() {
                    columns[(shared * C + c) * height + *row as usize * C + r] = *value;
                }
            }
        }
    }
    Ok(columns)
}

/// `A`, factorised.
fn factorised<const C: usize>(
    own: usize,
    inner: &[(u32, u32, &Block<C>)],
) -> Result<Factor<C>, Failed> {
    let pairs = inner.iter();
    let pairs = pairs.map(|(row, column, _)| (*row as usize, *column as usize));
    let structure = Structure::new(own, pairs).map_err(Failed::System)?;
    let mut factor = Factor::new(structure).map_err(Failed::System)?;
    for (row, column, block) in inner {
        let (row, column) = (*row as usize, *column as usize);
        let slot = factor.slot(row, column);
        factor.add(row, column, slot, block);
    }
    factor.factorise().ok_or(Failed::NotPositive)?;
    Ok(factor)
}

impl<const C: usize> Condensed<C> {
    /// The block of two shared unknowns, in any order.
    fn set(&mut self, row: u32, column: u32, block: &Block<C>) {
        let (row, column) = (row as usize, column as usize);
        if row <= column {
            self.rows[row][column - row] = *block;
        } else {
            self.rows[column][row - column] = transposed(block);
        }
    }

    /// `- Bᵀ A⁻¹ (B a)`.
    fn subtract(&mut self, interior: &Interior<C>, couplings: &[Coupling<C>]) {
        let rows = self.rows.par_iter_mut().zip(&mut self.right);
        let rows = rows.zip(couplings).enumerate();
        rows.for_each(|(row, ((blocks, right), coupling))| {
            vectorised(
                #[inline(always)]
                || {
                    for (unknown, block) in coupling {
                        let own = *unknown as usize;
                        for (after, target) in blocks.iter_mut().enumerate() {
                            (0..C).for_each(|c| {
                                let part = interior.part((row + after) * C + c, own);
                                let product = transposed_times(block, part);
                                (0..C).for_each(|r| target[r][c] -= product[r]);
                            });
                        }
                        let part = interior.part(couplings.len() * C, own);
                        let product = transposed_times(block, part);
                        (0..C).for_each(|r| right[r] -= product[r]);
                    }
                },
            );
        });
    }
}

/// `Bᵀ x` of one block.
#[inline(always)]
fn transposed_times<const C: usize>(block: &Block<C>, x: &[f64]) -> [f64; C] {
    let mut product = [0.0; C];
    for (row, x) in block.iter().zip(x) {
        (0..C).for_each(|c| product[c] += row[c] * x);
    }
    product
}

impl<const C: usize> Interior<C> {
    /// What a column has of one unknown.
    #[inline(always)]
    fn part(&self, column: usize, unknown: usize) -> &[f64] {
        let first = (column * self.unknowns + unknown) * C;
        &self.columns[first..first + C]
    }

    /// The steps of what the region has alone, from those of what it shares.
    pub(super) fn steps(&self, shared: &[[f64; C]]) -> Vec<[f64; C]> {
        let height = (self.unknowns * C).max(1);
        let mut columns = self.columns.chunks_exact(height);
        let factors = shared.as_flattened().iter().map(|step| -step).chain([1.0]);
        let mut steps = vec![[0.0; C]; self.unknowns];
        for (column, factor) in columns.by_ref().zip(factors) {
            let entries = steps.as_flattened_mut().iter_mut().zip(column);
            entries.for_each(|(sum, entry)| *sum += factor * entry);
        }
        steps
    }
}
