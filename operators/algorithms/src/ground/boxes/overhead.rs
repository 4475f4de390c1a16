//! The overhead image as gradients, brighter and darker floors alike.

use rayon::prelude::*;

/// Side of the squares over which contrast is levelled (m): more than a space, so that lines stay stronger than the floor
/// between them, and less than a car park, of which a part is in the dark.
pub(super) const LEVEL_M: f64 = 8.0;
/// Width of the mean that is taken before gradients are (m): about that of a drawn line, so that the floor's grain is gone.
const SMOOTH_M: f64 = 0.15;
/// Gradients below this are noise of the image, grey values per cell.
const NOISE: f32 = 1.0;
/// A gradient counts no more than this many times the mean around it.
const MOST: f32 = 8.0;

/// A grey image of the ground, seen from above.
#[derive(Debug, Clone, PartialEq)]
pub struct Overhead {
    /// Cells across.
    pub columns: usize,
    /// Cells down.
    pub rows: usize,
    /// Side of a cell (m).
    pub cell_m: f64,
    /// The image's western border, in the map (m).
    pub west_m: f64,
    /// Its northern border, in the map (m).
    pub north_m: f64,
    /// Grey values, row by row from the north.
    pub grey: Vec<u8>,
    /// Whether anything was seen there.
    pub covered: Vec<bool>,
}

/// Gradients of an [`Overhead`], of equal strength wherever there is structure.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradients {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) cell_m: f64,
    pub(super) west_m: f64,
    pub(super) north_m: f64,
    /// Strength, 0 where nothing was seen, and direction in half turns from east, 0 to 1: a line has one direction, whichever
    /// side is bright.
    polar: Vec<[f32; 2]>,
    /// The same as vectors, `strength (cos 2φ, sin 2φ)`: opposite gradients are one, and the mean of two is between them.
    doubled: Vec<[f32; 2]>,
    covered: Vec<bool>,
}

impl Gradients {
    /// Of an image.
    pub fn new(image: &Overhead) -> Self {
        let (columns, rows) = (image.columns, image.rows);
        let at = |column: usize, row: usize| row * columns + column;
        let smooth = smoothed(image);
        let raw: Vec<[f32; 2]> = (0..rows)
            .into_par_iter()
            .flat_map_iter(|row| {
                let smooth = &smooth;
                (0..columns).map(move |column| {
                    let inner = column > 0 && row > 0 && column + 1 < columns && row + 1 < rows;
                    let around = || {
                        let (columns, rows) = (column - 1..=column + 1, row - 1..=row + 1);
                        rows.flat_map(move |row| columns.clone().map(move |column| at(column, row)))
                    };
                    if !inner || !around().all(|cell| image.covered[cell]) {
                        return [0.0; 2];
                    }
                    let grey = |column: usize, row: usize| smooth[at(column, row)];
                    [
                        0.5 * (grey(column + 1, row) - grey(column - 1, row)),
                        0.5 * (grey(column, row - 1) - grey(column, row + 1)),
                    ]
                })
            })
            .collect();
        let strength: Vec<f32> = raw.iter().map(|[x, y]| x.hypot(*y)).collect();
        let radius = (0.5 * LEVEL_M / image.cell_m).round().max(1.0) as usize;
        let sums = Sums::new(&strength, columns, rows);
        let seen: Vec<f32> = image
            .covered
            .iter()
            .map(|seen| f32::from(u8::from(*seen)))
            .collect();
        let counts = Sums::new(&seen, columns, rows);
        let values = (0..rows).into_par_iter().flat_map_iter(|row| {
            let (raw, strength, sums, counts) = (&raw, &strength, &sums, &counts);
            (0..columns).map(move |column| {
                let cell = at(column, row);
                let around =
                    sums.around(column, row, radius) / counts.around(column, row, radius).max(1.0);
                let level = around as f32 + NOISE;
                let limit = (MOST * level / strength[cell].max(f32::MIN_POSITIVE)).min(1.0) / level;
                raw[cell].map(|value| value * limit)
            })
        });
        let values: Vec<[f32; 2]> = values.collect();
        let polar = |[east, north]: &[f32; 2]| [east.hypot(*north), half_turns(*east, *north)];
        let doubled = |[east, north]: &[f32; 2]| {
            let strength = east.hypot(*north).max(f32::MIN_POSITIVE);
            [
                (east * east - north * north) / strength,
                2.0 * east * north / strength,
            ]
        };
        Self {
            columns,
            rows,
            cell_m: image.cell_m,
            west_m: image.west_m,
            north_m: image.north_m,
            polar: values.par_iter().map(polar).collect(),
            doubled: values.par_iter().map(doubled).collect(),
            covered: image.covered.clone(),
        }
    }

    /// Strength and direction (half turns from east, 0 to 1) of the cell about a point of the map; `None` outside and where
    /// nothing was seen.
    pub(super) fn near(&self, [x, y]: [f64; 2]) -> Option<[f32; 2]> {
        let column = (x - self.west_m) / self.cell_m;
        let row = (self.north_m - y) / self.cell_m;
        let is_inside =
            column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64;
        if !is_inside {
            return None;
        }
        let cell = row as usize * self.columns + column as usize;
        self.covered[cell].then(|| self.polar[cell])
    }

    /// A point of the map, by its share of the image's width and height.
    pub(super) fn within(&self, [across, down]: [f64; 2]) -> [f64; 2] {
        [
            self.west_m + across * self.columns as f64 * self.cell_m,
            self.north_m - down * self.rows as f64 * self.cell_m,
        ]
    }

    /// The gradient with its direction doubled at a point of the map, between cells; `None` as for [`Self::near`].
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> Option<[f32; 2]> {
        let column = (x - self.west_m) / self.cell_m - 0.5;
        let row = (self.north_m - y) / self.cell_m - 0.5;
        let last = [self.columns, self.rows].map(|count| count.saturating_sub(1) as f64);
        if !(column >= 0.0 && row >= 0.0 && column < last[0] && row < last[1]) {
            return None;
        }
        let cell = row as usize * self.columns + column as usize;
        let (across, down) = (column.fract() as f32, row.fract() as f32);
        if !self.covered[cell] {
            return None;
        }
        let near = [cell, cell + 1, cell + self.columns, cell + self.columns + 1];
        let share = [
            (1.0 - across) * (1.0 - down),
            across * (1.0 - down),
            (1.0 - across) * down,
            across * down,
        ];
        let mut sum = [0.0; 2];
        for (cell, share) in near.into_iter().zip(share) {
            let [cos, sin] = self.doubled[cell];
            sum[0] += share * cos;
            sum[1] += share * sin;
        }
        Some(sum)
    }
}

/// The direction of a gradient, in half turns, 0 to 1.
fn half_turns(along: f32, left: f32) -> f32 {
    let turns = left.atan2(along) / std::f32::consts::PI;
    turns - turns.floor()
}

/// The mean about each cell of what was seen.
fn smoothed(image: &Overhead) -> Vec<f32> {
    let seen = image.covered.iter().map(|seen| f32::from(u8::from(*seen)));
    let seen: Vec<f32> = seen.collect();
    let grey = image
        .grey
        .iter()
        .zip(&seen)
        .map(|(grey, seen)| f32::from(*grey) * seen);
    let grey: Vec<f32> = grey.collect();
    let sums = [&grey, &seen].map(|values| Sums::new(values, image.columns, image.rows));
    let radius = (0.5 * (SMOOTH_M / image.cell_m - 1.0)).round().max(0.0) as usize;
    let mean = |cell: usize| {
        let [grey, seen] =
            [0, 1].map(|of| sums[of].around(cell % image.columns, cell / image.columns, radius));
        (grey / seen.max(1.0)) as f32
    };
    (0..grey.len()).map(mean).collect()
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
