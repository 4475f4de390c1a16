//! The overhead image as gradients, brighter and darker floors alike.
//!
//! Boxes are told by lines, and a line differs from what lies to both sides of it. So what is called a gradient is the largest
//! second derivative of a cell, by size, and its direction leads across the line: the border of a car or a shadow, which is
//! bright to one side and dark to the other, counts less than a line of the same contrast. In colour it is that of brightness or
//! of one of two opponent colours in which it is strongest: of a floor's grain, opponent colours show next to nothing.
//!
//! Sources: Steger, *An unbiased detector of curvilinear structures* (1998), for lines; Dalal & Triggs, *Histograms of oriented
//! gradients for human detection* (2005), for the strongest channel; van de Sande, Gevers & Snoek, *Evaluating color descriptors
//! for object and scene recognition* (2010), for opponent colours.

#[cfg(test)]
mod tests;

use std::f32::consts::{FRAC_1_SQRT_2, TAU};

use rayon::prelude::*;

use crate::ground::channels::Channels;

/// Side of the squares over which contrast is levelled (m): more than a space, so that lines stay stronger than the floor
/// between them, and less than a car park, of which a part is in the dark.
const LEVEL_M: f64 = 8.0;
/// Width of the mean that is taken before gradients are (m): about that of a drawn line, so that the floor's grain is gone.
const SMOOTH_M: f64 = 0.15;
/// From the middle of a line to what it is compared with on both sides (m): lines are about as wide, so that is the floor.
const BESIDE_M: f64 = 0.1;
/// Gradients below this are noise of the image, grey values per cell.
const NOISE: f32 = 1.0;
/// A gradient counts no more than this many times the mean around it.
const MOST: f32 = 8.0;

/// No gradient depends on what is more cells away (two tiles), however small cells are.
const MOST_RADIUS: f64 = 512.0;
/// Nor is what lies beside a line more cells away.
const MOST_BESIDE: f64 = 16.0;
/// Strength of the strongest gradient; the steps below it are equal.
const STRONGEST: u8 = 254;
/// What a step of strength is.
pub(super) const STEP: f32 = MOST / STRONGEST as f32;
/// Strength of a cell that nobody saw.
const UNSEEN: u8 = 255;
/// Directions that are told apart, over half a turn.
pub(super) const DIRECTIONS: usize = 256;

/// Shares of red, green and blue in brightness, and in the opponent colours red to green and blue to yellow. Grey has none of the
/// latter.
const OPPONENTS: [[f32; 3]; 3] = [
    [0.299, 0.587, 0.114],
    [FRAC_1_SQRT_2, -FRAC_1_SQRT_2, 0.0],
    [YELLOW, YELLOW, -2.0 * YELLOW],
];
/// One over the root of six.
const YELLOW: f32 = 0.408_248_3;

/// The gradient of a cell: its strength in steps, 255 where nothing was seen, and its direction from east in 256ths of half a
/// turn, anticlockwise: a line has one direction, whichever side is bright.
pub type GradientCell = [u8; 2];

/// A cell of which nothing was seen.
pub(super) const NOT_SEEN: GradientCell = [UNSEEN, 0];

/// Whether anything was seen of a cell.
pub(super) fn is_seen([strength, _]: &GradientCell) -> bool {
    *strength != UNSEEN
}

/// An image of the ground, seen from above.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Overhead {
    /// Cells across.
    pub(super) columns: usize,
    /// Cells down.
    pub(super) rows: usize,
    /// Side of a cell (m).
    pub(super) cell_m: f64,
    /// Grey values, or those of red, of green and of blue, each row by row from the north.
    pub(super) channels: Vec<Vec<u8>>,
    /// Whether anything was seen there.
    pub(super) covered: Vec<bool>,
}

impl Overhead {
    /// Of so many columns and rows, of which nothing was seen.
    pub(super) fn unseen(channels: Channels, [columns, rows]: [usize; 2], cell_m: f64) -> Self {
        Self {
            columns,
            rows,
            cell_m,
            channels: vec![vec![0; columns * rows]; channels.count()],
            covered: vec![false; columns * rows],
        }
    }

    /// The same in grey where no cell has a colour.
    pub(super) fn without_equal_channels(mut self) -> Self {
        if self.channels.windows(2).all(|pair| pair[0] == pair[1]) {
            self.channels.truncate(1);
        }
        self
    }

    /// How many cells to each side of one its gradient depends on.
    pub(super) fn margin(cell_m: f64) -> usize {
        level_radius(cell_m) + smooth_radius(cell_m) + beside(cell_m)
    }

    /// Gradients of all cells, of equal strength wherever there is structure: those of cells with less than
    /// [`Self::margin`] around them are of what the image shows.
    pub(super) fn gradients(&self) -> Vec<GradientCell> {
        let (columns, rows) = (self.columns, self.rows);
        let counts = self.seen();
        let mut raw = vec![Line::default(); columns * rows];
        for values in self.contrasts() {
            self.strengthen(&mut raw, &self.smoothed(&values, &counts), &counts);
        }
        let strength: Vec<f32> = raw.iter().map(|line| line.strength).collect();
        let radius = level_radius(self.cell_m);
        let sums = Sums::new(&strength, columns, rows);
        let cells = (0..rows).into_par_iter().flat_map_iter(|row| {
            let (raw, strength, sums, counts) = (&raw, &strength, &sums, &counts);
            (0..columns).map(move |column| {
                let cell = row * columns + column;
                if !self.covered[cell] {
                    return NOT_SEEN;
                }
                let around =
                    sums.around(column, row, radius) / counts.around(column, row, radius).max(1.0);
                let level = around as f32 + NOISE;
                let levelled = (strength[cell] / level).min(MOST);
                gradient_cell(levelled, raw[cell].half_turns())
            })
        });
        cells.collect()
    }

    /// How many cells were seen.
    fn seen(&self) -> Sums {
        let seen = self.covered.iter().map(|seen| f32::from(u8::from(*seen)));
        Sums::new(&seen.collect::<Vec<f32>>(), self.columns, self.rows)
    }

    /// What lines are looked for in, by cell: grey values, or [`OPPONENTS`].
    fn contrasts(&self) -> Vec<Vec<f32>> {
        let [red, green, blue] = self.channels.as_slice() else {
            let grey = self.channels.iter();
            let values = grey.map(|values| values.iter().copied().map(f32::from).collect());
            return values.collect();
        };
        let shown = |[reds, greens, blues]: &[f32; 3]| {
            let cells = red.iter().zip(green).zip(blue);
            let value = |((red, green), blue): ((&u8, &u8), &u8)| {
                reds * f32::from(*red) + greens * f32::from(*green) + blues * f32::from(*blue)
            };
            cells.map(value).collect()
        };
        OPPONENTS.iter().map(shown).collect()
    }

    /// The mean of values about each cell, of what was seen.
    fn smoothed(&self, values: &[f32], counts: &Sums) -> Vec<f32> {
        let seen = values.iter().zip(&self.covered);
        let seen = seen.map(|(value, seen)| value * f32::from(u8::from(*seen)));
        let sums = Sums::new(&seen.collect::<Vec<f32>>(), self.columns, self.rows);
        let radius = smooth_radius(self.cell_m);
        let mean = |cell: usize| {
            let (column, row) = (cell % self.columns, cell / self.columns);
            let [sum, seen] = [&sums, counts].map(|sums| sums.around(column, row, radius));
            (sum / seen.max(1.0)) as f32
        };
        (0..values.len()).map(mean).collect()
    }

    /// Puts the lines that values show in the place of weaker ones. A cell near the border, or near one that was not seen, has
    /// none.
    fn strengthen(&self, strongest: &mut [Line], smooth: &[f32], counts: &Sums) {
        let beside = beside(self.cell_m);
        let all = ((2 * beside + 1) * (2 * beside + 1)) as f64;
        let value = |column: usize, row: usize| smooth[row * self.columns + column];
        let lines = strongest.par_chunks_mut(self.columns.max(1)).enumerate();
        lines.for_each(|(row, cells)| {
            for (column, known) in cells.iter_mut().enumerate() {
                if counts.around(column, row, beside) < all {
                    continue;
                }
                let (west, east) = (column - beside, column + beside);
                let (north, south) = (row - beside, row + beside);
                let twice = 2.0 * value(column, row);
                let line = Line::new([
                    value(west, row) + value(east, row) - twice,
                    0.25 * (value(east, north) + value(west, south)
                        - value(west, north)
                        - value(east, south)),
                    value(column, north) + value(column, south) - twice,
                ]);
                if line.strength > known.strength {
                    *known = line;
                }
            }
        });
    }
}

/// How a cell differs from what lies beside it.
#[derive(Debug, Clone, Copy, Default)]
struct Line {
    /// From the mean of what lies to both sides, in the direction in which that is most.
    strength: f32,
    /// This direction, from east, doubled: parts of a vector of any length.
    doubled: [f32; 2],
}

impl Line {
    /// From second derivatives: twice to the east, to the east and to the north, and twice to the north. The one in a direction
    /// `φ` is `mean + (cos 2φ, sin 2φ) · doubled`.
    fn new([east, both, north]: [f32; 3]) -> Self {
        let mean = 0.5 * (east + north);
        let doubled = [0.5 * (east - north), both];
        let length = (doubled[0] * doubled[0] + doubled[1] * doubled[1]).sqrt();
        let sign = if mean < 0.0 { -1.0 } else { 1.0 };
        Self {
            strength: 0.5 * (mean.abs() + length),
            doubled: doubled.map(|part| sign * part),
        }
    }

    /// Its direction in half turns, 0 to 1.
    fn half_turns(&self) -> f32 {
        let [cos, sin] = self.doubled;
        let half_turns = sin.atan2(cos) / TAU;
        half_turns - half_turns.floor()
    }
}

/// Cells from one to the border of the square over which its contrast is levelled.
fn level_radius(cell_m: f64) -> usize {
    (0.5 * LEVEL_M / cell_m).round().clamp(1.0, MOST_RADIUS) as usize
}

/// Cells from one to the border of the square over which a mean is taken before gradients are.
fn smooth_radius(cell_m: f64) -> usize {
    let radius = 0.5 * (SMOOTH_M / cell_m - 1.0);
    radius.round().clamp(0.0, MOST_RADIUS) as usize
}

/// Cells from the middle of a line to what it is compared with.
fn beside(cell_m: f64) -> usize {
    (BESIDE_M / cell_m).round().clamp(1.0, MOST_BESIDE) as usize
}

/// A cell with a gradient of this strength, at most [`MOST`], and direction in half turns, 0 to 1.
fn gradient_cell(strength: f32, half_turns: f32) -> GradientCell {
    let steps = (strength * f32::from(STRONGEST) / MOST).round();
    let direction = (half_turns * DIRECTIONS as f32).round() as usize % DIRECTIONS;
    [steps.min(f32::from(STRONGEST)) as u8, direction as u8]
}

/// Gradients of a part of the ground.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradients {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) cell_m: f64,
    pub(super) west_m: f64,
    pub(super) north_m: f64,
    /// Row by row from the north.
    cells: Vec<GradientCell>,
    /// By direction: `(cos 2φ, sin 2φ)`. Opposite gradients are one, and the mean of two is between them.
    doubled: [[f32; 2]; DIRECTIONS],
}

impl Gradients {
    /// Of cells with these sides (m), in rows of so many, from the north-western corner (m) on.
    pub(super) fn new(
        cell_m: f64,
        columns: usize,
        [west_m, north_m]: [f64; 2],
        cells: Vec<GradientCell>,
    ) -> Self {
        let doubled = std::array::from_fn(|direction| {
            let turn = TAU * direction as f32 / DIRECTIONS as f32;
            [turn.cos(), turn.sin()]
        });
        Self {
            columns,
            rows: cells.len() / columns.max(1),
            cell_m,
            west_m,
            north_m,
            cells,
            doubled,
        }
    }

    /// The number of the cell about a point of the map, negative outside. Nothing branches, so that loops over it are
    /// vectorised.
    #[inline(always)]
    pub(super) fn number(&self, [x, y]: [f64; 2]) -> i32 {
        let column = (x - self.west_m) / self.cell_m;
        let row = (self.north_m - y) / self.cell_m;
        let is_inside = (column >= 0.0)
            & (row >= 0.0)
            & (column < self.columns as f64)
            & (row < self.rows as f64);
        let number = (row as i32)
            .wrapping_mul(self.columns as i32)
            .wrapping_add(column as i32);
        if is_inside { number } else { -1 }
    }

    /// The strength of a cell's gradient in steps, and its direction; `None` outside and where nothing was seen.
    #[inline(always)]
    pub(super) fn seen(&self, number: i32) -> Option<GradientCell> {
        let cell = usize::try_from(number).ok();
        let cell = cell.and_then(|number| self.cells.get(number));
        cell.filter(|cell| is_seen(cell)).copied()
    }

    /// A point of the map, by its share of the image's width and height.
    pub(super) fn within(&self, [across, down]: [f64; 2]) -> [f64; 2] {
        [
            self.west_m + across * self.columns as f64 * self.cell_m,
            self.north_m - down * self.rows as f64 * self.cell_m,
        ]
    }

    /// Of four cells about a point of the map the north-western one's number, negative outside, and how far from its middle
    /// the point lies, as a share of the way to the next one's: across and down. Nothing branches.
    #[inline(always)]
    pub(super) fn four(&self, [x, y]: [f64; 2]) -> (i32, [f32; 2]) {
        let column = (x - self.west_m) / self.cell_m - 0.5;
        let row = (self.north_m - y) / self.cell_m - 0.5;
        let last = [self.columns, self.rows].map(|count| count.saturating_sub(1) as f64);
        let is_inside = (column >= 0.0) & (row >= 0.0) & (column < last[0]) & (row < last[1]);
        let (whole_column, whole_row) = (column as i32, row as i32);
        let number = whole_row
            .wrapping_mul(self.columns as i32)
            .wrapping_add(whole_column);
        let across = (column - f64::from(whole_column)) as f32;
        let down = (row - f64::from(whole_row)) as f32;
        (if is_inside { number } else { -1 }, [across, down])
    }

    /// The mean gradient of four cells ([`Self::four`]), its direction doubled; none outside, and where nothing was seen of
    /// the first.
    #[inline(always)]
    pub(super) fn mean(&self, number: i32, [across, down]: [f32; 2]) -> [f32; 2] {
        let pair = |from: usize| self.cells.get(from..from + 2);
        let from = usize::try_from(number).ok();
        let lines = from.and_then(|from| pair(from).zip(pair(from + self.columns)));
        let Some((upper, lower)) = lines.filter(|(upper, _)| is_seen(&upper[0])) else {
            return [0.0; 2];
        };
        let near = [
            (&upper[0], (1.0 - across) * (1.0 - down)),
            (&upper[1], across * (1.0 - down)),
            (&lower[0], (1.0 - across) * down),
            (&lower[1], across * down),
        ];
        near.into_iter().fold([0.0; 2], |sum, (cell, share)| {
            let [cos, sin] = self.doubled[usize::from(cell[1])];
            let strength = share * strength(cell);
            [sum[0] + strength * cos, sum[1] + strength * sin]
        })
    }
}

/// The strength of a cell's gradient, 0 where nothing was seen.
#[inline(always)]
fn strength(cell: &GradientCell) -> f32 {
    match is_seen(cell) {
        true => f32::from(cell[0]) * STEP,
        false => 0.0,
    }
}

/// Sums over rectangles.
struct Sums {
    columns: usize,
    rows: usize,
    sums: Vec<f64>,
}

impl Sums {
    fn new(values: &[f32], columns: usize, rows: usize) -> Self {
        let mut sums = vec![0.0; (columns + 1) * (rows + 1)];
        for row in 0..rows {
            let mut sum = 0.0;
            for column in 0..columns {
                sum += f64::from(values[row * columns + column]);
                let above = sums[row * (columns + 1) + column + 1];
                sums[(row + 1) * (columns + 1) + column + 1] = above + sum;
            }
        }
        Self {
            columns,
            rows,
            sums,
        }
    }

    fn around(&self, column: usize, row: usize, radius: usize) -> f64 {
        let range =
            |at: usize, count: usize| (at.saturating_sub(radius), (at + radius + 1).min(count));
        let ((left, right), (top, bottom)) = (range(column, self.columns), range(row, self.rows));
        let at = |column: usize, row: usize| self.sums[row * (self.columns + 1) + column];
        at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top)
    }
}
