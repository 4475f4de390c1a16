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
use super::overhead::Gradients;

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
/// Part of a box that must have been seen.
pub(super) const LEAST_SEEN: f64 = 0.6;
/// A box with gradients of no more than this (mean, of levelled ones) is empty floor: its description is short.
const EMPTY: f32 = 0.25;

/// Sides of what is described about a box: along and across (m).
pub(super) fn reach_m(of: &GroundBox) -> [f64; 2] {
    let margin_m = 2.0 * MARGIN * of.width_m;
    [of.length_m + margin_m, of.width_m + margin_m]
}

/// The two bins that a gradient belongs to, with its share of each; its direction is in half turns from the box's length,
/// -1 to 1.
pub(super) fn votes(strength: f32, direction: f32) -> [(usize, f32); 2] {
    let place = (direction + 1.0) * BINS as f32;
    let bin = place as usize;
    let share = place - bin as f32;
    [
        (bin % BINS, strength * (1.0 - share)),
        ((bin + 1) % BINS, strength * share),
    ]
}

/// What an image shows in a box; `None` where too little of it was seen.
pub fn describe(gradients: &Gradients, of: &GroundBox) -> Option<Vec<f32>> {
    let [long_m, wide_m] = reach_m(of);
    let (columns, rows) = (ALONG * SAMPLES, ACROSS * SAMPLES);
    let half_turns = (of.yaw / std::f64::consts::PI).rem_euclid(1.0) as f32;
    let mut cells = vec![0.0_f32; LENGTH];
    let mut seen = 0;
    let to_map = of.to_map();
    for column in 0..columns {
        let along = ((column as f64 + 0.5) / columns as f64 - 0.5) * long_m;
        for row in 0..rows {
            let left = ((row as f64 + 0.5) / rows as f64 - 0.5) * wide_m;
            let Some([strength, direction]) = gradients.near(to_map([along, left])) else {
                continue;
            };
            seen += 1;
            let cell = (column / SAMPLES * ACROSS + row / SAMPLES) * BINS;
            for (bin, share) in votes(strength, direction - half_turns) {
                cells[cell + bin] += share / (SAMPLES * SAMPLES) as f32;
            }
        }
    }
    if (seen as f64) < LEAST_SEEN * (columns * rows) as f64 {
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

/// What the roots of a box's histograms are divided by, from the sum of the histograms.
pub(super) fn norm(sum: f32) -> f32 {
    (sum + EMPTY * (ALONG * ACROSS) as f32).sqrt()
}
