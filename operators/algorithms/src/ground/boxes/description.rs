//! What is in a box: histograms of gradients by cell.
//!
//! Source: Dalal & Triggs, *Histograms of oriented gradients for human detection* (2005). The box's own axes are those of
//! the histogram, so that a description is the same at every heading; contrast is levelled in the image
//! ([`super::overhead`]) and once more over the whole box.
//!
//! What is described are roots of the histograms' values, so that products of two descriptions are Bhattacharyya's
//! coefficient: a car beside a worn line is some times stronger, and would be all that a box shows. Source: Arandjelović &
//! Zisserman, *Three things everyone should know to improve object retrieval* (2012).

use super::GroundBox;
use super::overhead::{DIRECTIONS, Gradients, STEP};
use crate::processor::vectorised;

/// Cells along a box's length.
pub(super) const ALONG: usize = 10;
/// Cells across it.
pub(super) const ACROSS: usize = 6;
/// Directions of gradients, over half a turn.
pub(super) const BINS: usize = 8;
/// Numbers of a description, and a constant one.
pub const LENGTH: usize = ALONG * ACROSS * BINS + 1;
/// How far a description reaches beyond the box on each side, as a part of its width: lines are drawn on borders.
const MARGIN: f64 = 0.2;
/// Samples across a cell.
const SAMPLES: usize = 5;
/// Samples along a box, and across it.
const COLUMNS: usize = ALONG * SAMPLES;
const ROWS: usize = ACROSS * SAMPLES;
/// Part of a box that must have been seen.
pub(super) const LEAST_SEEN: f64 = 0.6;
/// A box with gradients of no more than this (mean, of levelled ones) is empty floor: its description is short.
const EMPTY: f32 = 0.25;

/// Sides of what is described about a box: along and across (m).
pub(super) fn reach_m(of: &GroundBox) -> [f64; 2] {
    let margin_m = 2.0 * MARGIN * of.width_m;
    [of.length_m + margin_m, of.width_m + margin_m]
}

/// By direction of a gradient, its share of the two bins that it belongs to, for boxes whose length lies at so many half
/// turns (0 to 1).
fn votes(half_turns: f32) -> [[f32; BINS]; DIRECTIONS] {
    std::array::from_fn(|direction| {
        let from_length = direction as f32 / DIRECTIONS as f32 - half_turns;
        let place = (from_length + 1.0) * BINS as f32;
        let bin = place as usize;
        let share = place - bin as f32;
        let mut votes = [0.0; BINS];
        votes[bin % BINS] = 1.0 - share;
        votes[(bin + 1) % BINS] = share;
        votes
    })
}

/// What an image shows in a box; `None` where too little of it was seen.
pub fn describe(gradients: &Gradients, of: &GroundBox) -> Option<Vec<f32>> {
    let mut cells = vec![0.0_f32; LENGTH];
    let mut seen = 0;
    vectorised(
        #[inline(always)]
        || seen = add_histograms(gradients, of, &mut cells),
    );
    if f64::from(seen) < LEAST_SEEN * (COLUMNS * ROWS) as f64 {
        return None;
    }
    let norm = norm(cells.iter().sum());
    let described = |value: f32| value.sqrt() / norm;
    cells
        .iter_mut()
        .for_each(|value| *value = described(*value));
    cells[LENGTH - 1] = 1.0;
    Some(cells)
}

/// Adds the mean histogram of each cell of a box; how many of its samples were seen.
#[inline(always)]
fn add_histograms(gradients: &Gradients, of: &GroundBox, cells: &mut [f32]) -> u32 {
    let numbers = sampled(gradients, of);
    let half_turns = (of.yaw / std::f64::consts::PI).rem_euclid(1.0) as f32;
    let votes = votes(half_turns);
    let mut seen = 0;
    for (cell, bins) in cells.chunks_exact_mut(BINS).enumerate() {
        let (first_column, first_row) = (cell / ACROSS * SAMPLES, cell % ACROSS * SAMPLES);
        let mut sums = [0.0_f32; BINS];
        for column in &numbers[first_column..first_column + SAMPLES] {
            for number in &column[first_row..first_row + SAMPLES] {
                let Some([steps, direction]) = gradients.seen(*number) else {
                    continue;
                };
                seen += 1;
                let strength = f32::from(steps) * STEP;
                let votes = &votes[usize::from(direction)];
                sums = std::array::from_fn(|bin| {
                    sums[bin] + strength * votes[bin] / (SAMPLES * SAMPLES) as f32
                });
            }
        }
        bins.copy_from_slice(&sums);
    }
    seen
}

/// The numbers of the cells of an image that a box is sampled in, by column and row of the box.
#[inline(always)]
fn sampled(gradients: &Gradients, of: &GroundBox) -> [[i32; ROWS]; COLUMNS] {
    let [long_m, wide_m] = reach_m(of);
    let to_map = of.to_map();
    let mut numbers = [[0; ROWS]; COLUMNS];
    for (column, numbers) in numbers.iter_mut().enumerate() {
        let along = ((column as f64 + 0.5) / COLUMNS as f64 - 0.5) * long_m;
        for (row, number) in numbers.iter_mut().enumerate() {
            let left = ((row as f64 + 0.5) / ROWS as f64 - 0.5) * wide_m;
            *number = gradients.number(to_map([along, left]));
        }
    }
    numbers
}

/// What the roots of a box's histograms are divided by, from the sum of the histograms.
pub(super) fn norm(sum: f32) -> f32 {
    (sum + EMPTY * (ALONG * ACROSS) as f32).sqrt()
}
