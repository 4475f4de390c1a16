//! Normal equations `H δ = -g` of D × D blocks, solved by sparse Cholesky.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::cholesky::LltRef;
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};
use nalgebra::{SMatrix, SVector};

use super::structure::{Slot, Structure, SystemError};
use super::trust_region::{TrialStep, absolute_max, damped_diagonal};

/// A symmetric positive definite system of D × D blocks. Numbers only; the pattern is a
/// [`Structure`] and stays as it is.
pub struct BlockSystem<const D: usize> {
    structure: Structure<D>,
    /// One triangle of `H`, in elimination order.
    values: Vec<f64>,
    damped: Vec<f64>,
    factor: Vec<f64>,
    /// `g` in elimination order.
    gradient: Vec<f64>,
    /// `δ` in elimination order.
    step: Vec<f64>,
    memory: MemBuffer,
}

impl<const D: usize> BlockSystem<D> {
    /// With all entries zero.
    ///
    /// # Errors
    /// [`SystemError::OutOfMemory`].
    pub fn new(structure: Structure<D>) -> Result<Self, SystemError> {
        let symbolic = &structure.symbolic;
        let scratch = symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
            .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        let memory = MemBuffer::try_new(scratch).map_err(|_| SystemError::OutOfMemory)?;
        let mut factor = Vec::new();
        factor
            .try_reserve_exact(symbolic.len_val())
            .map_err(|_| SystemError::OutOfMemory)?;
        factor.resize(symbolic.len_val(), 0.0);
        let (entries, n) = (structure.row_idx.len(), structure.unknowns() * D);
        Ok(Self {
            structure,
            values: vec![0.0; entries],
            damped: vec![0.0; entries],
            factor,
            gradient: vec![0.0; n],
            step: vec![0.0; n],
            memory,
        })
    }

    /// Its pattern.
    pub fn structure(&self) -> &Structure<D> {
        &self.structure
    }

    /// All entries of `H` and `g` become zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.gradient.fill(0.0);
    }

    /// All entries of `g` become zero: the next right-hand side for one factor.
    pub(crate) fn clear_gradient(&mut self) {
        self.gradient.fill(0.0);
    }

    /// `H[row, column] += block`, and its transpose across the diagonal. The slot is of
    /// [`Structure::slot`] for (row, column); on the diagonal use [`BlockSystem::add_diagonal`].
    pub fn add(&mut self, slot: Slot, block: &SMatrix<f64, D, D>) {
        let column = slot.column as usize * D;
        for c in 0..D {
            let start = self.structure.col_ptr[column + c] as usize;
            let start = start + slot.place as usize * D - self.skipped(c);
            let Some(values) = self.values.get_mut(start..start + D) else {
                continue;
            };
            for (r, value) in values.iter_mut().enumerate() {
                *value += if slot.transposed {
                    block[(c, r)]
                } else {
                    block[(r, c)]
                };
            }
        }
    }

    /// Entries missing before a block off the diagonal: the lower triangle begins with a diagonal
    /// block that lacks its first `c` rows.
    fn skipped(&self, c: usize) -> usize {
        if self.structure.side == Side::Lower {
            c
        } else {
            0
        }
    }

    /// `H[unknown, unknown] += block`, which is symmetric.
    pub fn add_diagonal(&mut self, unknown: usize, block: &SMatrix<f64, D, D>) {
        let Some(place) = self.structure.place_of.get(unknown) else {
            return;
        };
        let column = *place as usize * D;
        for c in 0..D {
            let (from, to) = (
                self.structure.col_ptr[column + c] as usize,
                self.structure.col_ptr[column + c + 1] as usize,
            );
            match self.structure.side {
                Side::Upper => {
                    let first = to - (c + 1);
                    for r in 0..=c {
                        self.values[first + r] += block[(r, c)];
                    }
                }
                Side::Lower => {
                    for r in c..D {
                        self.values[from + r - c] += block[(r, c)];
                    }
                }
            }
        }
    }

    /// `g[unknown] += part`.
    pub fn add_gradient(&mut self, unknown: usize, part: &SVector<f64, D>) {
        if let Some(place) = self.structure.place_of.get(unknown) {
            let first = *place as usize * D;
            for (value, part) in self.gradient[first..first + D].iter_mut().zip(part.iter()) {
                *value += part;
            }
        }
    }

    /// Largest absolute entry of `g`.
    pub fn gradient_max(&self) -> f64 {
        absolute_max(&self.gradient)
    }

    /// Solves `(H + damping · D) δ = -g`, see [`super::Problem::solve`].
    pub fn solve(&mut self, damping: f64) -> Option<TrialStep> {
        if self.step.is_empty() {
            return Some(TrialStep {
                predicted_decrease: 0.0,
                moved: 0.0,
            });
        }
        let diagonal = self.factorise(damping)?;
        self.back_substitute()?;
        let mut predicted = 0.0;
        for ((step, gradient), diagonal) in self.step.iter().zip(&self.gradient).zip(&diagonal) {
            predicted += 0.5 * step * (damping * diagonal * step - gradient);
        }
        Some(TrialStep {
            predicted_decrease: predicted,
            moved: absolute_max(&self.step),
        })
    }

    /// Fills `damped` and returns `D`.
    fn damp(&mut self, damping: f64) -> Vec<f64> {
        self.damped.copy_from_slice(&self.values);
        let ends = self.structure.col_ptr.windows(2);
        ends.map(|range| {
            let at = match self.structure.side {
                Side::Upper => range[1] as usize - 1,
                Side::Lower => range[0] as usize,
            };
            let diagonal = damped_diagonal(self.values[at]);
            self.damped[at] += damping * diagonal;
            diagonal
        })
        .collect()
    }

    /// Factorises `H + damping · D` and returns `D` in elimination order; `None` when the matrix
    /// is not positive definite.
    pub(crate) fn factorise(&mut self, damping: f64) -> Option<Vec<f64>> {
        let diagonal = self.damp(damping);
        let structure = &self.structure;
        let n = self.step.len();
        if n == 0 {
            return Some(diagonal);
        }
        let pattern = SymbolicSparseColMatRef::new_unsorted_checked(
            n,
            n,
            &structure.col_ptr,
            None,
            &structure.row_idx,
        );
        structure
            .symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(pattern, &self.damped),
                structure.side,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .ok()?;
        Some(diagonal)
    }

    /// Solves for `δ` with the last factor and the present `g`; `None` when `δ` is not finite.
    pub(crate) fn back_substitute(&mut self) -> Option<()> {
        let n = self.step.len();
        for (step, gradient) in self.step.iter_mut().zip(&self.gradient) {
            *step = -gradient;
        }
        LltRef::<'_, u32, f64>::new(&self.structure.symbolic, &self.factor)
            .solve_in_place_with_conj(
                Conj::No,
                MatMut::from_column_major_slice_mut(&mut self.step, n, 1),
                Par::Seq,
                MemStack::new(&mut self.memory),
            );
        self.step
            .iter()
            .all(|value| value.is_finite())
            .then_some(())
    }

    /// Replaces right-hand sides, one after the other and each in the order of unknowns, by solutions with the last factor;
    /// `None` without memory.
    pub(crate) fn solve_many(&self, right: &mut [f64]) -> Option<()> {
        let n = self.step.len();
        if n == 0 {
            return Some(());
        }
        let columns = right.len() / n;
        let symbolic = &self.structure.symbolic;
        let scratch = symbolic.solve_in_place_scratch::<f64>(columns, Par::Seq);
        let mut memory = MemBuffer::try_new(scratch).ok()?;
        let places = self.structure.place_of.iter();
        let places = places.map(|place| *place as usize).enumerate();
        let mut before = vec![0.0; n];
        for column in right.chunks_exact_mut(n) {
            reorder::<D>(column, &mut before, places.clone());
        }
        LltRef::<'_, u32, f64>::new(symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(right, n, columns),
            Par::Seq,
            MemStack::new(&mut memory),
        );
        let back = places.map(|(unknown, place)| (place, unknown));
        for column in right.chunks_exact_mut(n) {
            reorder::<D>(column, &mut before, back.clone());
        }
        Some(())
    }

    /// The last `δ` of one unknown.
    pub fn step(&self, unknown: usize) -> SVector<f64, D> {
        self.structure
            .place_of
            .get(unknown)
            .map_or_else(SVector::zeros, |place| {
                let first = *place as usize * D;
                SVector::from_column_slice(&self.step[first..first + D])
            })
    }
}

/// Moves parts of D numbers from one place to another.
fn reorder<const D: usize>(
    vector: &mut [f64],
    before: &mut [f64],
    moves: impl Iterator<Item = (usize, usize)>,
) {
    before.copy_from_slice(vector);
    for (from, to) in moves {
        vector[to * D..(to + 1) * D].copy_from_slice(&before[from * D..(from + 1) * D]);
    }
}
