//! What is around a pixel of a moving thing, as a forest sees it: which static class comes first in each of eight
//! directions, and how far away it is.
//!
//! Paper 3 (map update with an occlusion model) infers what is behind a thing from the areas around it. An ellipse around
//! a whole area says little where roads and kerbs run on behind a row of cars; what is beside the pixel says more. What was
//! seen behind things elsewhere tells how the two hang together: the ergodic assumption, with the surroundings as the
//! condition beside the dynamic class.

use super::classes::Kinds;
use crate::semantic_map::semantic_graph::{Labels, VOID};

/// Rows and columns to the next pixel in each direction.
const DIRECTIONS: [[isize; 2]; 8] = [
    [0, 1],
    [1, 1],
    [1, 0],
    [1, -1],
    [0, -1],
    [-1, -1],
    [-1, 0],
    [-1, 1],
];

/// Features of a pixel: its class, its row, then class and distance in each direction.
pub const DIMENSIONS: usize = 2 + 2 * DIRECTIONS.len();

/// The features of pixels, [`DIMENSIONS`] bytes each. Rows are in 256ths of the height; distances are 32 log2(1 + d), with d
/// in 1024ths of the width, to 250 of which they are told apart; where nothing static is in a direction, class and distance
/// are 255.
pub fn features(labels: &Labels<'_>, wraps: bool, kinds: &Kinds, pixels: &[usize]) -> Vec<u8> {
    let (width, height) = (labels.width as usize, labels.height as usize);
    if pixels.is_empty() {
        return Vec::new();
    }
    let mut values = vec![0; pixels.len() * DIMENSIONS];
    for (values, pixel) in values.chunks_exact_mut(DIMENSIONS).zip(pixels) {
        values[0] = labels.values[*pixel];
        values[1] = (pixel / width * 256 / height) as u8;
    }
    for (direction, step) in DIRECTIONS.into_iter().enumerate() {
        let first = first_static(labels, wraps, kinds, step);
        for (values, pixel) in values.chunks_exact_mut(DIMENSIONS).zip(pixels) {
            let (class, pixels) = first[*pixel];
            let away = f64::from(pixels) * 1024.0 / width as f64;
            let distance = match class {
                VOID => u8::MAX,
                _ => (32.0 * (1.0 + away).log2()).min(254.0) as u8,
            };
            values[2 + 2 * direction..][..2].copy_from_slice(&[class, distance]);
        }
    }
    values
}

/// Examples of what is behind moving things: features of pixels, [`DIMENSIONS`] bytes each, and the class of each.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Examples {
    /// Of all pixels, one after another.
    pub values: Vec<u8>,
    /// What is behind each.
    pub classes: Vec<u8>,
}

/// How far holes are moved, as shares of the width: 6 to 22 degrees of a panorama, where other cars hide the same street.
const MOVED: [f64; 6] = [
    -1.0 / 16.0,
    -1.0 / 32.0,
    -1.0 / 64.0,
    1.0 / 64.0,
    1.0 / 32.0,
    1.0 / 16.0,
];

/// What is left to infer is what nobody saw, amid what was seen. Examples have to be alike: the holes that are left in an
/// image are moved to the side, and what was seen behind moving things (by `before`) is asked for where a hole lies then.
/// At most so many, at equal steps.
pub fn examples(
    before: &[u8],
    after: &Labels<'_>,
    wraps: bool,
    kinds: &Kinds,
    most: usize,
) -> Examples {
    let width = after.width as usize;
    let was_seen =
        |pixel: &usize| kinds.is_dynamic(before[*pixel]) && kinds.is_static(after.values[*pixel]);
    let mut examples = Examples::default();
    if !(0..after.values.len()).any(|pixel| was_seen(&pixel)) {
        return examples;
    }
    for moved in MOVED {
        let moved = (moved * width as f64).round() as isize;
        let holed = with_holes(after, wraps, kinds, moved);
        let hidden = (0..holed.len()).filter(|pixel| kinds.is_dynamic(holed[*pixel]));
        let asked: Vec<usize> = hidden.filter(was_seen).collect();
        let step = asked.len().div_ceil((most / MOVED.len()).max(1)).max(1);
        let asked: Vec<usize> = asked.into_iter().step_by(step).collect();
        let image = Labels {
            values: &holed,
            ..*after
        };
        examples
            .values
            .extend(features(&image, wraps, kinds, &asked));
        let classes = asked.iter().map(|pixel| after.values[*pixel]);
        examples.classes.extend(classes);
    }
    examples
}

/// The labels with their holes, the pixels that still show what moves, a second time so many columns to the right.
fn with_holes(labels: &Labels<'_>, wraps: bool, kinds: &Kinds, moved: isize) -> Vec<u8> {
    let width = labels.width as usize;
    let mut holed = labels.values.to_vec();
    let rows = labels.values.chunks_exact(width);
    for (row, holed) in rows.zip(holed.chunks_exact_mut(width)) {
        for (column, class) in row.iter().enumerate() {
            let to = column.cast_signed() + moved;
            let to = match wraps {
                true => to.rem_euclid(width.cast_signed()),
                false => to,
            };
            let there = usize::try_from(to).ok().and_then(|to| holed.get_mut(to));
            if let Some(there) = there.filter(|_| kinds.is_dynamic(*class)) {
                *there = *class;
            }
        }
    }
    holed
}

/// For each pixel the first static one in a direction, and how many steps away it is; [`VOID`] where there is none.
fn first_static(
    labels: &Labels<'_>,
    wraps: bool,
    kinds: &Kinds,
    [down, right]: [isize; 2],
) -> Vec<(u8, u16)> {
    let (width, height) = (labels.width as usize, labels.height as usize);
    let mut found = vec![(VOID, 0_u16); width * height];
    // What a pixel sees follows from what its neighbour in that direction sees. Along a row that closes, it takes two turns.
    let turns = if down == 0 && wraps { 2 } else { 1 };
    for row in 0..height {
        let row = if down > 0 { height - 1 - row } else { row };
        for turned in 0..turns * width {
            let column = turned % width;
            let column = if right > 0 {
                width - 1 - column
            } else {
                column
            };
            let next_row = row.checked_add_signed(down).filter(|row| *row < height);
            let next = match column.checked_add_signed(right) {
                Some(column) if column < width => Some(column),
                _ if wraps => Some((column + width).wrapping_add_signed(right) % width),
                _ => None,
            };
            let (Some(next_row), Some(next)) = (next_row, next) else {
                continue;
            };
            let next = next_row * width + next;
            found[row * width + column] = match found[next] {
                _ if kinds.is_static(labels.values[next]) => (labels.values[next], 1),
                (VOID, _) => (VOID, 0),
                (class, steps) => (class, steps.saturating_add(1)),
            };
        }
    }
    found
}
