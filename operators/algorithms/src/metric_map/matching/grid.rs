//! The features of one image by where they are.

/// Features per cell that are aimed at: fewer cost empty cells, more cost needless looks.
const PER_CELL: f64 = 2.0;

/// Finer or coarser grids than this gain nothing.
const MOST_CELLS: usize = 1 << 16;

/// No image is as large; what claims to lie farther out would only make the grid coarse.
const FARTHEST_PX: f64 = 1e6;

/// Finds the features of an image near a pixel. A feature is named by its index in the image; those
/// whose pixel is not finite, or millions of pixels away, are never found.
#[derive(Debug, Clone)]
pub struct FeatureGrid {
    origin: [f64; 2],
    cell_px: f64,
    columns: usize,
    rows: usize,
    /// Where each cell's features begin, and behind the last one's end.
    starts: Vec<u32>,
    /// Ordered by cell (row by row), then by feature.
    features: Vec<(u32, [f64; 2])>,
}

impl FeatureGrid {
    /// Of the features at these pixels.
    pub fn new(pixels: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let mut features: Vec<(u32, [f64; 2])> = (0..)
            .zip(pixels)
            .filter(|(_, pixel)| pixel.iter().all(|at| at.abs() < FARTHEST_PX))
            .collect();
        let mut grid = Self::over(&features);
        features.sort_by_cached_key(|(feature, pixel)| (grid.cell(*pixel), *feature));
        let cells: Vec<usize> = features
            .iter()
            .map(|(_, pixel)| grid.cell(*pixel))
            .collect();
        grid.starts = (0..=grid.columns * grid.rows)
            .map(|cell| cells.partition_point(|of| *of < cell) as u32)
            .collect();
        grid.features = features;
        grid
    }

    /// An empty grid for these features.
    fn over(features: &[(u32, [f64; 2])]) -> Self {
        let (mut low, mut high) = ([0.0_f64; 2], [0.0_f64; 2]);
        for (index, (_, pixel)) in features.iter().enumerate() {
            for axis in 0..2 {
                let at = pixel[axis];
                low[axis] = if index == 0 { at } else { low[axis].min(at) };
                high[axis] = if index == 0 { at } else { high[axis].max(at) };
            }
        }
        let span = [high[0] - low[0], high[1] - low[1]].map(|span| span.max(1.0));
        let wanted = (features.len() as f64 / PER_CELL).clamp(1.0, MOST_CELLS as f64);
        let longest = span[0].max(span[1]);
        let cell_px = (span[0] * span[1] / wanted).sqrt().max(longest / wanted);
        let cells = |span: f64| (span / cell_px) as usize + 1;
        Self {
            origin: low,
            cell_px,
            columns: cells(span[0]),
            rows: cells(span[1]),
            starts: Vec::new(),
            features: Vec::new(),
        }
    }

    /// The features within `radius_px` of a pixel, row of cells by row of cells. None for a radius
    /// or a pixel that is not a number.
    pub fn near(&self, pixel: [f64; 2], radius_px: f64) -> impl Iterator<Item = u32> + '_ {
        let squared_radius = radius_px * radius_px;
        let columns = self.reach(0, self.columns, pixel, radius_px);
        let rows = if columns.is_empty() {
            0..0
        } else {
            self.reach(1, self.rows, pixel, radius_px)
        };
        rows.flat_map(move |row| {
            let first = row * self.columns + columns.start;
            let last = row * self.columns + columns.end;
            let (start, end) = (self.starts[first], self.starts[last]);
            &self.features[start as usize..end as usize]
        })
        .filter(move |(_, at)| squared_distance(*at, pixel) <= squared_radius)
        .map(|(feature, _)| *feature)
    }

    /// The columns or rows of cells, as the axis says, that a circle touches.
    fn reach(
        &self,
        axis: usize,
        cells: usize,
        pixel: [f64; 2],
        radius_px: f64,
    ) -> std::ops::Range<usize> {
        let at = |x: f64| ((x - self.origin[axis]) / self.cell_px).floor();
        let (low, high) = (at(pixel[axis] - radius_px), at(pixel[axis] + radius_px));
        let any = radius_px >= 0.0 && high >= 0.0 && low < cells as f64;
        let end = if any {
            (high as usize).min(cells - 1) + 1
        } else {
            0
        };
        low.max(0.0) as usize..end
    }

    fn cell(&self, pixel: [f64; 2]) -> usize {
        let at = |axis: usize, cells: usize| {
            (((pixel[axis] - self.origin[axis]) / self.cell_px) as usize).min(cells - 1)
        };
        at(1, self.rows) * self.columns + at(0, self.columns)
    }
}

pub(in crate::metric_map) fn squared_distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}
