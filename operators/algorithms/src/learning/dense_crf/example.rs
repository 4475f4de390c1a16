//! Images whose classes are known, as kernels are tried on them.

use super::{ColourView, Confusion, CrfError, Kernels, MeanField, RandomField, Unary, fits};

/// An image whose classes are known, with costs from a classifier that has not learnt from it. It is labelled cell by
/// cell, as nothing finer was said of it: in cells of two by two pixels that is a quarter of the work.
#[derive(Debug, Clone)]
pub struct Example {
    /// Columns and rows of cells.
    cells: [usize; 2],
    /// The mean colour of each cell, row by row.
    colours: Vec<[u8; 3]>,
    /// What cells are by themselves.
    unary: Unary,
    cell_px: usize,
    width_px: usize,
    wraps: bool,
    truth: Vec<u8>,
}

impl Example {
    /// Of an image in cells of so many pixels a side (the last ones may be cut off by its border), what each cell is by
    /// itself, row by row, and the classes of its pixels, row by row; values that are no class (255) are not scored. With
    /// `wraps`, its last column is next to its first one, as in a full panorama.
    ///
    /// # Errors
    /// [`CrfError::Size`] for costs of other than all cells, or classes of other than all pixels.
    pub fn new(
        image: &ColourView<'_>,
        cell_px: u32,
        unary: Unary,
        wraps: bool,
        truth: Vec<u8>,
    ) -> Result<Self, CrfError> {
        let cell_px = cell_px.max(1) as usize;
        let cells = [image.width(), image.height()].map(|size| size.div_ceil(cell_px));
        let [columns, rows] = cells;
        fits(unary.classes() * columns * rows, unary.costs.len())?;
        fits(image.pixels().len(), truth.len())?;
        let places = (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
        Ok(Self {
            cells,
            colours: places.map(|cell| mean(image, cell_px, cell)).collect(),
            unary,
            cell_px,
            width_px: image.width(),
            wraps,
            truth,
        })
    }

    pub(super) fn classes(&self) -> usize {
        self.unary.classes()
    }

    /// What kernels of the image find in it: each pixel is what its cell is.
    pub(super) fn labelled(
        &self,
        kernels: &Kernels,
        MeanField { iterations }: MeanField,
        mut confusion: Confusion,
    ) -> Result<Confusion, CrfError> {
        let [columns, rows] = self.cells.map(|cells| cells as u32);
        let image = ColourView::new(columns, rows, self.colours.as_flattened());
        let image = image.ok_or(CrfError::Size {
            expected: 1,
            found: 0,
        })?;
        let field = RandomField::new(&image, &kernels.in_cells(self.cell_px), self.wraps)?;
        let found = field.infer(&self.unary, iterations)?.labels();
        let of_row = |row: usize| &found[row / self.cell_px * self.cells[0]..];
        for (row, truth) in self.truth.chunks_exact(self.width_px).enumerate() {
            let of_cells = truth.chunks(self.cell_px).zip(of_row(row));
            of_cells.for_each(|(truth, found)| confusion.add_as(truth, *found));
        }
        Ok(confusion)
    }
}

/// The mean colour of a cell, as far as it is in the image.
fn mean(image: &ColourView<'_>, cell_px: usize, [column, row]: [usize; 2]) -> [u8; 3] {
    let inside = |cell: usize, size: usize| cell * cell_px..((cell + 1) * cell_px).min(size);
    let (columns, rows) = (inside(column, image.width()), inside(row, image.height()));
    let pixels = (columns.len() * rows.len()) as u64;
    let mut sums = [pixels / 2; 3];
    for row in rows {
        let of_row = &image.pixels()[row * image.width()..][columns.clone()];
        for (channel, value) in of_row.iter().flat_map(|pixel| pixel.iter().enumerate()) {
            sums[channel] += u64::from(*value);
        }
    }
    sums.map(|sum| (sum / pixels) as u8)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use proptest::prelude::*;

    use super::*;
    use crate::learning::dense_crf::tests::of_labels;

    const KERNELS: Kernels = Kernels {
        appearance_px: 6.0,
        appearance_colour: 20.0,
        appearance_weight: 4.0,
        smoothness_px: 2.0,
        smoothness_weight: 1.0,
    };

    /// Classes of cells, row by row, and their colours.
    fn painted(seed: u32, cells: usize) -> (Vec<u8>, Vec<u8>) {
        let random = |i: usize| ((i as u32 ^ seed).wrapping_mul(2_654_435_761) >> 9) as u8;
        let labels: Vec<u8> = (0..cells).map(|i| random(i) % 3).collect();
        let colour = |i: usize| 60 * labels[i / 3] + random(i + cells) % 40;
        let colours = (0..3 * cells).map(colour).collect();
        (labels, colours)
    }

    fn labelled(example: &Example, kernels: &Kernels) -> Confusion {
        let none = Confusion::new(example.classes());
        let found = example.labelled(kernels, MeanField::default(), none);
        found.unwrap()
    }

    proptest! {
        /// An image in cells is the image of its cells, with kernels as much narrower, and every pixel counts.
        #[test]
        fn cells_are_labelled_as_pixels_of_a_smaller_image(
            columns in 1..9_usize, rows in 1..9_usize, cell in 1..5_usize, cut in 0..4_usize, seed: u32,
        ) {
            let cut = cut % cell;
            let [width, height] = [columns * cell - cut, rows * cell - cut];
            let (labels, colours) = painted(seed, columns * rows);
            let cell_of = |i: usize| i / width / cell * columns + i % width / cell;
            let pixels: Vec<u8> = (0..width * height).flat_map(|i| [0, 1, 2].map(|c| colours[3 * cell_of(i) + c])).collect();
            let truth: Vec<u8> = (0..width * height).map(|i| labels[cell_of(i)]).collect();
            let (said, _) = painted(seed.wrapping_add(1), columns * rows);
            let unary = of_labels(3, &said, 0.5);
            let image = ColourView::new(width as u32, height as u32, &pixels).unwrap();
            let example = Example::new(&image, cell as u32, unary.clone(), false, truth.clone()).unwrap();
            let found = labelled(&example, &KERNELS);
            let small = ColourView::new(columns as u32, rows as u32, &colours).unwrap();
            let field = RandomField::new(&small, &KERNELS.in_cells(cell), false).unwrap();
            let of_cells = field.infer(&unary, MeanField::default().iterations).unwrap().labels();
            let mut expected = Confusion::new(3);
            let of_pixels: Vec<u8> = (0..width * height).map(|i| of_cells[cell_of(i)]).collect();
            expected.add(&truth, &of_pixels);
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn a_cell_has_the_mean_colour_of_its_pixels_in_the_image() {
        let bytes = [0, 10, 20, 2, 11, 20, 90, 0, 1];
        let image = ColourView::new(3, 1, &bytes).unwrap();
        assert_eq!(mean(&image, 2, [0, 0]), [1, 11, 20]);
        assert_eq!(mean(&image, 2, [1, 0]), [90, 0, 1]);
    }

    #[test]
    fn costs_and_truth_are_of_all_cells_and_pixels() {
        let bytes = [0; 15];
        let image = ColourView::new(5, 1, &bytes).unwrap();
        let example = |costs: usize, truth: usize| {
            let unary = of_labels(2, &vec![0; costs], 0.7);
            Example::new(&image, 2, unary, false, vec![0; truth]).map(|_| ())
        };
        assert_eq!(example(3, 5), Ok(()));
        let missized = |expected, found| Err(CrfError::Size { expected, found });
        assert_eq!(example(5, 5), missized(6, 10));
        assert_eq!(example(3, 3), missized(5, 3));
    }
}
