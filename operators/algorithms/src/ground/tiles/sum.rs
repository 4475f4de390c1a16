//! The sums of one tile.

use super::{TILE_CELLS, TileOverflow};
use crate::ground::channels::{Channels, plainest};

const SUM_BITS: u32 = 36;
const SUM_MASK: u64 = (1 << SUM_BITS) - 1;
/// Cells of a tile.
pub(super) const CELLS: usize = TILE_CELLS * TILE_CELLS;

/// The sums of one tile: row by row, row 0 in the south. They are of grey values until a look in colour comes, and of red,
/// green and blue from then on: what was grey counts as three equal values.
#[derive(Clone, PartialEq, Eq)]
pub struct TileSum {
    /// Packed as the module's picture shows: one for each cell, or three side by side, of equal weight.
    pub(super) cells: Vec<u64>,
}

impl std::fmt::Debug for TileSum {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let seen = self.weights().count();
        let channels = self.channels();
        write!(
            f,
            "TileSum {{ {channels:?}, {seen} of {CELLS} cells seen }}"
        )
    }
}

impl Default for TileSum {
    fn default() -> Self {
        Self {
            cells: vec![0; CELLS],
        }
    }
}

/// A tile as a picture: `TILE_CELLS` × `TILE_CELLS` cells, row 0 in the south.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FinishedTile {
    /// What is known of each cell; grey where no cell has a colour.
    pub channels: Channels,
    /// Weighted mean of each channel, cell by cell, rounded half up; 0 where never seen.
    pub values: Vec<u8>,
    /// Total weight, at most 255; 0 where never seen.
    pub coverage: Vec<u8>,
}

impl TileSum {
    /// A tile never seen.
    pub fn new() -> Self {
        Self::default()
    }

    /// What is added up for each cell.
    pub fn channels(&self) -> Channels {
        if self.cells.len() == CELLS {
            Channels::Grey
        } else {
            Channels::Colour
        }
    }

    /// The weights of the cells that were seen.
    pub fn weights(&self) -> impl Iterator<Item = u32> {
        let cells = self.cells.iter().step_by(self.channels().count());
        let weights = cells.map(|cell| unpack(*cell).1);
        weights.filter(|weight| *weight > 0)
    }

    /// Makes room for colours: what was added so far is equal in all of them.
    fn widen(&mut self) {
        if self.channels() == Channels::Grey {
            self.cells = self.cells.iter().flat_map(|sum| [*sum; 3]).collect();
        }
    }

    /// Bytes that the sums take in memory.
    pub fn bytes(&self) -> usize {
        size_of_val(self.cells.as_slice())
    }

    /// Sums of value × weight, of red, green and blue or three times of grey, and the sum of weights of a cell; all 0 outside
    /// the tile.
    pub fn get(&self, column: usize, row: usize) -> ([u64; 3], u32) {
        let count = self.channels().count();
        let at = row * TILE_CELLS + column;
        let is_within = column < TILE_CELLS && at < CELLS;
        let sum = |channel: usize| match is_within {
            true => unpack(self.cells[at * count + channel.min(count - 1)]),
            false => (0, 0),
        };
        ([0, 1, 2].map(|channel| sum(channel).0), sum(0).1)
    }

    /// Adds a run of looks to `row`, starting at `column`; what would leave the tile is ignored. There is one value for each
    /// weight, or three in colour.
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
        let in_colour = values.len() > weights.len();
        if in_colour {
            self.widen();
        }
        let channels = self.channels();
        let [from, to] = [row * TILE_CELLS + column, (row + 1) * TILE_CELLS];
        let cells = &mut self.cells[from * channels.count()..to * channels.count()];
        match channels {
            Channels::Grey => add_looks(cells, values.iter().map(|grey| [*grey]), weights),
            Channels::Colour if in_colour => {
                let (colours, _) = values.as_chunks::<3>();
                add_looks(cells, colours.iter().copied(), weights)
            }
            Channels::Colour => add_looks(cells, values.iter().map(|grey| [*grey; 3]), weights),
        }
    }

    /// Adds all looks of another tile: exact, associative and commutative.
    ///
    /// # Errors
    /// [`TileOverflow`] when a cell is full; the tile is then useless.
    pub fn merge(&mut self, other: &TileSum) -> Result<(), TileOverflow> {
        if other.channels() == Channels::Colour {
            self.widen();
        }
        let is_wider = self.channels() > other.channels();
        let more = other.cells.iter();
        let mut fits = true;
        if is_wider {
            let (cells, _) = self.cells.as_chunks_mut::<3>();
            for (sums, more) in cells.iter_mut().zip(more) {
                sums.iter_mut().for_each(|sum| fits &= add(sum, *more));
            }
        } else {
            for (sum, more) in self.cells.iter_mut().zip(more) {
                fits &= add(sum, *more);
            }
        }
        if fits { Ok(()) } else { Err(TileOverflow) }
    }

    /// The picture, by exact integer rounding. It is grey where no cell has a colour, whatever the looks were.
    pub fn finish(&self) -> FinishedTile {
        let mean = |&cell: &u64| match unpack(cell) {
            (_, 0) => 0,
            (sum, weight) => {
                ((2 * sum + u64::from(weight)) / (2 * u64::from(weight))).min(255) as u8
            }
        };
        let coverage = |&cell: &u64| unpack(cell).1.min(255) as u8;
        let means: Vec<u8> = self.cells.iter().map(mean).collect();
        let values = match self.channels() {
            Channels::Grey => means,
            Channels::Colour => plainest(means),
        };
        let first = self.cells.iter().step_by(self.channels().count());
        FinishedTile {
            channels: if values.len() == CELLS {
                Channels::Grey
            } else {
                Channels::Colour
            },
            values,
            coverage: first.map(coverage).collect(),
        }
    }
}

/// Adds looks to cells that each have a sum for each value.
fn add_looks<const COUNT: usize>(
    cells: &mut [u64],
    looks: impl Iterator<Item = [u8; COUNT]>,
    weights: &[u8],
) -> Result<(), TileOverflow> {
    let (cells, _) = cells.as_chunks_mut::<COUNT>();
    let mut fits = true;
    for ((sums, look), weight) in cells.iter_mut().zip(looks).zip(weights) {
        for (sum, value) in sums.iter_mut().zip(look) {
            fits &= add(sum, pack(value, *weight));
        }
    }
    if fits { Ok(()) } else { Err(TileOverflow) }
}

/// Adds to a sum; false where it is full.
fn add(sum: &mut u64, more: u64) -> bool {
    let (added, overflow) = sum.overflowing_add(more);
    *sum = added;
    !overflow
}

fn pack(value: u8, weight: u8) -> u64 {
    (u64::from(weight) << SUM_BITS) + u64::from(value) * u64::from(weight)
}

fn unpack(cell: u64) -> (u64, u32) {
    (cell & SUM_MASK, (cell >> SUM_BITS) as u32)
}
