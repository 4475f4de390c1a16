//! The inner loop: one image, one pose, rows of map cells.

use nalgebra::Vector3;

use super::lut::above;
use super::{GroundLut, ImageView};
use crate::geometry::pose::Pose;
use crate::ground::channels::Channels;
use crate::ground::floor::{Floor, FloorPart};

/// Fraction bits of a position in the table's grid. A row of 10⁶ cells drifts by less than 10⁻³
/// of a node.
const GRID_BITS: u32 = 32;
const GRID_ONE: f64 = (1u64 << GRID_BITS) as f64;

/// Fraction bits of a pixel position; the upper 8 of them weigh the neighbours.
const PIXEL_BITS: u32 = 16;
const PIXEL_ONE: f32 = (1u32 << PIXEL_BITS) as f32;

/// Most cells between two looks into the table, as a power of two.
const MOST_SPAN_BITS: u32 = 2;

/// How far a chord may put the ground off, in cells.
const CHORD_ERROR: f64 = 0.1;

/// A vehicle seen edge-on from above has no ground under it; this is 84° of tilt.
const MIN_UPRIGHT: f64 = 0.1;

/// One run of map cells in the direction of growing x, as it was seen in one image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GroundRow<'a> {
    /// Global column of the first cell: it covers `[i, i + 1) * cell_m`.
    pub i: i64,
    /// Global row.
    pub j: i64,
    /// Grey values, or red, green and blue of each cell; 0 where the weight is 0.
    pub values: &'a [u8],
    /// Weights, one for each cell; 0 where the image does not show it.
    pub weights: &'a [u8],
}

impl GroundLut {
    /// Projects `image` to the cells of the map's ground: calls `visit` with each row that has
    /// something to show, south to north. Does nothing when the image has another size than the
    /// camera, the pose is not finite or the vehicle lies on its side.
    ///
    /// The value of a cell is the image bilinearly interpolated at the cell's *centre*, in fixed
    /// point: the same bytes on every machine. Without a `floor`, or where it has no height, the ground is the vehicle's
    /// own plane.
    pub fn splat<'a>(
        &self,
        image: impl Into<ImageView<'a>>,
        map_from_vehicle: &Pose,
        floor: Option<&Floor>,
        cell_m: f64,
        mut visit: impl FnMut(GroundRow<'_>),
    ) {
        let image = image.into();
        if (image.width, image.height) != (self.width, self.height) {
            return;
        }
        let map_from_plane = map_from_vehicle.compose(&above(self.plane_m));
        let Some(grid) = GridFromMap::new(self, &map_from_plane, cell_m) else {
            return;
        };
        let bend = floor.and_then(|floor| Bend::new(self, &map_from_plane, floor, &grid, cell_m));
        let span_bits = self.span_bits(cell_m);
        let fill = match image.channels {
            Channels::Grey => filling::<1>(span_bits),
            Channels::Colour => filling::<3>(span_bits),
        };
        let count = image.channels.count();
        let (mut values, mut weights) = (Vec::new(), Vec::new());
        for j in grid.rows(self) {
            let Some((i, length)) = grid.columns(self, j) else {
                continue;
            };
            values.clear();
            weights.clear();
            values.resize(count * length, 0);
            weights.resize(length, 0);
            fill(
                self,
                &image,
                &Row {
                    at: grid.start(i, j),
                    step: grid.step,
                    first: [i, j],
                    bend: bend.as_ref(),
                },
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
                values: &values[count * from..count * to],
                weights: &weights[from..to],
            });
        }
    }

    /// Cells per span, as a power of two. Along a line on the ground at distance x from the foot
    /// of an equidistant camera at height h the pixel is f atan(x / h), whose second derivative is
    /// at most 0.65 f / h² (at x = 0.58 h), while a metre fills f / h pixels at most. A chord over
    /// n cells of c metres is therefore off by no more than 0.65 (n c)² / 8 h metres at the foot.
    fn span_bits(&self, cell_m: f64) -> u32 {
        let off = |bits: u32| 0.65 * 4f64.powi(bits as i32) * cell_m / (8.0 * self.height_m);
        (0..=MOST_SPAN_BITS)
            .rev()
            .find(|&bits| off(bits) <= CHORD_ERROR)
            .unwrap_or(0)
    }

    /// Fills one row. The table is read at the ends of spans, and the pixel moves in equal steps between.
    fn sample_row<const SPAN_BITS: u32, const COUNT: usize>(
        &self,
        image: &ImageView<'_>,
        row: &Row<'_>,
        values: &mut [u8],
        weights: &mut [u8],
    ) {
        let look = |cell: usize| self.pixel(row.position(cell)?);
        let size = 1 << SPAN_BITS;
        let (values, _) = values.as_chunks_mut::<COUNT>();
        let spans = weights.len().saturating_sub(1) / size;
        let mut from = look(0);
        for (span, (values, weights)) in values
            .chunks_exact_mut(size)
            .zip(weights.chunks_exact_mut(size))
            .enumerate()
            .take(spans)
        {
            let to = look((span + 1) * size);
            if let (Some(from), Some(to)) = (from, to) {
                sample_span(image, (from, to, SPAN_BITS), values, weights);
            }
            from = to;
        }
        for cell in spans * size..weights.len() {
            if let Some(at) = look(cell) {
                sample_span(
                    image,
                    (at, at, 0),
                    &mut values[cell..=cell],
                    &mut weights[cell..=cell],
                );
            }
        }
    }

    /// Column, row and weight in fixed point at a position of the grid, if it is seen.
    #[inline(always)]
    fn pixel(&self, at: [i64; 2]) -> Option<[i32; 3]> {
        let (column, row) = ((at[0] >> GRID_BITS) as usize, (at[1] >> GRID_BITS) as usize);
        let [u, v, weight, _] = self.between(
            row * self.columns + column,
            fraction(at[0]),
            fraction(at[1]),
        )?;
        // NaN, where a node is not seen, is not greater than anything.
        let fixed = |x: f32| (x * PIXEL_ONE) as i32;
        // Just inside the outermost pixel centres, so that what lies between two such pixels has
        // four neighbours, whatever the rounding of the steps.
        let inside = |x: f32, size: u32| fixed(x).clamp(4, ((size as i32 - 1) << PIXEL_BITS) - 1);
        (weight > 0.0).then(|| {
            let rounded = fixed(weight) + (1 << (PIXEL_BITS - 1));
            [inside(u, self.width), inside(v, self.height), rounded]
        })
    }
}

/// Fills the values and weights of a row.
type Fill = fn(&GroundLut, &ImageView<'_>, &Row<'_>, &mut [u8], &mut [u8]);

/// One compiled loop for each length of span.
fn filling<const COUNT: usize>(span_bits: u32) -> Fill {
    match span_bits {
        0 => GroundLut::sample_row::<0, COUNT>,
        1 => GroundLut::sample_row::<1, COUNT>,
        _ => GroundLut::sample_row::<MOST_SPAN_BITS, COUNT>,
    }
}

/// The fraction of a grid position, from its upper 24 bits: exact in f32.
#[inline(always)]
fn fraction(at: i64) -> f32 {
    ((at as u32) >> 8) as f32 * (1.0 / (1u32 << 24) as f32)
}

/// Samples the image at equal steps from one pixel towards (not including) another. All
/// arithmetic is on integers.
#[inline(always)]
fn sample_span<const COUNT: usize>(
    image: &ImageView<'_>,
    (from, to, span_bits): ([i32; 3], [i32; 3], u32),
    values: &mut [[u8; COUNT]],
    weights: &mut [u8],
) {
    let width = image.width as usize;
    let step = [0, 1, 2].map(|k| (to[k] - from[k]) >> span_bits);
    let [mut u, mut v, mut looked] = from;
    for (value, weight) in values.iter_mut().zip(weights) {
        let part = |x: i32| (x >> (PIXEL_BITS - 8)) as u32 & 0xff;
        let (fu, fv) = (part(u), part(v));
        let at = COUNT * ((v >> PIXEL_BITS) as usize * width + (u >> PIXEL_BITS) as usize);
        if let Some(window) = image.pixels.get(at..at + COUNT * (width + 2)) {
            // Two rows in the halves of one integer: 255 × 256 fits in 16 bits.
            let pair = |offset: usize| {
                u32::from(window[offset]) | u32::from(window[COUNT * width + offset]) << 16
            };
            for (channel, value) in value.iter_mut().enumerate() {
                let mixed = pair(channel) * (256 - fu) + pair(COUNT + channel) * fu;
                let (north, south) = (mixed & 0xffff, mixed >> 16);
                *value = ((north * (256 - fv) + south * fv + (1 << 15)) >> 16) as u8;
            }
            *weight = (looked >> PIXEL_BITS) as u8;
        }
        u += step[0];
        v += step[1];
        looked += step[2];
    }
}

/// A row of cells, and where its ground is in the table's grid.
struct Row<'a> {
    /// Grid position of the first cell on the vehicle's plane, fixed point.
    at: [i64; 2],
    /// From one cell to the next.
    step: [i64; 2],
    /// Column and row of the first cell.
    first: [i64; 2],
    bend: Option<&'a Bend>,
}

impl Row<'_> {
    /// Grid position where the line of sight to a cell meets the vehicle's plane; `None` outside of the table.
    #[inline(always)]
    fn position(&self, cell: usize) -> Option<[i64; 2]> {
        let along = |k: usize| self.at[k].wrapping_add(self.step[k].wrapping_mul(cell as i64));
        let at = [along(0), along(1)];
        match self.bend {
            Some(bend) => bend.position(at, [self.first[0] + cell as i64, self.first[1]]),
            None => Some(at),
        }
    }
}

/// What a floor that bends does to one image: the line of sight to a spot that is higher than the vehicle's plane meets
/// that plane farther away.
struct Bend {
    floor: FloorPart,
    cell_m: f64,
    node_m: f64,
    /// The plane's height at the map's origin, and its rise along x and y.
    plane: [f64; 3],
    /// The map's vertical in the vehicle's frame.
    vertical: [f64; 3],
    /// The camera, in the table's grid, and its height in metres.
    eye: [f64; 2],
    height_m: f64,
    /// Nodes of the table.
    size: [usize; 2],
}

impl Bend {
    fn new(
        lut: &GroundLut,
        map_from_plane: &Pose,
        floor: &Floor,
        grid: &GridFromMap,
        cell_m: f64,
    ) -> Option<Self> {
        let [x, y, z] = map_from_plane.translation.into();
        let normal = map_from_plane.rotate(&Vector3::z());
        let rise = [-normal.x / normal.z, -normal.y / normal.z];
        let vertical = map_from_plane.rotation.inverse() * Vector3::z();
        let [[west, east], [south, north]] =
            [0, 1].map(|k| grid.extent(lut, k).map(|cell| cell * cell_m));
        Some(Self {
            floor: floor.within([west, south, east, north])?,
            cell_m,
            node_m: lut.node_m,
            plane: [z - rise[0] * x - rise[1] * y, rise[0], rise[1]],
            vertical: vertical.into(),
            eye: [0, 1].map(|k| lut.eye[k] / lut.node_m - lut.first[k] as f64),
            height_m: lut.height_m,
            size: [lut.columns, lut.rows],
        })
    }

    /// From the grid position of a cell on the vehicle's plane to that of its spot on the floor, as the camera sees it.
    /// Floor above half of the camera's height hides itself.
    fn position(&self, on_plane: [i64; 2], cell: [i64; 2]) -> Option<[i64; 2]> {
        let [x, y] = cell.map(|number| (number as f64 + 0.5) * self.cell_m);
        let plane = self.plane[0] + self.plane[1] * x + self.plane[2] * y;
        let above = self
            .floor
            .height([x, y])
            .map_or(0.0, |height| height - plane);
        let up = above * self.vertical[2];
        if up >= self.height_m / 2.0 {
            return None;
        }
        let farther = self.height_m / (self.height_m - up);
        let mut position = [0; 2];
        for k in 0..2 {
            let spot = on_plane[k] as f64 / GRID_ONE + above * self.vertical[k] / self.node_m;
            let seen = self.eye[k] + (spot - self.eye[k]) * farther;
            if !(seen >= 0.0 && seen < (self.size[k] - 1) as f64) {
                return None;
            }
            position[k] = (seen * GRID_ONE) as i64;
        }
        Some(position)
    }
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

    /// From where to where the table reaches in the map along an axis, in cells.
    fn extent(&self, lut: &GroundLut, axis: usize) -> [f64; 2] {
        let [x, y, offset] = self.map_from_grid[axis];
        let (columns, rows) = ((lut.columns - 1) as f64, (lut.rows - 1) as f64);
        let corners = [0.0, x * columns, y * rows, x * columns + y * rows];
        let low = corners.into_iter().fold(f64::INFINITY, f64::min) + offset;
        let high = corners.into_iter().fold(f64::NEG_INFINITY, f64::max) + offset;
        [low, high]
    }

    /// Rows of the map that the table may touch.
    fn rows(&self, lut: &GroundLut) -> std::ops::Range<i64> {
        let [low, high] = self.extent(lut, 1);
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
