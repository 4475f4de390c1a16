//! A panorama at several sizes, each half of the one before.

use super::super::sphere::{Lens, Sphere};

/// A panorama at one size.
#[derive(Debug, Clone)]
pub(super) struct Level {
    pub lens: Lens,
    /// Brightness.
    pub grey: Vec<f32>,
    /// One over the range (1/m); 0 where nothing was measured.
    pub inverse: Vec<f32>,
    /// Inverse ranges of neighbouring pixels that differ by more are of two things (1/m).
    edge: f32,
}

/// Values at a place between pixels, with their derivatives along columns and rows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub grey: [f32; 3],
    pub inverse: [f32; 3],
}

impl Level {
    /// The panorama as it is.
    pub fn finest(sphere: &Sphere<'_>, nearest_m: f64) -> Self {
        let inverse = |units: &u16| match units {
            0 => 0.0,
            units => (1.0 / (f64::from(*units) * sphere.unit_m)) as f32,
        };
        let grey = sphere.grey.iter().map(|grey| f32::from(*grey)).collect();
        let inverse = sphere.range.iter().map(inverse).collect();
        Self::new(sphere.lens.clone(), grey, inverse, nearest_m)
    }

    /// On a plane at a distance d, inverse range changes by 1/d per radian at most, where it is seen at grazing angles.
    fn new(lens: Lens, grey: Vec<f32>, inverse: Vec<f32>, nearest_m: f64) -> Self {
        let diagonal = 2_f64.sqrt() * lens.pixel_rad();
        Self {
            edge: (diagonal / nearest_m) as f32,
            lens,
            grey,
            inverse,
        }
    }

    /// Half as large; what is left over at the right and below is dropped. Range is the mean of what was measured, if that
    /// is at least half of it, in inverse range.
    pub fn halved(&self, nearest_m: f64) -> Option<Self> {
        let lens = self.lens.halved()?;
        let mut grey = Vec::with_capacity(lens.width * lens.height);
        let mut inverse = Vec::with_capacity(lens.width * lens.height);
        let width = self.lens.width;
        for row in 0..lens.height {
            for column in 0..lens.width {
                let at = 2 * row * width + 2 * column;
                let four = [at, at + 1, at + width, at + width + 1];
                grey.push(four.iter().map(|at| self.grey[*at]).sum::<f32>() / 4.0);
                let ranges = four.map(|at| self.inverse[at]);
                let measured = ranges.iter().filter(|range| **range > 0.0).count();
                let sum: f32 = ranges.iter().sum();
                inverse.push(if measured >= 2 {
                    sum / measured as f32
                } else {
                    0.0
                });
            }
        }
        Some(Self::new(lens, grey, inverse, nearest_m))
    }

    /// Between the four pixels around a place; `None` out of the image, where range is missing, and at the edges of things.
    pub fn sample(&self, [u, v]: [f64; 2]) -> Option<Sample> {
        let (left, top) = (u.floor(), v.floor());
        let (width, height) = (self.lens.width, self.lens.height);
        if !(top >= 0.0 && top < height as f64 - 1.0) {
            return None;
        }
        let (mut column, row) = (left as i64, top as usize);
        let mut next = column + 1;
        if self.lens.wraps {
            column = column.rem_euclid(width as i64);
            next = if column + 1 == width as i64 {
                0
            } else {
                column + 1
            };
        } else if column < 0 || next >= width as i64 {
            return None;
        }
        let above = row * width;
        let at = [
            above + column as usize,
            above + next as usize,
            above + width + column as usize,
            above + width + next as usize,
        ];
        let ranges = at.map(|at| self.inverse[at]);
        let least = ranges.iter().copied().fold(f32::INFINITY, f32::min);
        let most = ranges.iter().copied().fold(0.0, f32::max);
        if least <= 0.0 || most - least > self.edge {
            return None;
        }
        let (x, y) = ((u - left) as f32, (v - top) as f32);
        let between = |values: [f32; 4]| {
            let [a, b, c, d] = values;
            let (upper, lower) = (b - a, d - c);
            let (first, second) = (a + x * upper, c + x * lower);
            [
                first + y * (second - first),
                upper + y * (lower - upper),
                second - first,
            ]
        };
        Some(Sample {
            grey: between(at.map(|at| self.grey[at])),
            inverse: between(ranges),
        })
    }
}
