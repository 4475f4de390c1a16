//! Costs of pixels from probabilities of cells.

use super::{CrfError, Unary};
use crate::semantic_map::class_scores::ScoresView;

/// A byte of 0 is a probability somewhere below half a unit: it counts as a quarter of one.
const LEAST: f32 = 0.25;

/// Between which two cells a pixel lies, and how near it is to the second.
struct Between {
    before: usize,
    after: usize,
    share: f32,
}

/// For each pixel along a side of `size` pixels.
fn between(size: usize, stride: usize, wraps: bool) -> Vec<Between> {
    let cells = size.div_ceil(stride);
    let place = |pixel: usize| {
        // Twice the distance from the centre of the first cell.
        let doubled = 2 * pixel as i64 + 1 - stride as i64;
        let cell = doubled.div_euclid(2 * stride as i64);
        let share = doubled.rem_euclid(2 * stride as i64) as f32 / (2 * stride) as f32;
        let inside = |cell: i64| match wraps {
            true => cell.rem_euclid(cells as i64) as usize,
            false => cell.clamp(0, cells as i64 - 1) as usize,
        };
        Between {
            before: inside(cell),
            after: inside(cell + 1),
            share,
        }
    };
    (0..size).map(place).collect()
}

impl Unary {
    /// Of cells, from their probabilities.
    ///
    /// # Errors
    /// As [`Unary::new`].
    pub fn of_cells(scores: &ScoresView<'_>) -> Result<Self, CrfError> {
        let table: [f32; 256] = std::array::from_fn(|byte| cost(byte as f32));
        let costs = scores.probabilities().iter();
        let costs = costs.map(|byte| table[usize::from(*byte)]);
        Self::new(scores.classes(), costs.collect())
    }

    /// Of pixels, from probabilities of cells, bilinearly between their centres. With `wraps`, the last column of cells is next to
    /// the first one.
    ///
    /// # Errors
    /// As [`Unary::new`].
    pub fn from_scores(scores: &ScoresView<'_>, wraps: bool) -> Result<Self, CrfError> {
        if scores.stride() == 1 {
            return Self::of_cells(scores);
        }
        let classes = scores.classes();
        let [width, height] = scores.size();
        let along_x = between(width, scores.stride(), wraps);
        let mut row = vec![0.0; scores.columns() * classes];
        let mut costs = Vec::with_capacity(width * height * classes);
        for Between {
            before,
            after,
            share,
        } in between(height, scores.stride(), false)
        {
            let pairs = scores.row(before).iter().zip(scores.row(after));
            for (value, (before, after)) in row.iter_mut().zip(pairs) {
                *value = f32::from(*before) * (1.0 - share) + f32::from(*after) * share;
            }
            for Between {
                before,
                after,
                share,
            } in &along_x
            {
                let before = &row[before * classes..(before + 1) * classes];
                let after = &row[after * classes..(after + 1) * classes];
                let values = before.iter().zip(after);
                costs.extend(values.map(|(a, b)| cost(a * (1.0 - share) + b * share)));
            }
        }
        Self::new(classes, costs)
    }
}

/// Of a probability in units of 1/255.
fn cost(units: f32) -> f32 {
    (255.0 / units.max(LEAST)).ln()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn cells_are_interpolated_between_their_centres() {
        // Cells of 2 px: centres at 0.5, 2.5 and 4.5 (cut off at 4).
        let bytes = [40, 80, 120];
        let scores = ScoresView::new([5, 1], 2, 1, &bytes).unwrap();
        let probabilities = |wraps| -> Vec<f32> {
            let unary = Unary::from_scores(&scores, wraps).unwrap();
            unary
                .costs
                .iter()
                .map(|cost| (255.0 * (-cost).exp()).round())
                .collect()
        };
        assert_eq!(probabilities(false), [40.0, 50.0, 70.0, 90.0, 110.0]);
        assert_eq!(probabilities(true), [60.0, 50.0, 70.0, 90.0, 110.0]);
    }

    proptest! {
        #[test]
        fn equal_cells_give_equal_pixels(
            width in 1..20u32, height in 1..20u32, stride in 1..7u32, byte: u8, wraps: bool,
        ) {
            let cells = (width.div_ceil(stride) * height.div_ceil(stride)) as usize;
            let bytes = vec![byte; 3 * cells];
            let scores = ScoresView::new([width, height], stride, 3, &bytes).unwrap();
            let unary = Unary::from_scores(&scores, wraps).unwrap();
            prop_assert_eq!(unary.pixels(), (width * height) as usize);
            prop_assert!(unary.costs.iter().all(|found| (found - cost(f32::from(byte))).abs() < 1e-5));
        }
    }
}
