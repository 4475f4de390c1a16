//! What one image shows of the ground: a rectangle of cells, at one zoom.

/// Values and weights of a rectangle of cells. Cells are numbered as in [`super::tiles`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Patch {
    /// Column of the westernmost cells.
    pub column: i64,
    /// Row of the southernmost cells.
    pub row: i64,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Grey values, row by row from the south; of any value where the weight is 0.
    pub values: Vec<u8>,
    /// Weights, likewise; 0 where the image does not show the cell.
    pub weights: Vec<u8>,
}

impl Patch {
    /// Whether there are as many values and weights as cells.
    pub fn is_sound(&self) -> bool {
        let cells = self.width.checked_mul(self.height);
        cells == Some(self.values.len()) && cells == Some(self.weights.len())
    }

    /// The same at the next zoom. A cell gets the weighted mean of the (up to) four that it covers, and a quarter of
    /// their weight, rounded up. So an image adds one look of at most full weight to a cell at every zoom, and
    /// coarse tiles can hold as many images as fine ones.
    #[must_use]
    pub fn halved(&self) -> Self {
        let (column, row) = (self.column.div_euclid(2), self.row.div_euclid(2));
        let shift = [self.column - 2 * column, self.row - 2 * row].map(|odd| odd as usize);
        let (width, height) = (
            (self.width + shift[0]).div_ceil(2),
            (self.height + shift[1]).div_ceil(2),
        );
        let mut sums = vec![(0_u32, 0_u32); width * height];
        for fine in 0..self.height {
            let cells = fine * self.width..(fine + 1) * self.width;
            let coarse = &mut sums[(fine + shift[1]) / 2 * width..][..width];
            let looks = self.values[cells.clone()].iter().zip(&self.weights[cells]);
            for (at, (value, weight)) in looks.enumerate() {
                let (value, weight) = (u32::from(*value), u32::from(*weight));
                let sum = &mut coarse[(at + shift[0]) / 2];
                *sum = (sum.0 + value * weight, sum.1 + weight);
            }
        }
        let mean = |(sum, weight): &(u32, u32)| {
            ((sum + weight / 2).checked_div(*weight)).unwrap_or(0) as u8
        };
        let quarter = |(_, weight): &(u32, u32)| weight.div_ceil(4) as u8;
        Self {
            column,
            row,
            width,
            height,
            values: sums.iter().map(mean).collect(),
            weights: sums.iter().map(quarter).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    fn patch(column: i64, row: i64, width: usize, height: usize) -> impl Strategy<Value = Patch> {
        let cells = || prop::collection::vec(any::<u8>(), width * height);
        (cells(), cells()).prop_map(move |(values, weights)| Patch {
            column,
            row,
            width,
            height,
            values,
            weights,
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn halving_is_the_weighted_mean_of_the_cells_below(
            patch in (-5..5_i64, -5..5_i64, 1..9_usize, 1..9_usize)
                .prop_flat_map(|(column, row, width, height)| patch(column, row, width, height))
        ) {
            let half = patch.halved();
            prop_assert!(half.is_sound());
            for j in -4..8_i64 {
                for i in -4..8_i64 {
                    let cell = |patch: &Patch, i: i64, j: i64| {
                        let (c, r) = (i - patch.column, j - patch.row);
                        let inside = c >= 0 && r >= 0 && c < patch.width as i64 && r < patch.height as i64;
                        let at = r * patch.width as i64 + c;
                        if inside { (patch.values[at as usize], patch.weights[at as usize]) } else { (0, 0) }
                    };
                    let below = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(a, b)| cell(&patch, 2 * i + a, 2 * j + b));
                    let weight: f64 = below.iter().map(|(_, w)| f64::from(*w)).sum();
                    let sum: f64 = below.iter().map(|(v, w)| f64::from(*v) * f64::from(*w)).sum();
                    let (value, found) = cell(&half, i, j);
                    prop_assert_eq!(f64::from(found), (weight / 4.0).ceil());
                    prop_assert!(weight == 0.0 || (f64::from(value) - sum / weight).abs() <= 0.5);
                }
            }
        }
    }

    #[test]
    fn a_patch_has_as_many_bytes_as_cells() {
        let patch = |width: usize, bytes: usize| Patch {
            column: 0,
            row: 0,
            width,
            height: 2,
            values: vec![0; bytes],
            weights: vec![0; 4],
        };
        assert!(patch(2, 4).is_sound());
        assert!(!patch(2, 3).is_sound() && !patch(3, 4).is_sound());
        assert!(!patch(usize::MAX, 4).is_sound());
    }
}
