//! What one image shows of the ground: a rectangle of cells, at one zoom.

use super::channels::Channels;

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
    /// Row by row from the south, grey values, or red, green and blue of each cell; of any value where the weight is 0.
    pub values: Vec<u8>,
    /// Weights, one for each cell, likewise; 0 where the image does not show the cell.
    pub weights: Vec<u8>,
}

impl Patch {
    /// Whether there are as many weights as cells, and one or three values for each.
    pub fn is_sound(&self) -> bool {
        let cells = self.width.checked_mul(self.height);
        let values = Some(self.values.len());
        let in_colour = cells.and_then(|cells| cells.checked_mul(Channels::Colour.count()));
        cells == Some(self.weights.len()) && (cells == values || in_colour == values)
    }

    /// What is known of each cell.
    pub fn channels(&self) -> Channels {
        if self.values.len() == self.weights.len() {
            Channels::Grey
        } else {
            Channels::Colour
        }
    }

    /// The same at the next zoom. A cell gets the weighted mean of the (up to) four that it covers, and a quarter of
    /// their weight, rounded up. So an image adds one look of at most full weight to a cell at every zoom, and
    /// coarse tiles can hold as many images as fine ones.
    #[must_use]
    pub fn halved(&self) -> Self {
        match self.channels() {
            Channels::Grey => self.halved_of::<1>(),
            Channels::Colour => self.halved_of::<3>(),
        }
    }

    /// [`Self::halved`], of so many values a cell.
    fn halved_of<const COUNT: usize>(&self) -> Self {
        let (column, row) = (self.column.div_euclid(2), self.row.div_euclid(2));
        let shift = [self.column - 2 * column, self.row - 2 * row].map(|odd| odd as usize);
        let (width, height) = (
            (self.width + shift[0]).div_ceil(2),
            (self.height + shift[1]).div_ceil(2),
        );
        let (values, _) = self.values.as_chunks::<COUNT>();
        let mut sums = vec![([0_u32; COUNT], 0_u32); width * height];
        for fine in 0..self.height {
            let cells = fine * self.width..(fine + 1) * self.width;
            let coarse = &mut sums[(fine + shift[1]) / 2 * width..][..width];
            let looks = values[cells.clone()].iter().zip(&self.weights[cells]);
            for (at, (look, weight)) in looks.enumerate() {
                let weight = u32::from(*weight);
                let (sums, weights) = &mut coarse[(at + shift[0]) / 2];
                for (sum, value) in sums.iter_mut().zip(look) {
                    *sum += u32::from(*value) * weight;
                }
                *weights += weight;
            }
        }
        let mean = |(sums, weight): &([u32; COUNT], u32)| {
            sums.map(|sum| ((sum + weight / 2).checked_div(*weight)).unwrap_or(0) as u8)
        };
        let quarter = |(_, weight): &([u32; COUNT], u32)| weight.div_ceil(4) as u8;
        let means: Vec<[u8; COUNT]> = sums.iter().map(mean).collect();
        Self {
            column,
            row,
            width,
            height,
            values: means.into_flattened(),
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

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn each_colour_is_halved_as_grey_is(
            red in patch(-3, 2, 5, 4), green in patch(-3, 2, 5, 4), blue in patch(-3, 2, 5, 4)
        ) {
            let weights = &red.weights;
            let of = |channel: &Patch| Patch { weights: weights.clone(), ..channel.clone() };
            let channels = [&red, &green, &blue].map(of);
            let cells = 0..weights.len();
            let values = cells.flat_map(|cell| channels.each_ref().map(|one| one.values[cell]));
            let colour = Patch { values: values.collect(), ..channels[0].clone() };
            let half = colour.halved();
            prop_assert!(half.is_sound());
            prop_assert_eq!(half.channels(), Channels::Colour);
            for (at, channel) in channels.iter().enumerate() {
                let alone = channel.halved();
                let values: Vec<u8> = half.values.iter().skip(at).step_by(3).copied().collect();
                prop_assert_eq!((values, &half.weights), (alone.values, &alone.weights));
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
        assert!(patch(2, 4).is_sound() && patch(2, 12).is_sound());
        assert!(!patch(2, 3).is_sound() && !patch(2, 8).is_sound() && !patch(3, 4).is_sound());
        assert!(!patch(usize::MAX, 4).is_sound());
    }
}
