//! Symmetric matrices of C × C blocks, one row of them per unknown (pose, camera, session), only the upper triangle.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::{MatMut, Par};

/// One block, row by row.
pub(super) type Block<const C: usize> = [[f64; C]; C];

pub(super) fn diagonal<const C: usize>(entries: &[f64; C]) -> Block<C> {
    std::array::from_fn(|r| std::array::from_fn(|c| if r == c { entries[r] } else { 0.0 }))
}

pub(super) fn transposed<const C: usize>(block: &Block<C>) -> Block<C> {
    std::array::from_fn(|r| std::array::from_fn(|c| block[c][r]))
}

/// Blocks at the places that were announced.
pub(super) struct Blocks<const C: usize> {
    /// `starts[i]..starts[i + 1]`: the blocks of row `i` in `columns` and `entries`.
    pub(super) starts: Vec<usize>,
    /// Columns of the blocks, ascending, the first of a row its diagonal.
    pub(super) columns: Vec<u32>,
    /// The blocks themselves.
    pub(super) entries: Vec<Block<C>>,
}

/// One row of [`Blocks`].
pub(super) struct Row<'a, const C: usize> {
    pub(super) columns: &'a [u32],
    pub(super) blocks: &'a mut [Block<C>],
}

impl<const C: usize> Blocks<C> {
    /// All zero, for `size` unknowns and the pairs of them (smaller first, sorted, unique, without `(i, i)`) that meet.
    pub(super) fn new(size: usize, pairs: &[(u32, u32)]) -> Self {
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
        Self {
            entries: vec![[[0.0; C]; C]; columns.len()],
            starts,
            columns,
        }
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

    /// Adds the blocks of another matrix, as far as they were announced here.
    pub(super) fn add(&mut self, other: &Self) {
        for (row, column, block) in other.iter() {
            if let Some((place, _)) = self.find(row, column) {
                let entries = self.entries[place].as_flattened_mut().iter_mut();
                entries
                    .zip(block.as_flattened())
                    .for_each(|(entry, other)| *entry += other);
            }
        }
    }

    /// Adds to the diagonal.
    pub(super) fn add_diagonal(&mut self, added: &[[f64; C]]) {
        for (row, added) in added.iter().enumerate() {
            let block = &mut self.entries[self.starts[row]];
            (0..C).for_each(|c| block[c][c] += added[c]);
        }
    }

    /// The symmetric matrix times a vector.
    pub(super) fn product(&self, x: &[[f64; C]]) -> Vec<[f64; C]> {
        let mut product = vec![[0.0; C]; x.len()];
        for (row, column, block) in self.iter() {
            for r in 0..C {
                for c in 0..C {
                    product[row][r] += block[r][c] * x[column][c];
                    if row != column {
                        product[column][c] += block[r][c] * x[row][r];
                    }
                }
            }
        }
        product
    }

    /// Row, column and block, in order.
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, usize, &Block<C>)> {
        self.starts.windows(2).enumerate().flat_map(|(row, range)| {
            let columns = &self.columns[range[0]..range[1]];
            let blocks = &self.entries[range[0]..range[1]];
            columns
                .iter()
                .zip(blocks)
                .map(move |(column, block)| (row, *column as usize, block))
        })
    }

    /// The rows, to be filled side by side.
    pub(super) fn rows_mut(&mut self) -> Vec<Row<'_, C>> {
        let mut blocks = self.entries.as_mut_slice();
        let mut rows = Vec::with_capacity(self.starts.len());
        for range in self.starts.windows(2) {
            let (own, rest) = std::mem::take(&mut blocks).split_at_mut(range[1] - range[0]);
            blocks = rest;
            rows.push(Row {
                columns: &self.columns[range[0]..range[1]],
                blocks: own,
            });
        }
        rows
    }
}

/// Threads that the dense factorisation's work is cut for, whatever there are: the cut decides
/// the order of sums.
const DENSE_PARTS: usize = 4;

/// A dense symmetric positive definite matrix and its Cholesky factor in its place.
pub(super) struct Dense {
    size: usize,
    /// Column by column; only the lower triangle counts.
    matrix: Vec<f64>,
    memory: MemBuffer,
}

impl Dense {
    /// All zero; `None` without memory for it.
    pub(super) fn new(size: usize) -> Option<Self> {
        let scratch = llt::factor::cholesky_in_place_scratch::<f64>(
            size,
            dense_parts(size),
            Default::default(),
        );
        let mut matrix = Vec::new();
        matrix.try_reserve_exact(size.checked_mul(size)?).ok()?;
        matrix.resize(size * size, 0.0);
        Some(Self {
            size,
            matrix,
            memory: MemBuffer::try_new(scratch).ok()?,
        })
    }

    pub(super) fn clear(&mut self) {
        self.matrix.fill(0.0);
    }

    /// `H[row.., column..] += block` where `row <= column` in blocks: its mirror is what is kept.
    pub(super) fn add<const C: usize>(&mut self, row: usize, column: usize, block: &Block<C>) {
        for (within, entries) in block.iter().enumerate() {
            let first = (row * C + within) * self.size + column * C;
            for (kept, entry) in self.matrix[first..first + C].iter_mut().zip(entries) {
                *kept += entry;
            }
        }
    }

    /// `None` when the matrix is not positive definite.
    pub(super) fn factorise(&mut self) -> Option<()> {
        let n = self.size;
        llt::factor::cholesky_in_place(
            MatMut::from_column_major_slice_mut(&mut self.matrix, n, n),
            Default::default(),
            dense_parts(n),
            MemStack::new(&mut self.memory),
            Default::default(),
        )
        .ok()
        .map(|_| ())
    }

    /// Replaces right-hand sides, one after the other, by solutions.
    pub(super) fn solve(&mut self, right: &mut [f64]) {
        let n = self.size;
        let columns = right.len() / n.max(1);
        llt::solve::solve_in_place(
            MatMut::from_column_major_slice_mut(&mut self.matrix, n, n).as_ref(),
            MatMut::from_column_major_slice_mut(right, n, columns),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
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
