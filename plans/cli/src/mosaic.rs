//! Overhead tiles put together to one picture.

use std::collections::BTreeSet;

use evermap_algorithms::ground::channels::Pixels;
use evermap_schemas::Fault;
use png::ColorType;

use crate::draw::{decoded, encoded, is_in_colour};
use crate::earth::SiteOnEarth;
use crate::raster::Raster;
use crate::shown::Tile;

/// Bytes of the largest picture that is put together: 2²⁷ cells of grey and alpha, or half as many in colour.
const MOST_BYTES: u64 = 1 << 28;

/// A picture of the ground, north up.
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
    /// Its cells, row by row from the north.
    pub cells: Pixels,
}

/// The tiles of one zoom level, as a rectangle of tiles.
fn extent(tiles: &[&Tile]) -> Option<Raster> {
    Raster::around(tiles.iter().map(|tile| [tile.tile_x, tile.tile_y]))
}

/// Bytes of a rectangle of tiles that have so many cells along their side.
fn bytes(tiles: &[&Tile], extent: &Raster, side: u64) -> u64 {
    let in_colour = tiles.iter().any(|tile| is_in_colour(&tile.png.0));
    let of_cell = if in_colour { 4 } else { 2 };
    (extent.cells() as u64).saturating_mul(side * side * of_cell)
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
        let bytes = bytes(&level, &extent(&level)?, side(level.first()?));
        (bytes <= MOST_BYTES).then_some(level.first()?.cell_m)
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
    /// Puts tiles of one zoom level and one site together: in colour where one of them is.
    ///
    /// # Errors
    /// A user fault for no tiles or too many, a data fault for a tile that is no PNG of its size, grey or in colour with alpha.
    pub fn of(tiles: &[&Tile]) -> Result<Self, Fault> {
        let (Some(first), Some(extent)) = (tiles.first(), extent(tiles)) else {
            return Err(Fault::user("there are no tiles at this zoom level"));
        };
        let side = side(first);
        let [columns, rows] = extent.size.map(|tiles| tiles as u64 * side);
        if bytes(tiles, &extent, side) > MOST_BYTES || side == 0 {
            return Err(Fault::user(format!(
                "a picture of {columns} by {rows} cells is too large"
            ))
            .next("choose a coarser level with --zoom"));
        }
        let (width, height) = (columns as usize, rows as usize);
        let [first_x, first_y] = extent.first;
        let above = first_y + extent.size[1];
        let side = side as usize;
        let cells = if tiles.iter().any(|tile| is_in_colour(&tile.png.0)) {
            Pixels::Colour(joined(tiles, &extent, side, colours)?)
        } else {
            Pixels::Grey(joined(tiles, &extent, side, greys)?)
        };
        Ok(Self {
            cell_m: first.cell_m,
            west: first_x as f64 * first.size_m,
            north: above as f64 * first.size_m,
            width,
            height,
            cells,
        })
    }

    /// Red, green, blue and alpha of a cell, counted row by row from the north.
    pub fn colour(&self, cell: usize) -> [u8; 4] {
        match &self.cells {
            Pixels::Grey(cells) => widened(cells[cell]),
            Pixels::Colour(cells) => cells[cell],
        }
    }

    /// Spreads the brightness of seen cells over the visible range; 1 % at either end may saturate. Colours are spread as grey
    /// of their values is.
    pub fn stretch(&mut self) {
        let mut histogram = [0_u64; 256];
        for cell in 0..self.cells.count() {
            let [red, green, blue, alpha] = self.colour(cell);
            if alpha > 0 {
                histogram[usize::from(brightness([red, green, blue]))] += 1;
            }
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
        let spread = |values: &mut [u8]| {
            for value in values {
                *value = table[usize::from(*value)];
            }
        };
        match &mut self.cells {
            Pixels::Grey(cells) => {
                let seen = cells.iter_mut().filter(|cell| cell[1] > 0);
                seen.for_each(|cell| spread(&mut cell[..1]));
            }
            Pixels::Colour(cells) => {
                let seen = cells.iter_mut().filter(|cell| cell[3] > 0);
                seen.for_each(|cell| spread(&mut cell[..3]));
            }
        }
    }

    /// `[west, south, east, north]` of the cells that were seen, m; `None` where none was.
    pub fn seen(&self) -> Option<[f64; 4]> {
        let mut found: Option<[usize; 4]> = None;
        for row in 0..self.height {
            let is_seen = |column: &usize| self.colour(row * self.width + column)[3] > 0;
            let Some(first) = (0..self.width).find(is_seen) else {
                continue;
            };
            let last = (first..self.width).rfind(is_seen).unwrap_or(first);
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

    /// PNG with alpha, grey or in colour.
    ///
    /// # Errors
    /// A resource fault for a picture too large for the format.
    pub fn png(&self) -> Result<Vec<u8>, Fault> {
        let (width, height) = (self.width as u32, self.height as u32);
        let (channels, values) = match &self.cells {
            Pixels::Grey(cells) => (ColorType::GrayscaleAlpha, cells.as_flattened()),
            Pixels::Colour(cells) => (ColorType::Rgba, cells.as_flattened()),
        };
        encoded(width, height, channels, values)
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

/// Cells of a rectangle of tiles, row by row from the north; those of no tile have alpha 0.
fn joined<P: Copy + Default>(
    tiles: &[&Tile],
    extent: &Raster,
    side: usize,
    read: impl Fn(&Tile, usize) -> Result<Vec<P>, Fault>,
) -> Result<Vec<P>, Fault> {
    let [width, height] = extent.size.map(|tiles| tiles as usize * side);
    let mut cells = vec![P::default(); width * height];
    for &tile in tiles {
        let of_tile = read(tile, side).map_err(|fault| fault.at(place(tile)))?;
        let column = (i64::from(tile.tile_x) - extent.first[0]) as usize * side;
        let above = extent.first[1] + extent.size[1];
        let row = (above - 1 - i64::from(tile.tile_y)) as usize * side;
        for (line, source) in of_tile.chunks_exact(side).enumerate() {
            let at = (row + line) * width + column;
            cells[at..at + side].copy_from_slice(source);
        }
    }
    Ok(cells)
}

/// Grey and alpha of a grey tile's cells.
fn greys(tile: &Tile, side: usize) -> Result<Vec<[u8; 2]>, Fault> {
    let values = values(tile, side, ColorType::GrayscaleAlpha)?;
    Ok(values.as_chunks().0.to_vec())
}

/// Red, green, blue and alpha of the cells of any tile.
fn colours(tile: &Tile, side: usize) -> Result<Vec<[u8; 4]>, Fault> {
    if is_in_colour(&tile.png.0) {
        let values = values(tile, side, ColorType::Rgba)?;
        return Ok(values.as_chunks().0.to_vec());
    }
    Ok(greys(tile, side)?.into_iter().map(widened).collect())
}

fn widened([grey, alpha]: [u8; 2]) -> [u8; 4] {
    [grey, grey, grey, alpha]
}

/// Rec. 601's luma, which is the grey value itself of what is grey.
fn brightness([red, green, blue]: [u8; 3]) -> u8 {
    let sum = 299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue);
    ((sum + 500) / 1000) as u8
}

/// The values of a tile's cells in these channels.
fn values(tile: &Tile, side: usize, channels: ColorType) -> Result<Vec<u8>, Fault> {
    let (width, height, values) = decoded(&tile.png.0, channels)?;
    if (width as usize, height as usize) != (side, side) {
        return Err(Fault::data(format!(
            "expected a picture of {side} by {side} cells, found {width} by {height}"
        )));
    }
    Ok(values)
}

#[cfg(test)]
pub(crate) mod tests;
