//! What a network sees, read at single pixels.

use nalgebra::{DMatrix, DMatrixView};

use crate::processor::vectorised;

/// What one stage of a network sees of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureMap {
    /// Numbers of a cell.
    pub channels: usize,
    /// Cells of a row, and rows.
    pub size: [usize; 2],
    /// Cells to a pixel, along rows and columns.
    pub cells_per_px: [f32; 2],
    /// Cell after cell, row by row, channels innermost.
    pub values: Vec<f32>,
}

/// Bytes to a unit of a network's numbers, which lie between -30 and 30 with a deviation of 3 to 8; 128 stands for 0.
const BYTES_PER_UNIT: f32 = 4.0;

impl FeatureMap {
    pub(super) fn is_whole(&self) -> bool {
        let [columns, rows] = self.size;
        columns > 0 && rows > 0 && self.values.len() == columns * rows * self.channels
    }

    /// Between the four cells around a pixel, as bytes.
    pub(super) fn write(&self, u: usize, v: usize, out: &mut [u8]) {
        let (left, right, along) = self.between(0, u);
        let (above, below, down) = self.between(1, v);
        let cell = |column: usize, row: usize| {
            &self.values[(row * self.size[0] + column) * self.channels..][..self.channels]
        };
        let corners = [
            (cell(left, above), (1.0 - along) * (1.0 - down)),
            (cell(right, above), along * (1.0 - down)),
            (cell(left, below), (1.0 - along) * down),
            (cell(right, below), along * down),
        ];
        for (channel, out) in out.iter_mut().enumerate() {
            let value: f32 = corners
                .iter()
                .map(|(cell, share)| cell[channel] * share)
                .sum();
            // The conversion saturates.
            *out = (128.5 + BYTES_PER_UNIT * value) as u8;
        }
    }

    /// Linear functions of the bytes of the cells, which are not rounded here: a row of weights each.
    pub(super) fn projected(&self, weights: &DMatrixView<'_, f32>) -> Self {
        let byte = |value: &f32| (128.0 + BYTES_PER_UNIT * value).clamp(0.0, 255.0);
        let bytes: Vec<f32> = self.values.iter().map(byte).collect();
        let cells = self.size[0] * self.size[1];
        let bytes = DMatrixView::from_slice(&bytes, self.channels, cells);
        let mut found = DMatrix::zeros(weights.nrows(), cells);
        found.gemm(1.0, weights, &bytes, 0.0);
        Self {
            channels: weights.nrows(),
            values: found.data.into(),
            ..*self
        }
    }

    /// Adds what lies between the four cells around some pixels of a row to the numbers of each.
    pub(super) fn add(&self, us: &[usize], v: usize, sums: &mut [f32]) {
        let (above, below, down) = self.between(1, v);
        let length = self.size[0] * self.channels;
        let [above, below] = [above, below].map(|row| &self.values[row * length..][..length]);
        let mut line = vec![0.0; length];
        vectorised(
            #[inline(always)]
            || {
                for (value, (above, below)) in line.iter_mut().zip(above.iter().zip(below)) {
                    *value = above + down * (below - above);
                }
                for (u, sums) in us.iter().zip(sums.chunks_exact_mut(self.channels)) {
                    let (left, right, along) = self.between(0, *u);
                    let [left, right] =
                        [left, right].map(|cell| &line[cell * self.channels..][..self.channels]);
                    for (sum, (left, right)) in sums.iter_mut().zip(left.iter().zip(right)) {
                        *sum += left + along * (right - left);
                    }
                }
            },
        );
    }

    /// The cells on both sides of a pixel along an axis, and how far it is from the first to the second.
    #[inline(always)]
    fn between(&self, axis: usize, at: usize) -> (usize, usize, f32) {
        let last = self.size[axis] - 1;
        let place = (at as f32 + 0.5) * self.cells_per_px[axis] - 0.5;
        let place = place.clamp(0.0, last as f32);
        let first = place as usize;
        (first, (first + 1).min(last), place - first as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_lie_between_those_of_the_cells_around() {
        let map = FeatureMap {
            channels: 2,
            size: [2, 1],
            cells_per_px: [0.5, 0.5],
            values: vec![0.0, -50.0, 8.0, 50.0],
        };
        assert!(map.is_whole());
        let at = |u, v| {
            let mut out = [7; 2];
            map.write(u, v, &mut out);
            out
        };
        // Pixels 0 and 1 lie a quarter of a cell before and behind the first cell's middle.
        assert_eq!([at(0, 0), at(1, 1)], [[128, 0], [136, 28]]);
        assert_eq!([at(2, 0), at(3, 9)], [[152, 228], [160, 255]]);
    }
}
