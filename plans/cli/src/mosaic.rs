//! Overhead tiles put together to one picture.

use std::collections::BTreeSet;

use evermap_schemas::Fault;

use crate::draw::{decoded, encoded};
use crate::earth::SiteOnEarth;
use crate::raster::Raster;
use crate::shown::Tile;

/// Cells of the largest picture that is put together: a quarter of a gigabyte of grey and alpha.
const MOST_CELLS: u64 = 1 << 27;

/// A grey picture of the ground, north up.
#[derive(Debug, Clone, PartialEq)]
pub struct Mosaic {
    /// Side of a cell, m.
    pub cell_m: f64,
    /// Western edge, m in the map.
    pub west: f64,
    /// Northern edge, m in the map.
    pub north: f64,
    /// Cells from west to east.
    pub width: usize,
    /// Cells from north to south.
    pub height: usize,
    /// Grey and alpha of each cell, row by row from the north.
    pub cells: Vec<[u8; 2]>,
}

/// The tiles of one zoom level, as a rectangle of tiles.
fn extent(tiles: &[&Tile]) -> Option<Raster> {
    Raster::around(tiles.iter().map(|tile| [tile.tile_x, tile.tile_y]))
}

/// Cells of a rectangle of tiles that have so many along their side.
fn cells(extent: &Raster, side: u64) -> u64 {
    (extent.cells() as u64).saturating_mul(side * side)
}

/// Cells along the side of a tile.
fn side(tile: &Tile) -> u64 {
    (tile.size_m / tile.cell_m).round().clamp(0.0, 65_536.0) as u64
}

/// The zoom level to show at this resolution: the coarsest that is at least as fine, or the finest there is; never one
/// whose picture would be too large. `None` where there are no tiles, or none that can be shown.
pub fn zoom_for(tiles: &[Tile], m_per_px: f64) -> Option<u32> {
    let fits = |zoom: u32| {
        let level = level(tiles, zoom);
        let cells = cells(&extent(&level)?, side(level.first()?));
        (cells <= MOST_CELLS).then_some(level.first()?.cell_m)
    };
    let shown: Vec<(u32, f64)> = zooms(tiles)
        .into_iter()
        .filter_map(|zoom| Some((zoom, fits(zoom)?)))
        .collect();
    let fine_enough = shown.iter().rfind(|(_, cell_m)| *cell_m <= m_per_px * 1.01);
    fine_enough.or(shown.first()).map(|(zoom, _)| *zoom)
}

/// The zoom levels of tiles, ascending.
fn zooms(tiles: &[Tile]) -> BTreeSet<u32> {
    tiles.iter().map(|tile| tile.zoom).collect()
}

/// The tiles of one zoom level.
pub fn level(tiles: &[Tile], zoom: u32) -> Vec<&Tile> {
    tiles.iter().filter(|tile| tile.zoom == zoom).collect()
}

/// The tiles of a zoom level that was asked for.
///
/// # Errors
/// A user fault where there are none, with the levels that there are.
pub fn at(tiles: &[Tile], zoom: u32) -> Result<Vec<&Tile>, Fault> {
    let found = level(tiles, zoom);
    if found.is_empty() {
        let levels: Vec<_> = zooms(tiles).iter().map(ToString::to_string).collect();
        return Err(Fault::user(format!(
            "expected one of the zoom levels {}, found {zoom}",
            levels.join(", ")
        )));
    }
    Ok(found)
}

impl Mosaic {
    /// Puts tiles of one zoom level and one site together.
    ///
    /// # Errors
    /// A user fault for no tiles or too many, a data fault for a tile that is no grey PNG with alpha of its size.
    pub fn of(tiles: &[&Tile]) -> Result<Self, Fault> {
        let (Some(first), Some(extent)) = (tiles.first(), extent(tiles)) else {
            return Err(Fault::user("there are no tiles at this zoom level"));
        };
        let side = side(first);
        let [columns, rows] = extent.size.map(|tiles| tiles as u64 * side);
        if cells(&extent, side) > MOST_CELLS || side == 0 {
            return Err(Fault::user(format!(
                "a picture of {columns} by {rows} cells is too large"
            ))
            .next("choose a coarser level with --zoom"));
        }
        let (width, height) = (columns as usize, rows as usize);
        let [first_x, first_y] = extent.first;
        let above = first_y + extent.size[1];
        let mut mosaic = Self {
            cell_m: first.cell_m,
            west: first_x as f64 * first.size_m,
            north: above as f64 * first.size_m,
            width,
            height,
            cells: vec![[0, 0]; width * height],
        };
        for tile in tiles {
            let cells = decode(tile, side as usize).map_err(|fault| fault.at(place(tile)))?;
            let column = (i64::from(tile.tile_x) - first_x) as usize * side as usize;
            let row = (above - 1 - i64::from(tile.tile_y)) as usize * side as usize;
            mosaic.paste(&cells, side as usize, column, row);
        }
        Ok(mosaic)
    }

    fn paste(&mut self, cells: &[[u8; 2]], side: usize, column: usize, row: usize) {
        for (line, source) in cells.chunks_exact(side).enumerate() {
            let at = (row + line) * self.width + column;
            self.cells[at..at + side].copy_from_slice(source);
        }
    }

    /// Spreads the grey values of seen cells over the visible range; 1 % at either end may saturate.
    pub fn stretch(&mut self) {
        let mut histogram = [0_u64; 256];
        for [grey, _] in self.cells.iter().filter(|cell| cell[1] > 0) {
            histogram[usize::from(*grey)] += 1;
        }
        let seen: u64 = histogram.iter().sum();
        if seen == 0 {
            return;
        }
        let (low, high) = (
            quantile(&histogram, seen / 100),
            quantile(&histogram, seen - 1 - seen / 100),
        );
        let span = f64::from(high.saturating_sub(low)).max(16.0);
        let table: Vec<u8> = (0..=255_u8)
            .map(|grey| {
                let share = ((f64::from(grey) - f64::from(low)) / span).clamp(0.0, 1.0);
                (30.0 + 205.0 * share.powf(0.8)).round() as u8
            })
            .collect();
        for cell in self.cells.iter_mut().filter(|cell| cell[1] > 0) {
            cell[0] = table[usize::from(cell[0])];
        }
    }

    /// `[west, south, east, north]` of the cells that were seen, m; `None` where none was.
    pub fn seen(&self) -> Option<[f64; 4]> {
        let mut found: Option<[usize; 4]> = None;
        for (row, line) in self.cells.chunks_exact(self.width).enumerate() {
            let Some(first) = line.iter().position(|cell| cell[1] > 0) else {
                continue;
            };
            let last = line.iter().rposition(|cell| cell[1] > 0).unwrap_or(first);
            let [left, top, right, _] = found.unwrap_or([first, row, last, row]);
            found = Some([left.min(first), top, right.max(last), row]);
        }
        found.map(|[left, top, right, bottom]| {
            let (x, y) = (
                |column| self.west + column as f64 * self.cell_m,
                |row| self.north - row as f64 * self.cell_m,
            );
            [x(left), y(bottom + 1), x(right + 1), y(top)]
        })
    }

    /// Grey PNG with alpha.
    ///
    /// # Errors
    /// A resource fault for a picture too large for the format.
    pub fn png(&self) -> Result<Vec<u8>, Fault> {
        let (width, height) = (self.width as u32, self.height as u32);
        let grey = png::ColorType::GrayscaleAlpha;
        encoded(width, height, grey, self.cells.as_flattened())
    }

    /// The world file beside the PNG: what a step to the right and one down are along x and y, and the centre of the
    /// first cell; of a site whose place on earth is known, along east and north.
    pub fn world_file(&self, place: Option<&SiteOnEarth>) -> String {
        let turned = |x, y| place.map_or([x, y], |place| place.turned(x, y));
        let half = self.cell_m / 2.0;
        let right = turned(self.cell_m, 0.0);
        let down = turned(0.0, -self.cell_m);
        let first = turned(self.west + half, self.north - half);
        let lines = [right, down, first].concat();
        // Adding zero writes minus zero as zero.
        let lines = lines.iter().map(|number| format!("{}\n", number + 0.0));
        lines.collect()
    }
}

fn quantile(histogram: &[u64; 256], rank: u64) -> u8 {
    let mut below = 0;
    for (value, count) in (0..=255_u8).zip(histogram) {
        below += count;
        if below > rank {
            return value;
        }
    }
    255
}

fn place(tile: &Tile) -> String {
    format!("tile {}/{}/{}", tile.zoom, tile.tile_x, tile.tile_y)
}

/// A tile's cells.
fn decode(tile: &Tile, side: usize) -> Result<Vec<[u8; 2]>, Fault> {
    let (width, height, bytes) = decoded(&tile.png.0, png::ColorType::GrayscaleAlpha)?;
    if (width as usize, height as usize) != (side, side) {
        return Err(Fault::data(format!(
            "expected a picture of {side} by {side} cells, found {width} by {height}"
        )));
    }
    Ok(bytes.as_chunks::<2>().0.to_vec())
}

#[cfg(test)]
pub(crate) mod tests;
