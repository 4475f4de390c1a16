//! Patches cut at the borders of tiles.

use std::ops::Range;

use super::{TILE_CELLS, TileOverflow, TileSum};
use crate::ground::patch::Patch;

/// The part of a patch that lies on one tile.
#[derive(Debug, Clone)]
pub struct Piece<'a> {
    /// The tile's column, growing east.
    pub x: i64,
    /// The tile's row, growing north.
    pub y: i64,
    patch: &'a Patch,
    columns: Range<usize>,
    rows: Range<usize>,
}

impl Patch {
    /// The patch by tiles, those left out where nothing was seen.
    pub fn pieces(&self) -> Vec<Piece<'_>> {
        let columns = cut(self.column, self.width);
        let rows = cut(self.row, self.height);
        let pairs = rows
            .iter()
            .flat_map(|row| columns.iter().map(move |column| (row, column)));
        let pieces = pairs.map(|((y, rows), (x, columns))| Piece {
            x: *x,
            y: *y,
            patch: self,
            columns: columns.clone(),
            rows: rows.clone(),
        });
        pieces.filter(Piece::is_seen).collect()
    }
}

impl Piece<'_> {
    fn is_seen(&self) -> bool {
        let weights = &self.patch.weights;
        let seen = |row: usize| weights[self.cells(row)].iter().any(|weight| *weight > 0);
        self.rows.clone().any(seen)
    }

    /// Where the cells of a row are among the patch's.
    fn cells(&self, row: usize) -> Range<usize> {
        let start = row * self.patch.width;
        start + self.columns.start..start + self.columns.end
    }

    /// Adds what is seen to the sums of the tile.
    ///
    /// # Errors
    /// [`TileOverflow`] when a cell is full; the tile is then useless.
    pub fn add_to(&self, sums: &mut TileSum) -> Result<(), TileOverflow> {
        let Patch {
            values, weights, ..
        } = self.patch;
        let count = self.patch.channels().count();
        let within = |first: i64, at: usize| (first + at as i64).rem_euclid(SIDE) as usize;
        let column = within(self.patch.column, self.columns.start);
        for row in self.rows.clone() {
            let (cells, to) = (self.cells(row), within(self.patch.row, row));
            let shown = count * cells.start..count * cells.end;
            sums.add_row(column, to, &values[shown], &weights[cells])?;
        }
        Ok(())
    }
}

const SIDE: i64 = TILE_CELLS as i64;

/// Cuts `length` cells from `first` on at the borders of tiles: the tile, and which of the cells are on it.
pub(super) fn cut(first: i64, length: usize) -> Vec<(i64, Range<usize>)> {
    let end = first + length as i64;
    (first.div_euclid(SIDE)..end.div_euclid(SIDE) + 1)
        .map(|tile| {
            let (from, to) = ((tile * SIDE).max(first), ((tile + 1) * SIDE).min(end));
            (tile, (from - first) as usize..(to - first) as usize)
        })
        .filter(|(_, cells)| !cells.is_empty())
        .collect()
}
