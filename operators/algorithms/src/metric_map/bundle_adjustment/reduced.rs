//! The system that is left when the landmarks are eliminated: blocks of C × C, one row of them
//! per pose (or camera, or session), only the upper triangle.
//!
//! Rows are filled side by side, each by one thread and in a fixed order, so a sum never depends
//! on how many threads there are. Then the rows go to a dense Cholesky where nearly everything
//! sees everything, else to the sparse one of [`BlockSystem`].

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::{MatMut, Par};
use nalgebra::{SMatrix, SVector};

use crate::solving::least_squares::{BlockSystem, Slot, Structure, SystemError};

/// One block, row by row.
pub(super) type Block<const C: usize> = [[f64; C]; C];

/// The sparse factor must have less than this part of the dense one's entries to be worth its
/// bookkeeping.
const SPARSE_BELOW: f64 = 0.6;

/// Threads that the dense factorisation's work is cut for, whatever there are: the cut decides
/// the order of sums.
const DENSE_PARTS: usize = 4;

/// `S δ = b` with `S` symmetric positive definite.
pub(super) struct Reduced<const C: usize> {
    /// `starts[i]..starts[i + 1]`: the blocks of row `i` in `columns` and `blocks`.
    pub(super) starts: Vec<usize>,
    /// Columns of the blocks, ascending, the first of a row its diagonal.
    pub(super) columns: Vec<u32>,
    /// The blocks themselves.
    pub(super) blocks: Vec<Block<C>>,
    /// `b`, later `δ`.
    pub(super) right: Vec<[f64; C]>,
    solver: Solver<C>,
}

enum Solver<const C: usize> {
    Dense {
        matrix: Vec<f64>,
        memory: MemBuffer,
    },
    Sparse {
        system: Box<BlockSystem<C>>,
        /// For every block off the diagonal its place, for those on it `None`.
        slots: Vec<Option<Slot>>,
    },
}

impl<const C: usize> Reduced<C> {
    /// All zero, for `size` unknowns and the pairs of them (smaller first, sorted, unique, without
    /// `(i, i)`) that meet.
    pub(super) fn new(size: usize, pairs: &[(u32, u32)]) -> Result<Self, SystemError> {
        let mut starts = Vec::with_capacity(size + 1);
        let mut columns = Vec::with_capacity(size + pairs.len());
        let mut rest = pairs;
        for row in 0..size as u32 {
            starts.push(columns.len());
            columns.push(row);
            let own = rest.partition_point(|(first, _)| *first <= row);
            columns.extend(rest[..own].iter().map(|(_, second)| *second));
            rest = &rest[own..];
        }
        starts.push(columns.len());
        let structure =
            Structure::new(size, pairs.iter().map(|(a, b)| (*a as usize, *b as usize)))?;
        let solver = Solver::new(structure, &starts, &columns)?;
        Ok(Self {
            blocks: vec![[[0.0; C]; C]; columns.len()],
            right: vec![[0.0; C]; size],
            starts,
            columns,
            solver,
        })
    }

    /// Where the block of two unknowns lies, and whether it is the transposed one.
    pub(super) fn find(&self, row: usize, column: usize) -> Option<(usize, bool)> {
        let (first, second) = (row.min(column), row.max(column));
        let range = *self.starts.get(first)?..*self.starts.get(first + 1)?;
        let place = self.columns[range.clone()]
            .binary_search(&(second as u32))
            .ok()?;
        Some((range.start + place, row > column))
    }

    /// The rows, to be filled side by side: columns, blocks and right-hand side of each.
    pub(super) fn rows_mut(&mut self) -> Vec<Row<'_, C>> {
        let mut blocks = self.blocks.as_mut_slice();
        let mut right = self.right.iter_mut();
        let mut rows = Vec::with_capacity(self.starts.len());
        for range in self.starts.windows(2) {
            let (own, rest) = std::mem::take(&mut blocks).split_at_mut(range[1] - range[0]);
            blocks = rest;
            if let Some(right) = right.next() {
                rows.push(Row {
                    columns: &self.columns[range[0]..range[1]],
                    blocks: own,
                    right,
                });
            }
        }
        rows
    }

    /// Replaces the right-hand side by the solution; `None` when the matrix is not positive
    /// definite.
    pub(super) fn solve(&mut self) -> Option<()> {
        let n = self.right.len() * C;
        match &mut self.solver {
            Solver::Dense { matrix, memory } => {
                fill_dense(matrix, &self.starts, &self.columns, &self.blocks);
                let stack = MemStack::new(memory);
                let (par, right) = (dense_parts(n), self.right.as_flattened_mut());
                let mut factor = MatMut::from_column_major_slice_mut(matrix, n, n);
                llt::factor::cholesky_in_place(
                    factor.as_mut(),
                    Default::default(),
                    par,
                    stack,
                    Default::default(),
                )
                .ok()?;
                let right = MatMut::from_column_major_slice_mut(right, n, 1);
                llt::solve::solve_in_place(factor.as_ref(), right, Par::Seq, stack);
            }
            Solver::Sparse { system, slots } => {
                system.clear();
                fill_sparse(system, slots, &self.starts, &self.blocks, &self.right);
                system.solve(0.0)?;
                for (unknown, right) in self.right.iter_mut().enumerate() {
                    *right = system.step(unknown).into();
                }
            }
        }
        let finite = self.right.as_flattened().iter().all(|x| x.is_finite());
        finite.then_some(())
    }
}

/// One row of a [`Reduced`] system.
pub(super) struct Row<'a, const C: usize> {
    pub(super) columns: &'a [u32],
    pub(super) blocks: &'a mut [Block<C>],
    pub(super) right: &'a mut [f64; C],
}

impl<const C: usize> Solver<C> {
    fn new(
        structure: Structure<C>,
        starts: &[usize],
        columns: &[u32],
    ) -> Result<Self, SystemError> {
        let n = structure.unknowns() * C;
        let dense = 0.5 * n as f64 * n as f64;
        if structure.factor_entries() as f64 > SPARSE_BELOW * dense {
            let scratch = llt::factor::cholesky_in_place_scratch::<f64>(
                n,
                dense_parts(n),
                Default::default(),
            );
            return Ok(Solver::Dense {
                matrix: vec![0.0; n * n],
                memory: MemBuffer::try_new(scratch).map_err(|_| SystemError::OutOfMemory)?,
            });
        }
        let mut slots = Vec::with_capacity(columns.len());
        for (row, range) in starts.windows(2).enumerate() {
            let own = &columns[range[0]..range[1]];
            slots.extend(own.iter().map(|column| {
                (*column as usize != row)
                    .then(|| structure.slot(row, *column as usize))
                    .flatten()
            }));
        }
        Ok(Solver::Sparse {
            system: Box::new(BlockSystem::new(structure)?),
            slots,
        })
    }
}

fn dense_parts(n: usize) -> Par {
    // Below this, handing out work costs more than the work.
    if n < 256 {
        Par::Seq
    } else {
        Par::rayon(DENSE_PARTS)
    }
}

/// The lower triangle, column by column: a row of the upper one is a column of it.
fn fill_dense<const C: usize>(
    matrix: &mut [f64],
    starts: &[usize],
    columns: &[u32],
    blocks: &[Block<C>],
) {
    matrix.fill(0.0);
    let n = (starts.len() - 1) * C;
    for (row, range) in starts.windows(2).enumerate() {
        for within in 0..C {
            let column = &mut matrix[(row * C + within) * n..][..n];
            for place in range[0]..range[1] {
                let first = columns[place] as usize * C;
                column[first..first + C].copy_from_slice(&blocks[place][within]);
            }
        }
    }
}

fn fill_sparse<const C: usize>(
    system: &mut BlockSystem<C>,
    slots: &[Option<Slot>],
    starts: &[usize],
    blocks: &[Block<C>],
    right: &[[f64; C]],
) {
    for (row, range) in starts.windows(2).enumerate() {
        for place in range[0]..range[1] {
            // nalgebra is column-major: our rows are its columns.
            let transposed = SMatrix::<f64, C, C>::from(blocks[place]);
            match slots[place] {
                Some(slot) => system.add(slot, &transposed.transpose()),
                None => system.add_diagonal(row, &transposed),
            }
        }
        system.add_gradient(row, &-SVector::<f64, C>::from(right[row]));
    }
}
