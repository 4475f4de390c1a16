//! The exact solve of paper 1, Eq. 1 to 3, with weights.

use nalgebra::{SMatrix, SVector};

use crate::ground::cells::{Cell, neighbours};
use crate::solving::least_squares::{BlockSystem, Slot, Structure, SystemError};

/// Weights of what is known beforehand, in looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// Of a cell's kind of ground, a; above 0.
    pub prior_looks: f64,
    /// Of the tie between two neighbours, t; not below 0.
    pub tie_looks: f64,
}

/// What was seen of a cell.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LookCounts {
    /// Looks at it, n.
    pub looks: f64,
    /// Looks in which somebody was there, k; between 0 and n.
    pub people: f64,
}

/// Cells and which of them are neighbours: the pattern of the system, factorised symbolically once.
pub struct DangerField {
    cells: Vec<Cell>,
    /// Neighbours, and where their tie is in the matrix.
    ties: Vec<(usize, usize, Slot)>,
    system: BlockSystem<1>,
}

impl DangerField {
    /// Of cells in ascending order, each once.
    ///
    /// # Errors
    /// [`SystemError`] when there are more than fit.
    pub fn new(cells: Vec<Cell>) -> Result<Self, SystemError> {
        let pairs = neighbours(&cells);
        let structure = Structure::new(cells.len(), pairs.iter().copied())?;
        let slot = |(one, other): (usize, usize)| Some((one, other, structure.slot(one, other)?));
        let ties = pairs.into_iter().filter_map(slot).collect();
        Ok(Self {
            cells,
            ties,
            system: BlockSystem::new(structure)?,
        })
    }

    /// The cells, in ascending order.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// The probability of each cell. `priors` and `seen` are in the order of the cells. `None` where the system is singular
    /// or not finite, which weights above 0 and numbers do not make it.
    pub fn solve(
        &mut self,
        priors: &[f64],
        seen: &[LookCounts],
        weights: Weights,
    ) -> Option<Vec<f64>> {
        let Weights {
            prior_looks: a,
            tie_looks: t,
        } = weights;
        let system = &mut self.system;
        system.clear();
        for (cell, (prior, seen)) in priors.iter().zip(seen).enumerate() {
            system.add_diagonal(cell, &SMatrix::<f64, 1, 1>::new(a + seen.looks));
            system.add_gradient(cell, &SVector::<f64, 1>::new(-(a * prior + seen.people)));
        }
        for (one, other, slot) in &self.ties {
            for cell in [*one, *other] {
                system.add_diagonal(cell, &SMatrix::<f64, 1, 1>::new(t));
            }
            system.add(*slot, &SMatrix::<f64, 1, 1>::new(-t));
        }
        system.solve(0.0)?;
        let probability = |cell: usize| system.step(cell)[0].clamp(0.0, 1.0);
        Some((0..self.cells.len()).map(probability).collect())
    }
}
