//! Centres and ellipses from exact sums over runs.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::Area;
use super::runs::{Run, Runs};

/// Sums over an area's pixels. Exact: a sum of squares of at most 2^30 pixels below 2^16 fits.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    pixels: i64,
    u: i64,
    v: i64,
    uu: i64,
    uv: i64,
    vv: i64,
}

impl Sums {
    /// Adds the pixels of columns `start..end` of row `v`.
    fn add(&mut self, start: i64, end: i64, v: i64) {
        let pixels = end - start;
        let u = (start + end - 1) * pixels / 2;
        let squares_below = |n: i64| (n - 1) * n * (2 * n - 1) / 6;
        self.pixels += pixels;
        self.u += u;
        self.v += v * pixels;
        self.uu += squares_below(end) - squares_below(start);
        self.uv += u * v;
        self.vv += v * v * pixels;
    }

    /// Centre and ellipse; the class is not known here.
    fn area(&self, width: Option<u32>) -> Area {
        let n = self.pixels.max(1) as f64;
        // n² times a central moment, exactly; a pixel is a unit square, which has a second moment of 1/12 itself.
        let central = |squares: i64, a: i64, b: i64| {
            let exact =
                i128::from(self.pixels) * i128::from(squares) - i128::from(a) * i128::from(b);
            exact as f64 / (n * n)
        };
        let uu = central(self.uu, self.u, self.u) + 1.0 / 12.0;
        let vv = central(self.vv, self.v, self.v) + 1.0 / 12.0;
        let uv = central(self.uv, self.u, self.v);
        let half_difference = ((uu - vv) / 2.0).hypot(uv);
        let mean = (uu + vv) / 2.0;
        let (large, small) = (mean + half_difference, (mean - half_difference).max(0.0));
        let angle = 0.5 * (2.0 * uv).atan2(uu - vv);
        let mut u = self.u as f64 / n;
        if let Some(width) = width {
            u = (u + 0.5).rem_euclid(f64::from(width)) - 0.5;
        }
        Area {
            class: 0,
            pixels: self.pixels as u32,
            u: u as f32,
            v: (self.v as f64 / n) as f32,
            major_px: (2.0 * large.sqrt()) as f32,
            minor_px: (2.0 * small.sqrt()) as f32,
            orientation_rad: if angle <= -FRAC_PI_2 {
                FRAC_PI_2
            } else {
                angle
            } as f32,
            eccentricity: (1.0 - small / large).max(0.0).sqrt() as f32,
        }
    }
}

/// The areas of a set of runs, without their classes.
///
/// An area across the seam is unrolled: cut at a column where it has no pixel, so that it is in one piece. An area that
/// has pixels in every column is cut opposite its mean direction.
pub(super) fn areas(
    runs: &Runs,
    area_of_run: &[Option<u16>],
    number: usize,
    wraps: bool,
) -> Vec<Area> {
    let width = if wraps { width(runs) } else { 0 };
    let cuts = if wraps {
        cuts(runs, area_of_run, number, width)
    } else {
        vec![0; number]
    };
    let mut sums = vec![Sums::default(); number];
    for (v, row) in (0..).zip(runs.rows()) {
        for (run, area) in runs.runs()[row.clone()].iter().zip(&area_of_run[row]) {
            let Some(area) = area.map(usize::from) else {
                continue;
            };
            let (start, end, cut) = (i64::from(run.start), i64::from(run.end), cuts[area]);
            let turn = width as i64;
            if start < cut {
                sums[area].add(start + turn, end.min(cut) + turn, v);
            }
            if end > cut {
                sums[area].add(start.max(cut), end, v);
            }
        }
    }
    let turn = wraps.then_some(width as u32);
    sums.iter().map(|sums| sums.area(turn)).collect()
}

fn width(runs: &Runs) -> usize {
    runs.runs()
        .iter()
        .map(|run| usize::from(run.end))
        .max()
        .unwrap_or(0)
}

/// The column before which each area is cut: 0 where it does not cross the seam.
fn cuts(runs: &Runs, area_of_run: &[Option<u16>], number: usize, width: usize) -> Vec<i64> {
    let mut of_crossing: Vec<Option<Vec<Run>>> = vec![None; number];
    for row in runs.rows().filter(|row| !row.is_empty()) {
        let (first, last) = (area_of_run[row.start], area_of_run[row.end - 1]);
        if let (Some(first), true) = (first, first == last) {
            of_crossing[usize::from(first)] = Some(Vec::new());
        }
    }
    for (run, area) in runs.runs().iter().zip(area_of_run) {
        if let Some(of_area) = area.and_then(|area| of_crossing[usize::from(area)].as_mut()) {
            of_area.push(*run);
        }
    }
    let cut = |of_area: &Option<Vec<Run>>| of_area.as_ref().map_or(0, |runs| cut(runs, width));
    of_crossing.iter().map(cut).collect()
}

/// Where to cut an area that crosses the seam.
fn cut(runs: &[Run], width: usize) -> i64 {
    // Changes of the number of pixels from column to column.
    let mut steps = vec![0_i64; width + 1];
    for run in runs {
        steps[usize::from(run.start)] += 1;
        steps[usize::from(run.end)] -= 1;
    }
    let mut height = 0;
    let pixels = steps[..width].iter().map(|step| {
        height += step;
        height
    });
    let pixels: Vec<i64> = pixels.collect();
    let empty = pixels.iter().position(|pixels| *pixels == 0);
    empty.unwrap_or_else(|| opposite(&pixels)) as i64
}

/// The column opposite the mean direction of pixels counted by column; opposite column 0 where they are spread evenly.
fn opposite(pixels: &[i64]) -> usize {
    let width = pixels.len();
    let step = TAU / width as f64;
    let (mut x, mut y) = (0.0, 0.0);
    for (column, pixels) in pixels.iter().enumerate() {
        let (sin, cos) = (column as f64 * step).sin_cos();
        x += *pixels as f64 * cos;
        y += *pixels as f64 * sin;
    }
    let even = x.hypot(y) < 1e-9 * pixels.iter().sum::<i64>() as f64;
    let mean = if even { 0.0 } else { y.atan2(x) / step };
    // Halves go up although sines are rounded.
    (mean + width as f64 / 2.0 + 0.5 + 1e-6)
        .floor()
        .rem_euclid(width as f64) as usize
        % width
}
