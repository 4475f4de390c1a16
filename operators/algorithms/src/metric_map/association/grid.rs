//! Features of an image by place.

/// Side of a cell, pixels: a search circle covers a few cells, a cell holds a few features.
const CELL_PX: f64 = 8.0;

/// Finds the features of an image near a pixel.
#[derive(Debug, Clone, Default)]
pub struct FeatureGrid {
    columns: usize,
    rows: usize,
    /// Where each cell begins in `features`; one more than there are cells.
    starts: Vec<u32>,
    features: Vec<u32>,
}

impl FeatureGrid {
    /// Of the features at these pixels, in an image of this size; those outside the image are left out.
    pub fn new([width, height]: [u32; 2], pixels: impl Iterator<Item = [f64; 2]> + Clone) -> Self {
        let columns = (f64::from(width) / CELL_PX) as usize + 1;
        let rows = (f64::from(height) / CELL_PX) as usize + 1;
        let cell = |[u, v]: [f64; 2]| {
            let inside = |x: f64, size: u32| x >= -0.5 && x < f64::from(size) - 0.5;
            (inside(u, width) && inside(v, height)).then(|| place(v) * columns + place(u))
        };
        let mut starts = vec![0; columns * rows + 1];
        for cell in pixels.clone().filter_map(cell) {
            starts[cell + 1] += 1;
        }
        for at in 1..starts.len() {
            starts[at] += starts[at - 1];
        }
        let mut next = starts.clone();
        let mut features = vec![0; starts[columns * rows] as usize];
        for (feature, pixel) in pixels.enumerate() {
            if let Some(cell) = cell(pixel) {
                features[next[cell] as usize] = feature as u32;
                next[cell] += 1;
            }
        }
        Self {
            columns,
            rows,
            starts,
            features,
        }
    }

    /// The features of all cells that a circle touches, in a fixed order: a superset of those within it.
    pub fn near(&self, [u, v]: [f64; 2], radius_px: f64) -> impl Iterator<Item = u32> + '_ {
        let left = place(u - radius_px).min(self.columns);
        let right = (place(u + radius_px) + 1).min(self.columns);
        let top = place(v - radius_px).min(self.rows);
        let bottom = (place(v + radius_px) + 1).min(self.rows);
        (top..bottom).flat_map(move |row| {
            let cells = row * self.columns;
            let (from, to) = (self.starts[cells + left], self.starts[cells + right]);
            self.features[from as usize..to as usize].iter().copied()
        })
    }
}

fn place(x: f64) -> usize {
    // Saturates: what lies left of the image, or is no number, is in the first column.
    ((x + 0.5) / CELL_PX) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn finds_what_looking_at_every_feature_finds(
            pixels in prop::collection::vec((-9.0..120.0f64, -9.0..90.0f64), 0..80),
            at in (-20.0..140.0f64, -20.0..110.0f64),
            radius_px in 0.1..40.0f64,
        ) {
            let pixels: Vec<[f64; 2]> = pixels.into_iter().map(|(u, v)| [u, v]).collect();
            let grid = FeatureGrid::new([101, 77], pixels.iter().copied());
            let distance = |feature: usize| (pixels[feature][0] - at.0).hypot(pixels[feature][1] - at.1);
            let mut found: Vec<usize> = grid
                .near([at.0, at.1], radius_px)
                .map(|feature| feature as usize)
                .filter(|feature| distance(*feature) <= radius_px)
                .collect();
            found.sort_unstable();
            let inside = |[u, v]: [f64; 2]| (-0.5..100.5).contains(&u) && (-0.5..76.5).contains(&v);
            let naive: Vec<usize> = (0..pixels.len())
                .filter(|feature| inside(pixels[*feature]) && distance(*feature) <= radius_px)
                .collect();
            prop_assert_eq!(found, naive);
        }
    }
}
