//! Probabilities of classes over an image, in cells.

/// Probabilities of the classes in each cell of an image, `1/255` per unit: cell after cell, row by row, classes
/// innermost. Cell (i, j) is of the pixels `[i, i + 1) · stride` by `[j, j + 1) · stride`; the last ones may be cut off
/// by the image's border.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoresView<'a> {
    width: usize,
    height: usize,
    stride: usize,
    classes: usize,
    probabilities: &'a [u8],
}

impl<'a> ScoresView<'a> {
    /// A view; `None` where there are no pixels, cells or classes, or another number of bytes than these ask for.
    pub fn new(
        [width_px, height_px]: [u32; 2],
        stride_px: u32,
        classes: usize,
        probabilities: &'a [u8],
    ) -> Option<Self> {
        if width_px == 0 || height_px == 0 || stride_px == 0 || classes == 0 {
            return None;
        }
        let view = Self {
            width: width_px as usize,
            height: height_px as usize,
            stride: stride_px as usize,
            classes,
            probabilities,
        };
        let bytes = view
            .columns()
            .checked_mul(view.rows())?
            .checked_mul(classes)?;
        (bytes == probabilities.len()).then_some(view)
    }

    /// Width and height of the image (px).
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Side of a cell (px).
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Number of classes.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// Cells in a row.
    pub fn columns(&self) -> usize {
        self.width.div_ceil(self.stride)
    }

    /// Rows of cells.
    pub fn rows(&self) -> usize {
        self.height.div_ceil(self.stride)
    }

    /// All cells.
    pub fn probabilities(&self) -> &'a [u8] {
        self.probabilities
    }

    /// The classes of a cell, by its number row by row; empty where there is no such cell.
    pub fn cell(&self, cell: usize) -> &'a [u8] {
        let first = cell.saturating_mul(self.classes);
        let of_cell = first..first.saturating_add(self.classes);
        self.probabilities.get(of_cell).unwrap_or_default()
    }

    /// The cells of one row.
    pub fn row(&self, row: usize) -> &'a [u8] {
        let bytes = self.columns() * self.classes;
        &self.probabilities[row * bytes..(row + 1) * bytes]
    }

    /// The pixel at the centre of a cell, as far as the cell is in the image: `[u, v]`, which may lie between pixels.
    pub fn centre(&self, cell: usize) -> [f64; 2] {
        let middle = |index: usize, size: usize| {
            let (first, end) = (index * self.stride, ((index + 1) * self.stride).min(size));
            0.5 * (first as f64 + end as f64 - 1.0)
        };
        let columns = self.columns();
        [
            middle(cell % columns, self.width),
            middle(cell / columns, self.height),
        ]
    }

    /// The cell that a pixel is in; `None` out of the image.
    pub fn at(&self, [u, v]: [f64; 2]) -> Option<usize> {
        let index = |x: f64, size: usize| {
            let inside = x >= -0.5 && x < size as f64 - 0.5;
            inside.then(|| (x + 0.5) as usize / self.stride)
        };
        let (column, row) = (index(u, self.width)?, index(v, self.height)?);
        Some(row * self.columns() + column)
    }
}

/// Labels as probabilities, a byte for each pixel and class: that of a pixel's label is `confidence`, every other one an
/// equal part of the rest. A label that is no class may be any.
pub fn of_labels(labels: &[u8], classes: usize, confidence: f64) -> Vec<u8> {
    let unit = |probability: f64| (255.0 * probability).round() as u8;
    let right = unit(confidence);
    let wrong = unit((1.0 - confidence) / (classes.max(2) - 1) as f64);
    let unknown = unit(1.0 / classes as f64);
    let mut probabilities = Vec::with_capacity(classes * labels.len());
    for label in labels {
        let label = usize::from(*label);
        let others = if label < classes { wrong } else { unknown };
        probabilities.resize(probabilities.len() + classes, others);
        if label < classes {
            let at = probabilities.len() - classes + label;
            probabilities[at] = right;
        }
    }
    probabilities
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_is_as_probable_as_it_is_trusted() {
        assert_eq!(
            of_labels(&[0, 2, 255], 3, 0.8),
            [204, 25, 25, 25, 25, 204, 85, 85, 85]
        );
        assert_eq!(of_labels(&[0, 1], 1, 0.5), [128, 255]);
        assert!(of_labels(&[0, 1], 0, 0.5).is_empty());
    }
}
