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
//! A tile that images in colour show has three of these for each cell, of red, green and blue; it is grey until the first of
//! them comes. A grey look is one of three equal values, so sums are the same whichever comes first.
//!
//! Merging two tiles is 65 536 integer additions, or three times as many: associative, commutative, and half the memory
//! of separate fields. One look adds at most 255 to the weight and 255 × 255 to the sum, so a
//! cell holds 2²⁰ looks of full weight (1 052 688, to be exact). As no value exceeds 255 the
//! lower field is always below 255 times the upper one and cannot overflow first; one more look
//! than the upper field can hold overflows the whole integer, which is detected
//! ([`TileOverflow`]) in any order of merging alike.
//!
//! Cells are numbered globally: cell (i, j) covers `[i, i+1) × [j, j+1)` times `cell_m` metres of
//! the map frame, x east and y north, at zoom 0; every zoom doubles the cell. Tile rows run
//! *north* (row 0 has the smallest y); a picture with row 0 on top flips them.

mod pieces;
mod runs;
mod sum;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use pieces::Piece;
pub use sum::{FinishedTile, TileSum};

/// Cells along a tile's side.
pub const TILE_CELLS: usize = 256;

/// More looks at one cell than its counter can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "a map cell was seen more than a million times, which its counter cannot hold; use a larger \
     baseline_m between keyframes or split the map into several"
)]
pub struct TileOverflow;

/// Which tile of which zoom level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
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
