//! The order in which pixels are worked on: tile by tile, so that neighbours are in one block of the lattices.

use std::ops::Range;

use super::ColourView;

/// Side of a tile: it is a block of the lattices, whose distributions stay in the first cache.
const TILE_PX: usize = 16;

/// An image in tiles: row of tiles by row of tiles, those at the end are as small as need be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tiles {
    width: usize,
    height: usize,
}

impl Tiles {
    pub(super) fn of(image: &ColourView<'_>) -> Self {
        Self {
            width: image.width(),
            height: image.height(),
        }
    }

    /// Number of pixels.
    pub(super) fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Visits the pixels, tile by tile and row by row in it: which of the image's pixels these are.
    pub(super) fn visit(&self, mut visit: impl FnMut(Range<usize>)) {
        for top in (0..self.height).step_by(TILE_PX) {
            for left in (0..self.width).step_by(TILE_PX) {
                let right = (left + TILE_PX).min(self.width);
                for row in top..(top + TILE_PX).min(self.height) {
                    visit(row * self.width + left..row * self.width + right);
                }
            }
        }
    }

    /// Values of the image, so many to a pixel, in the order of the tiles.
    pub(super) fn gathered(&self, values: &[f32], of_pixel: usize) -> Vec<f32> {
        let mut gathered = Vec::with_capacity(values.len());
        self.visit(|pixels| {
            gathered.extend_from_slice(&values[pixels.start * of_pixel..pixels.end * of_pixel]);
        });
        gathered
    }

    /// Brings values from the order of the tiles into that of the image, in place: a row of tiles is as long as its rows of
    /// pixels.
    pub(super) fn lay_out(&self, values: &mut [f32], of_pixel: usize) {
        let mut gathered = Vec::new();
        for rows in values.chunks_mut(TILE_PX * self.width * of_pixel) {
            gathered.clear();
            gathered.extend_from_slice(rows);
            let row_of_tiles = Self {
                height: rows.len() / (self.width * of_pixel),
                ..*self
            };
            let mut rest = &gathered[..];
            row_of_tiles.visit(|pixels| {
                let (these, others) = rest.split_at(pixels.len() * of_pixel);
                rows[pixels.start * of_pixel..pixels.end * of_pixel].copy_from_slice(these);
                rest = others;
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_gathered_tile_by_tile_and_laid_out_again() {
        for [width, height] in [[1, 1], [16, 16], [40, 35], [7, 50], [33, 3]] {
            let tiles = Tiles { width, height };
            let values: Vec<f32> = (0..3 * tiles.pixels()).map(|i| i as f32).collect();
            let mut gathered = tiles.gathered(&values, 3);
            if height > 1 && width > TILE_PX {
                let below = 3 * width as u16;
                assert_eq!(gathered[3 * TILE_PX], f32::from(below));
            }
            tiles.lay_out(&mut gathered, 3);
            assert_eq!(gathered, values, "{width} × {height}");
        }
    }
}
