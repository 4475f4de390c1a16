//! The gradients of an overhead image of any extent, by tiles, looked at in parts.

use std::collections::{BTreeMap, BTreeSet};

use super::overhead::{GradientCell, Gradients, NOT_SEEN, is_seen};
use crate::ground::tiles::TILE_CELLS;

/// Tiles along a part's side: with cells of 0.05 m a part is 102 m wide, and what is seen beyond its borders to describe
/// boxes on them is a third more.
const PART_TILES: i64 = 8;
/// No box has a longer side, in cells, and is still described whole: with cells of 0.05 m this is 50 m.
pub const LONGEST_CELLS: f64 = 1000.0;
/// Tiles beyond a part's border that boxes on it are described by: twice what a square box of [`LONGEST_CELLS`] reaches. What
/// is looked at at a time is at most 24 × 24 tiles (75 MB), whatever cells and boxes claim to measure.
pub(super) const MOST_BEYOND: i64 = 8;

/// Tiles of one zoom level.
#[derive(Debug, Clone, PartialEq)]
pub struct Mosaic {
    /// Side of a cell (m).
    cell_m: f64,
    /// The westernmost column and the southernmost row of tiles: parts are counted from there, so that a small image is one.
    first: [i64; 2],
    /// By column (east) and row (north), as in [`crate::ground::tiles::TileKey`]: cells, the northernmost row first.
    tiles: BTreeMap<[i64; 2], Vec<GradientCell>>,
}

/// A square of tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct TileBlock([i64; 2]);

impl Mosaic {
    /// Without tiles, of cells of this side (m).
    pub fn new(cell_m: f64) -> Self {
        Self {
            cell_m,
            first: [i64::MAX; 2],
            tiles: BTreeMap::new(),
        }
    }

    /// Side of a cell (m).
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Adds a tile as [`super::picture::Picture`] describes it; false, and nothing is added, where there are more or fewer
    /// cells than a tile has.
    pub fn add(&mut self, tile: [i64; 2], cells: Vec<GradientCell>) -> bool {
        let is_whole = cells.len() == TILE_CELLS * TILE_CELLS;
        if is_whole {
            self.count_from(tile);
            self.tiles.insert(tile, cells);
        }
        is_whole
    }

    /// Counts parts as if it had a tile, which need not be added: one that nothing is read of.
    pub fn count_from(&mut self, tile: [i64; 2]) {
        self.first = [0, 1].map(|axis| self.first[axis].min(tile[axis]));
    }

    /// The parts that have tiles, in order.
    pub fn parts(&self) -> BTreeSet<TileBlock> {
        self.tiles.keys().map(|tile| self.part_of(*tile)).collect()
    }

    fn part_of(&self, tile: [i64; 2]) -> TileBlock {
        let count = |axis: usize| tile[axis].saturating_sub(self.first[axis]);
        TileBlock([0, 1].map(|axis| count(axis).div_euclid(PART_TILES)))
    }

    /// The part that a point of the map is in.
    pub fn part(&self, point: [f64; 2]) -> TileBlock {
        self.part_of(point.map(|at| (at / self.tile_m()).floor() as i64))
    }

    /// The south-western and the north-eastern corner of a part (m).
    pub(super) fn corners(&self, part: TileBlock) -> [[f64; 2]; 2] {
        [0, PART_TILES].map(|beyond| {
            [0, 1].map(|axis| {
                let tiles = part.0[axis].saturating_mul(PART_TILES);
                let tile = self.first[axis].saturating_add(tiles);
                tile.saturating_add(beyond) as f64 * self.tile_m()
            })
        })
    }

    /// What was seen (m²).
    pub fn covered_m2(&self) -> f64 {
        let cells = self.tiles.values().flatten();
        cells.filter(|cell| is_seen(cell)).count() as f64 * self.cell_m * self.cell_m
    }

    /// Gradients of a part, and beyond its borders as far as boxes that reach this far (m) from a point in it need them, at
    /// most as those with sides of [`LONGEST_CELLS`] do.
    pub fn gradients(&self, part: TileBlock, reach_m: f64) -> Gradients {
        let [first, last] = self.span(part, reach_m);
        let columns = self.tiles.range([first[0], i64::MIN]..[last[0], i64::MIN]);
        let near = columns.filter(|([_, row], _)| (first[1]..last[1]).contains(row));
        self.joined(&near.collect::<Vec<_>>())
    }

    /// The first column and row of tiles that gradients of a part are of, and those behind the last ones.
    pub(super) fn span(&self, part: TileBlock, reach_m: f64) -> [[i64; 2]; 2] {
        let beyond = ((reach_m / self.tile_m()).ceil() as i64).clamp(0, MOST_BEYOND);
        let at = |axis: usize| {
            let along = part.0[axis].saturating_mul(PART_TILES);
            self.first[axis].saturating_add(along)
        };
        [
            [0, 1].map(|axis| at(axis).saturating_sub(beyond)),
            [0, 1].map(|axis| at(axis).saturating_add(PART_TILES + beyond)),
        ]
    }

    fn tile_m(&self) -> f64 {
        self.cell_m * TILE_CELLS as f64
    }

    /// The gradients of the smallest image that has these tiles, which are of one part and what is around it.
    fn joined(&self, tiles: &[(&[i64; 2], &Vec<GradientCell>)]) -> Gradients {
        let bound = |axis: usize| {
            let at = tiles.iter().map(|(tile, _)| tile[axis]);
            (at.clone().min().unwrap_or(0), at.max().unwrap_or(-1) + 1)
        };
        let ((west, east), (south, north)) = (bound(0), bound(1));
        let columns = (east - west) as usize * TILE_CELLS;
        let rows = (north - south) as usize * TILE_CELLS;
        let mut cells = vec![NOT_SEEN; columns * rows];
        for ([x, y], tile) in tiles {
            let corner =
                (north - 1 - y) as usize * TILE_CELLS * columns + (x - west) as usize * TILE_CELLS;
            for (row, line) in tile.chunks(TILE_CELLS).enumerate() {
                let from = corner + row * columns;
                cells[from..from + line.len()].copy_from_slice(line);
            }
        }
        let corner_m = [west, north].map(|at| at as f64 * self.tile_m());
        Gradients::new(self.cell_m, columns, corner_m, cells)
    }
}
