//! Map tiles whose sums are exact, so that no order of work can change a byte.
//!
//! The overhead image is a running mean over every look at every cell, made by many threads and
//! machines. Floating-point means would depend on who came first. Here a cell is one 64-bit
//! integer with two fields:
//!
//! ```text
//!  63            36 35                        0
//! | weight, 28 bit | value × weight, 36 bit    |
//! ```
//!
//! Merging two tiles is 65 536 integer additions: associative, commutative, and half the memory
//! of separate fields. One look adds at most 255 to the weight and 255 × 255 to the sum, so a
//! cell holds 2²⁰ looks of full weight (1 052 688, to be exact). As no value exceeds 255 the
//! lower field is always below 255 times the upper one and cannot overflow first; one more look
//! than the upper field can hold overflows the whole integer, which is detected
//! ([`TileOverflow`]) in any order of merging alike.
//!
//! Cells are numbered globally: cell (i, j) covers `[i, i+1) × [j, j+1)` times `cell_m` metres of
//! the map frame, x east and y north, at zoom 0; every zoom doubles the cell. Tile rows run
//! *north* (row 0 has the smallest y); a picture with row 0 on top flips them.

/// Cells along a tile's side.
pub const TILE_CELLS: usize = 256;

const SUM_BITS: u32 = 36;
const SUM_MASK: u64 = (1 << SUM_BITS) - 1;

/// More looks at one cell than its counter can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "a map cell was seen more than a million times, which its counter cannot hold; use a larger \
     baseline_m between keyframes or split the map into several"
)]
pub struct TileOverflow;

/// Which tile of which zoom level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileKey {
    /// 0 is the finest; a cell of zoom z is `cell_m * 2^z` wide.
    pub zoom: u8,
    /// Column, growing east; may be negative.
    pub x: i64,
    /// Row, growing north; may be negative.
    pub y: i64,
}

impl TileKey {
    /// Width of a cell of this tile in metres, given that of zoom 0.
    pub fn cell_m(self, base_cell_m: f64) -> f64 {
        base_cell_m * 2f64.powi(i32::from(self.zoom))
    }

    /// `[min x, min y, max x, max y]` in metres of the map frame.
    pub fn footprint_m(self, base_cell_m: f64) -> [f64; 4] {
        let side_m = self.cell_m(base_cell_m) * TILE_CELLS as f64;
        let (x, y) = (self.x as f64 * side_m, self.y as f64 * side_m);
        [x, y, x + side_m, y + side_m]
    }
}

/// The sums of one tile: row by row, row 0 in the south.
#[derive(Clone, PartialEq, Eq)]
pub struct TileSum {
    cells: Vec<u64>,
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

    /// The packed cells, for storing; see the module's picture.
    pub fn cells(&self) -> &[u64] {
        &self.cells
    }

    /// From stored cells; `None` unless there are exactly `TILE_CELLS` squared.
    pub fn from_cells(cells: Vec<u64>) -> Option<Self> {
        (cells.len() == TILE_CELLS * TILE_CELLS).then_some(Self { cells })
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    /// Column, row, value and weight.
    type Look = (usize, usize, u8, u8);

    fn tile(looks: &[Look]) -> TileSum {
        let mut tile = TileSum::new();
        for &(column, row, value, weight) in looks {
            tile.add_row(column, row, &[value], &[weight]).unwrap();
        }
        tile
    }

    fn looks() -> impl Strategy<Value = Vec<Look>> {
        prop::collection::vec((252..256usize, 0..4usize, any::<u8>(), any::<u8>()), 0..40)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn merging_is_exact_and_in_any_order(a in looks(), b in looks()) {
            let all: Vec<Look> = b.iter().chain(&a).copied().collect();
            let mut merged = tile(&a);
            merged.merge(&tile(&b)).unwrap();
            prop_assert_eq!(&merged, &tile(&all));
            let finished = merged.finish();
            for column in 252..256 {
                for row in 0..4 {
                    let here = || all.iter().filter(|look| (look.0, look.1) == (column, row));
                    let sum: u64 = here().map(|l| u64::from(l.2) * u64::from(l.3)).sum();
                    let weight: u32 = here().map(|l| u32::from(l.3)).sum();
                    prop_assert_eq!(merged.get(column, row), (sum, weight));
                    if weight > 0 {
                        let mean = (sum as f64 / f64::from(weight) + 0.5).floor() as u8;
                        prop_assert_eq!(finished.grey[row * 256 + column], mean);
                    }
                }
            }
        }

        #[test]
        fn what_leaves_the_tile_is_ignored(start in 0..300usize, length in 0..300usize) {
            let values: Vec<u8> = (0..length).map(|i| i as u8).collect();
            let mut whole = TileSum::new();
            whole.add_row(start, 7, &values, &vec![3; length]).unwrap();
            let single: Vec<Look> = (0..length).map(|k| (start + k, 7, k as u8, 3)).collect();
            prop_assert_eq!(whole, tile(&single));
        }
    }

    #[test]
    fn a_million_full_looks_fit_and_then_it_says_so() {
        let mut tile = TileSum::new();
        tile.add_row(255, 255, &[255], &[255]).unwrap();
        for _ in 0..20 {
            let same = tile.clone();
            tile.merge(&same).unwrap();
        }
        assert_eq!(tile.get(255, 255), (65_025 << 20, 255 << 20));
        assert_eq!(tile.finish().grey[65_535], 255);
        let same = tile.clone();
        assert_eq!(tile.merge(&same), Err(TileOverflow));
    }

    #[test]
    fn a_tile_covers_what_its_key_says() {
        let south_west = TileKey {
            zoom: 1,
            x: -1,
            y: -1,
        };
        assert_eq!(south_west.footprint_m(0.05), [-25.6, -25.6, 0.0, 0.0]);
        assert_eq!(south_west.cell_m(0.05), 0.1);
    }
}
