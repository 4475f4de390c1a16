//! The inner loop: one image, one pose, rows of map cells.

use super::{GrayView, GroundLut};
use crate::pose::Pose;

/// Fraction bits of a position in the table's grid. A row of 10⁶ cells drifts by less than 10⁻³
/// of a node.
const GRID_BITS: u32 = 32;
const GRID_ONE: f64 = (1u64 << GRID_BITS) as f64;

/// Fraction bits of a pixel position.
const PIXEL_BITS: u32 = 8;
const PIXEL_ONE: i32 = 1 << PIXEL_BITS;

/// A vehicle seen edge-on from above has no ground under it; this is 84° of tilt.
const MIN_UPRIGHT: f64 = 0.1;

/// One run of map cells in the direction of growing x, as it was seen in one image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GroundRow<'a> {
    /// Global column of the first cell: it covers `[i, i + 1) * cell_m`.
    pub i: i64,
    /// Global row.
    pub j: i64,
    /// Grey values; 0 where the weight is 0.
    pub values: &'a [u8],
    /// Weights; 0 where the image does not show the cell.
    pub weights: &'a [u8],
}

impl GroundLut {
    /// Projects `image` to the cells of the map's ground: calls `visit` with each row that has
    /// something to show, south to north. Does nothing when the image has another size than the
    /// camera, the pose is not finite or the vehicle lies on its side.
    ///
    /// The value of a cell is the image bilinearly interpolated at the cell's *centre*, in fixed
    /// point: the same bytes on every machine.
    pub fn splat(
        &self,
        image: &GrayView<'_>,
        map_from_vehicle: &Pose,
        cell_m: f64,
        mut visit: impl FnMut(GroundRow<'_>),
    ) {
        if (image.width(), image.height()) != (self.width, self.height) {
            return;
        }
        let Some(grid) = GridFromMap::new(self, map_from_vehicle, cell_m) else {
            return;
        };
        let (mut values, mut weights) = (Vec::new(), Vec::new());
        for j in grid.rows(self) {
            let Some((i, length)) = grid.columns(self, j) else {
                continue;
            };
            values.clear();
            weights.clear();
            values.resize(length, 0);
            weights.resize(length, 0);
            self.sample_row(
                image,
                grid.start(i, j),
                grid.step,
                &mut values,
                &mut weights,
            );
            let seen = |weight: &u8| *weight != 0;
            let Some(from) = weights.iter().position(seen) else {
                continue;
            };
            let to = weights.iter().rposition(seen).map_or(from, |last| last + 1);
            visit(GroundRow {
                i: i + from as i64,
                j,
                values: &values[from..to],
                weights: &weights[from..to],
            });
        }
    }

    /// Fills one row. `at` and `step` are positions in the table's grid, fixed point.
    fn sample_row(
        &self,
        image: &GrayView<'_>,
        mut at: [i64; 2],
        step: [i64; 2],
        values: &mut [u8],
        weights: &mut [u8],
    ) {
        for (value, weight) in values.iter_mut().zip(weights) {
            let (column, row) = ((at[0] >> GRID_BITS) as usize, (at[1] >> GRID_BITS) as usize);
            let node = self.between(
                row * self.columns + column,
                fraction(at[0]),
                fraction(at[1]),
            );
            at = [at[0].wrapping_add(step[0]), at[1].wrapping_add(step[1])];
            let Some([u, v, looked, _]) = node else {
                continue;
            };
            // NaN, where a node is not seen, is not greater than anything.
            if looked > 0.5
                && let Some(grey) = bilinear(image, u, v)
            {
                *value = grey;
                *weight = (looked + 0.5) as u8;
            }
        }
    }
}

/// The fraction of a grid position, from its upper 24 bits: exact in f32.
#[inline(always)]
fn fraction(at: i64) -> f32 {
    ((at as u32) >> 8) as f32 * (1.0 / (1u32 << 24) as f32)
}

/// The image at `(u, v)`, which lie inside the outermost pixel centres.
#[inline(always)]
fn bilinear(image: &GrayView<'_>, u: f32, v: f32) -> Option<u8> {
    let width = image.width as usize;
    let (u, v) = (
        (u * PIXEL_ONE as f32 + 0.5) as i32,
        (v * PIXEL_ONE as f32 + 0.5) as i32,
    );
    let left = (u >> PIXEL_BITS).min(image.width as i32 - 2);
    let top = (v >> PIXEL_BITS).min(image.height as i32 - 2);
    let (fu, fv) = ((u - left * PIXEL_ONE) as u32, (v - top * PIXEL_ONE) as u32);
    let at = top as usize * width + left as usize;
    let &[nw, ne] = image.pixels.get(at..at + 2)? else {
        return None;
    };
    let &[sw, se] = image.pixels.get(at + width..at + width + 2)? else {
        return None;
    };
    let north = u32::from(nw) * (256 - fu) + u32::from(ne) * fu;
    let south = u32::from(sw) * (256 - fu) + u32::from(se) * fu;
    Some(((north * (256 - fv) + south * fv + (1 << 15)) >> 16) as u8)
}

/// The affine map from cell numbers to positions in the table's grid.
struct GridFromMap {
    /// Grid position of the centre of cell (0, 0).
    origin: [f64; 2],
    /// Change per column and per row of the map.
    along: [[f64; 2]; 2],
    /// `along[0]` in fixed point.
    step: [i64; 2],
    /// Map cells (not centres) from grid positions, for the bounding box.
    map_from_grid: [[f64; 3]; 2],
}

impl GridFromMap {
    fn new(lut: &GroundLut, map_from_vehicle: &Pose, cell_m: f64) -> Option<Self> {
        let rotation = map_from_vehicle.rotation.to_rotation_matrix();
        let r = rotation.matrix();
        let t = map_from_vehicle.translation;
        // Horizontal part of the map from the vehicle's plane, and its inverse.
        let determinant = r[(0, 0)] * r[(1, 1)] - r[(0, 1)] * r[(1, 0)];
        let sound = cell_m > 0.0 && determinant > MIN_UPRIGHT && t.norm() / cell_m < 1e12;
        if !sound || lut.columns < 2 || lut.rows < 2 {
            return None;
        }
        let scale = cell_m / (lut.node_m * determinant);
        let along = [
            [r[(1, 1)] * scale, -r[(1, 0)] * scale],
            [-r[(0, 1)] * scale, r[(0, 0)] * scale],
        ];
        let centre = [0.5 - t.x / cell_m, 0.5 - t.y / cell_m];
        let origin =
            [0, 1].map(|k| along[0][k] * centre[0] + along[1][k] * centre[1] - lut.first[k] as f64);
        let node = lut.node_m / cell_m;
        let map_from_grid = [0, 1].map(|k| {
            let (x, y) = (r[(k, 0)] * node, r[(k, 1)] * node);
            let first = x * lut.first[0] as f64 + y * lut.first[1] as f64;
            [x, y, first + t[k] / cell_m]
        });
        let step = along[0].map(|change| (change * GRID_ONE).round() as i64);
        Some(Self {
            origin,
            along,
            step,
            map_from_grid,
        })
    }

    /// Rows of the map that the table may touch.
    fn rows(&self, lut: &GroundLut) -> std::ops::Range<i64> {
        let [x, y, offset] = self.map_from_grid[1];
        let (columns, rows) = ((lut.columns - 1) as f64, (lut.rows - 1) as f64);
        let corners = [0.0, x * columns, y * rows, x * columns + y * rows];
        let low = corners.into_iter().fold(f64::INFINITY, f64::min) + offset;
        let high = corners.into_iter().fold(f64::NEG_INFINITY, f64::max) + offset;
        low.floor() as i64..high.ceil() as i64 + 1
    }

    /// First column and number of cells of row `j` whose centres lie inside the table.
    fn columns(&self, lut: &GroundLut, j: i64) -> Option<(i64, usize)> {
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        for (k, size) in [lut.columns, lut.rows].into_iter().enumerate() {
            let start = self.origin[k] + self.along[1][k] * j as f64;
            let slope = self.along[0][k];
            // A margin of 10⁻³ node keeps fixed-point steps inside.
            let (near, far) = (1e-3 - start, (size - 1) as f64 - 1e-3 - start);
            if slope.abs() < 1e-12 {
                if near > 0.0 || far < 0.0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (near / slope, far / slope);
            low = low.max(a.min(b));
            high = high.min(a.max(b));
        }
        let (low, high) = (low.ceil(), high.floor());
        let length = high - low + 1.0;
        (1.0..1e7)
            .contains(&length)
            .then_some((low as i64, length as usize))
    }

    /// Grid position of the centre of cell `(i, j)`, fixed point.
    fn start(&self, i: i64, j: i64) -> [i64; 2] {
        [0, 1].map(|k| {
            let at = self.origin[k] + self.along[0][k] * i as f64 + self.along[1][k] * j as f64;
            (at * GRID_ONE).round() as i64
        })
    }
}
