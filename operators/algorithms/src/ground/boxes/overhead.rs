//! The overhead image as gradients, brighter and darker floors alike.

use rayon::prelude::*;

use crate::ground::channels::Channels;

/// Side of the squares over which contrast is levelled (m): more than a space, so that lines stay stronger than the floor
/// between them, and less than a car park, of which a part is in the dark.
const LEVEL_M: f64 = 8.0;
/// Width of the mean that is taken before gradients are (m): about that of a drawn line, so that the floor's grain is gone.
const SMOOTH_M: f64 = 0.15;
/// Gradients below this are noise of the image, grey values per cell.
const NOISE: f32 = 1.0;
/// A gradient counts no more than this many times the mean around it.
const MOST: f32 = 8.0;

/// No gradient depends on what is more cells away (two tiles), however small cells are.
const MOST_RADIUS: f64 = 512.0;
/// Strength of the strongest gradient; the steps below it are equal.
const STRONGEST: u8 = 254;
/// What a step of strength is.
pub(super) const STEP: f32 = MOST / STRONGEST as f32;
/// Strength of a cell that nobody saw.
const UNSEEN: u8 = 255;
/// Directions that are told apart, over half a turn.
pub(super) const DIRECTIONS: usize = 256;

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
        level_radius(cell_m) + smooth_radius(cell_m) + 1
    }

    /// Gradients of all cells, of equal strength wherever there is structure: those of cells with less than
    /// [`Self::margin`] around them are of what the image shows. In colour each is that of the channel in which it is strongest,
    /// as Dalal & Triggs take it.
    pub(super) fn gradients(&self) -> Vec<GradientCell> {
        let (columns, rows) = (self.columns, self.rows);
        let at = |column: usize, row: usize| row * columns + column;
        let counts = self.seen();
        let mut raw = vec![[0.0; 2]; columns * rows];
        for channel in &self.channels {
            self.strengthen(&mut raw, &self.smoothed(channel, &counts));
        }
        let strength: Vec<f32> = raw.iter().map(|[x, y]| x.hypot(*y)).collect();
        let radius = level_radius(self.cell_m);
        let sums = Sums::new(&strength, columns, rows);
        let cells = (0..rows).into_par_iter().flat_map_iter(|row| {
            let (raw, strength, sums, counts) = (&raw, &strength, &sums, &counts);
            (0..columns).map(move |column| {
                let cell = at(column, row);
                if !self.covered[cell] {
                    return NOT_SEEN;
                }
                let around =
                    sums.around(column, row, radius) / counts.around(column, row, radius).max(1.0);
                let level = around as f32 + NOISE;
                let levelled = (strength[cell] / level).min(MOST);
                gradient_cell(levelled, half_turns(raw[cell][0], raw[cell][1]))
            })
        });
        cells.collect()
    }

    /// How many cells were seen.
    fn seen(&self) -> Sums {
        let seen = self.covered.iter().map(|seen| f32::from(u8::from(*seen)));
        Sums::new(&seen.collect::<Vec<f32>>(), self.columns, self.rows)
    }

    /// The mean of a channel about each cell, of what was seen.
    fn smoothed(&self, channel: &[u8], counts: &Sums) -> Vec<f32> {
        let values = channel.iter().zip(&self.covered);
        let values = values.map(|(value, seen)| f32::from(*value) * f32::from(u8::from(*seen)));
        let sums = Sums::new(&values.collect::<Vec<f32>>(), self.columns, self.rows);
        let radius = smooth_radius(self.cell_m);
        let mean = |cell: usize| {
            let (column, row) = (cell % self.columns, cell / self.columns);
            let [sum, seen] = [&sums, counts].map(|sums| sums.around(column, row, radius));
            (sum / seen.max(1.0)) as f32
        };
        (0..channel.len()).map(mean).collect()
    }

    /// Puts the gradients of a channel in the place of weaker ones. A cell on the border, or beside one that was not seen, has
    /// none.
    fn strengthen(&self, strongest: &mut [[f32; 2]], smooth: &[f32]) {
        let (columns, rows) = (self.columns, self.rows);
        let at = |column: usize, row: usize| row * columns + column;
        let lines = strongest.par_chunks_mut(columns.max(1)).enumerate();
        lines.for_each(|(row, line)| {
            for (column, known) in line.iter_mut().enumerate() {
                let inner = column > 0 && row > 0 && column + 1 < columns && row + 1 < rows;
                let around = || {
                    let (columns, rows) = (column - 1..=column + 1, row - 1..=row + 1);
                    rows.flat_map(move |row| columns.clone().map(move |column| at(column, row)))
                };
                if !inner || !around().all(|cell| self.covered[cell]) {
                    continue;
                }
                let value = |column: usize, row: usize| smooth[at(column, row)];
                let gradient = [
                    0.5 * (value(column + 1, row) - value(column - 1, row)),
                    0.5 * (value(column, row - 1) - value(column, row + 1)),
                ];
                if square(gradient) > square(*known) {
                    *known = gradient;
                }
            }
        });
    }
}

/// The square of a length.
fn square([x, y]: [f32; 2]) -> f32 {
    x * x + y * y
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
            let turn = std::f32::consts::TAU * direction as f32 / DIRECTIONS as f32;
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

/// The direction of a gradient, in half turns, 0 to 1.
fn half_turns(along: f32, left: f32) -> f32 {
    let turns = left.atan2(along) / std::f32::consts::PI;
    turns - turns.floor()
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
