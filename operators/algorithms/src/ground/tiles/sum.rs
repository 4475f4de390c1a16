//! The sums of one tile.

use super::{TILE_CELLS, TileOverflow};

const SUM_BITS: u32 = 36;
const SUM_MASK: u64 = (1 << SUM_BITS) - 1;

/// The sums of one tile: row by row, row 0 in the south.
#[derive(Clone, PartialEq, Eq)]
pub struct TileSum {
    /// Packed as the module's picture shows.
    pub(super) cells: Vec<u64>,
}

impl std::fmt::Debug for TileSum {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let seen = self.cells.iter().filter(|cell| **cell != 0).count();
        write!(f, "TileSum {{ {seen} of {} cells seen }}", self.cells.len())
    }
}

impl Default for TileSum {
    fn default() -> Self {
        Self {
            cells: vec![0; TILE_CELLS * TILE_CELLS],
        }
    }
}

/// A tile as a picture: `TILE_CELLS` × `TILE_CELLS` bytes each, row 0 in the south.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FinishedTile {
    /// Weighted mean grey value, rounded half up; 0 where never seen.
    pub grey: Vec<u8>,
    /// Total weight, at most 255; 0 where never seen.
    pub coverage: Vec<u8>,
}

impl TileSum {
    /// A tile never seen.
    pub fn new() -> Self {
        Self::default()
    }

    /// The weights of the cells that were seen.
    pub fn weights(&self) -> impl Iterator<Item = u32> {
        let weights = self.cells.iter().map(|cell| unpack(*cell).1);
        weights.filter(|weight| *weight > 0)
    }

    /// Bytes that the sums take in memory.
    pub fn bytes(&self) -> usize {
        size_of_val(self.cells.as_slice())
    }

    /// `(sum of value × weight, sum of weight)` of a cell; `(0, 0)` outside the tile.
    pub fn get(&self, column: usize, row: usize) -> (u64, u32) {
        let cell = if column < TILE_CELLS {
            self.cells.get(row * TILE_CELLS + column)
        } else {
            None
        };
        cell.map_or((0, 0), |&cell| unpack(cell))
    }

    /// Adds a run of looks to `row`, starting at `column`; what would leave the tile is ignored.
    ///
    /// # Errors
    /// [`TileOverflow`] when a cell is full; the tile is then useless.
    pub fn add_row(
        &mut self,
        column: usize,
        row: usize,
        values: &[u8],
        weights: &[u8],
    ) -> Result<(), TileOverflow> {
        if column >= TILE_CELLS || row >= TILE_CELLS {
            return Ok(());
        }
        let cells = &mut self.cells[row * TILE_CELLS + column..(row + 1) * TILE_CELLS];
        let mut full = false;
        for ((cell, &value), &weight) in cells.iter_mut().zip(values).zip(weights) {
            let (sum, overflow) = cell.overflowing_add(pack(value, weight));
            *cell = sum;
            full |= overflow;
        }
        if full { Err(TileOverflow) } else { Ok(()) }
    }

    /// Adds all looks of another tile: exact, associative and commutative.
    ///
    /// # Errors
    /// [`TileOverflow`] when a cell is full; the tile is then useless.
    pub fn merge(&mut self, other: &TileSum) -> Result<(), TileOverflow> {
        let mut full = false;
        for (cell, &more) in self.cells.iter_mut().zip(&other.cells) {
            let (sum, overflow) = cell.overflowing_add(more);
            *cell = sum;
            full |= overflow;
        }
        if full { Err(TileOverflow) } else { Ok(()) }
    }

    /// The picture, by exact integer rounding.
    pub fn finish(&self) -> FinishedTile {
        let mean = |&cell: &u64| match unpack(cell) {
            (_, 0) => 0,
            (sum, weight) => {
                ((2 * sum + u64::from(weight)) / (2 * u64::from(weight))).min(255) as u8
            }
        };
        let coverage = |&cell: &u64| unpack(cell).1.min(255) as u8;
        FinishedTile {
            grey: self.cells.iter().map(mean).collect(),
            coverage: self.cells.iter().map(coverage).collect(),
        }
    }
}

fn pack(value: u8, weight: u8) -> u64 {
    (u64::from(weight) << SUM_BITS) + u64::from(value) * u64::from(weight)
}

fn unpack(cell: u64) -> (u64, u32) {
    (cell & SUM_MASK, (cell >> SUM_BITS) as u32)
}
