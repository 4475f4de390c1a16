//! The floor as small squares, in each of which gradients are sorted by direction, once for all headings.
//!
//! Directions lie as far apart as the headings that are tried: what is in a bin of a box's histogram at one heading is in the
//! next direction of the square at the next heading.

use rayon::prelude::*;

use super::description::{BINS, votes};
use super::overhead::Gradients;

/// Headings over half a turn: at 7.5 degrees a box 5 m long is off by 16 cm at its ends at most, a third of a cell.
pub(super) const HEADINGS: usize = 24;
/// Headings from one bin of a histogram to the next.
const BIN: usize = HEADINGS / BINS;

/// Squares of one size.
pub(super) struct Squares {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) side_m: f64,
    pub(super) west_m: f64,
    pub(super) north_m: f64,
    /// Row by row from the north.
    squares: Vec<Square>,
}

/// What is in a square.
pub(super) struct Square {
    /// Mean strength by direction, over half a turn from east.
    towards: [f32; HEADINGS],
    /// The part of it that was seen.
    pub(super) seen: f32,
}

impl Square {
    /// The histogram of the gradients at a heading, which is in parts of half a turn.
    pub(super) fn histogram(&self, heading: usize) -> [f32; BINS] {
        std::array::from_fn(|bin| self.towards[(heading + BIN * bin) % HEADINGS])
    }
}

impl Squares {
    /// Squares so many cells wide.
    pub(super) fn new(gradients: &Gradients, side: usize) -> Self {
        let columns = gradients.columns.div_ceil(side);
        let rows = gradients.rows.div_ceil(side);
        let squares = (0..rows).into_par_iter().flat_map_iter(|row| {
            (0..columns).map(move |column| square(gradients, [column * side, row * side], side))
        });
        Self {
            columns,
            rows,
            side_m: side as f64 * gradients.cell_m,
            west_m: gradients.west_m,
            north_m: gradients.north_m,
            squares: squares.collect(),
        }
    }

    /// The square about a point of the map; `None` outside.
    pub(super) fn near(&self, [x, y]: [f64; 2]) -> Option<&Square> {
        let column = (x - self.west_m) / self.side_m;
        let row = (self.north_m - y) / self.side_m;
        let is_inside =
            column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64;
        is_inside.then(|| &self.squares[row as usize * self.columns + column as usize])
    }
}

/// The square from this column and row of cells on.
fn square(gradients: &Gradients, [column, row]: [usize; 2], side: usize) -> Square {
    let mut square = Square {
        towards: [0.0; HEADINGS],
        seen: 0.0,
    };
    let part = 1.0 / (side * side) as f32;
    for row in row..(row + side).min(gradients.rows) {
        for column in column..(column + side).min(gradients.columns) {
            let Some([strength, direction]) = gradients.cell(column, row) else {
                continue;
            };
            square.seen += part;
            for heading in 0..BIN {
                let turned = direction - heading as f32 / HEADINGS as f32;
                for (bin, share) in votes(strength * part, turned) {
                    square.towards[heading + BIN * bin] += share;
                }
            }
        }
    }
    square
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::overhead::GradientCell;
    use super::*;

    /// Cells of 0.1 m with all directions, of some of which nothing was seen.
    fn gradients() -> Gradients {
        let cell = |at: usize| -> GradientCell { [if at % 7 == 0 { 255 } else { 100 }, at as u8] };
        Gradients::new(0.1, 16, [3.0, 5.0], (0..256).map(cell).collect())
    }

    #[test]
    fn histograms_of_squares_are_those_of_their_cells_at_every_heading() {
        let gradients = gradients();
        for side in [1, 3] {
            let squares = Squares::new(&gradients, side);
            let part = 1.0 / (side * side) as f32;
            for (column, row, heading) in [(0, 0, 0), (1, 2, 5), (4, 3, 17), (5, 5, 23)] {
                let middle = |at: usize| (at as f64 + 0.5) * squares.side_m;
                let at = [3.0 + middle(column), 5.0 - middle(row)];
                let found = squares.near(at).unwrap();
                let mut expected = [0.0; BINS];
                let mut seen = 0.0;
                for cell in 0..side * side {
                    let at = [column * side + cell % side, row * side + cell / side];
                    let inside = at.iter().all(|at| *at < 16);
                    let cell = inside.then(|| gradients.cell(at[0], at[1])).flatten();
                    let Some([strength, direction]) = cell else {
                        continue;
                    };
                    seen += part;
                    let turned = direction - heading as f32 / HEADINGS as f32;
                    for (bin, share) in votes(strength, turned) {
                        expected[bin] += share * part;
                    }
                }
                let found_bins = found.histogram(heading);
                let near = |(one, other): (&f32, &f32)| (one - other).abs() < 1e-4;
                assert!(found_bins.iter().zip(&expected).all(near));
                assert!((found.seen - seen).abs() < 1e-5);
            }
        }
        assert!(Squares::new(&gradients, 3).near([2.9, 4.0]).is_none());
    }
}
