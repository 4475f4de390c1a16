//! The features of one image, by where they are.

use pulp::Arch;

use super::MatchLimits;
use super::brute_force::{Words, distance, words};
use crate::metric_map::features::{Descriptor, Feature, ImageFeatures};

/// Features per cell that are aimed at: fewer cost empty cells, more cost needless looks.
const PER_CELL: f64 = 2.0;

/// Finer or coarser grids than this gain nothing.
const MOST_CELLS: usize = 1 << 16;

/// No image is as large; what claims to lie farther out would only make the grid coarse.
const FARTHEST_PX: f64 = 1e6;

/// Answers "which feature near here looks like this?". Features keep the index that they have in
/// their [`ImageFeatures`]; those whose pixel is not finite, or millions of pixels away, are never
/// found.
#[derive(Debug, Clone)]
pub struct ImageIndex {
    origin: [f64; 2],
    cell_px: f64,
    columns: usize,
    rows: usize,
    /// Where each cell's features begin, and behind the last one's end.
    starts: Vec<u32>,
    /// Ordered by cell (row by row), then by feature.
    entries: Vec<Entry>,
    arch: Arch,
}

#[derive(Debug, Clone)]
struct Entry {
    feature: u32,
    pixel: [f64; 2],
    size_px: f64,
    words: Words,
}

/// The feature that looks most alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nearest {
    /// Its index in the image.
    pub feature: u32,
    /// Bits that differ, of 512.
    pub distance: u32,
    /// Distance of the next best that is another spot of the image: a second scale of the same
    /// corner does not count. `None` where there is no other.
    pub runner_up: Option<u32>,
}

impl Nearest {
    /// Whether it passes the limits.
    pub fn accepted(&self, limits: &MatchLimits) -> bool {
        limits.accept(self.distance, self.runner_up)
    }
}

impl ImageIndex {
    /// Indexes an image's features.
    pub fn new(image: &ImageFeatures) -> Self {
        let mut entries: Vec<Entry> = (0..)
            .zip(&image.features)
            .filter(|(_, feature)| feature.pixel.iter().all(|at| at.abs() < FARTHEST_PX))
            .map(Entry::new)
            .collect();
        let mut grid = Self::grid(&entries);
        entries.sort_by_cached_key(|entry| (grid.cell(entry.pixel), entry.feature));
        let cells: Vec<usize> = entries.iter().map(|entry| grid.cell(entry.pixel)).collect();
        grid.starts = (0..=grid.columns * grid.rows)
            .map(|cell| cells.partition_point(|of| *of < cell) as u32)
            .collect();
        grid.entries = entries;
        grid
    }

    fn grid(entries: &[Entry]) -> Self {
        let (mut low, mut high) = ([0.0_f64; 2], [0.0_f64; 2]);
        for (index, entry) in entries.iter().enumerate() {
            for axis in 0..2 {
                let at = entry.pixel[axis];
                low[axis] = if index == 0 { at } else { low[axis].min(at) };
                high[axis] = if index == 0 { at } else { high[axis].max(at) };
            }
        }
        let span = [high[0] - low[0], high[1] - low[1]].map(|span| span.max(1.0));
        let wanted = (entries.len() as f64 / PER_CELL).clamp(1.0, MOST_CELLS as f64);
        let longest = span[0].max(span[1]);
        let cell_px = (span[0] * span[1] / wanted).sqrt().max(longest / wanted);
        let cells = |span: f64| (span / cell_px) as usize + 1;
        Self {
            origin: low,
            cell_px,
            columns: cells(span[0]),
            rows: cells(span[1]),
            starts: Vec::new(),
            entries: Vec::new(),
            arch: Arch::new(),
        }
    }

    /// How many features can be found.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The features within `radius_px` of a pixel: index and squared distance (px²), row of cells
    /// by row of cells. None for a radius or a pixel that is not a number.
    pub fn within(&self, pixel: [f64; 2], radius_px: f64) -> impl Iterator<Item = (u32, f64)> + '_ {
        self.near(pixel, radius_px)
            .map(|(entry, squared)| (entry.feature, squared))
    }

    /// The feature within `radius_px` of a pixel whose descriptor is nearest.
    pub fn nearest(
        &self,
        pixel: [f64; 2],
        radius_px: f64,
        descriptor: &Descriptor,
    ) -> Option<Nearest> {
        self.nearest_where(pixel, radius_px, descriptor, |_, _| true)
    }

    /// As [`ImageIndex::nearest`], of the features that `accept` (given index and pixel) lets pass:
    /// an epipolar line, an occupied feature, a depth. Of equally near ones the lowest index wins.
    pub fn nearest_where(
        &self,
        pixel: [f64; 2],
        radius_px: f64,
        descriptor: &Descriptor,
        mut accept: impl FnMut(u32, [f64; 2]) -> bool,
    ) -> Option<Nearest> {
        let candidates: Vec<&Entry> = self
            .near(pixel, radius_px)
            .map(|(entry, _)| entry)
            .filter(|entry| accept(entry.feature, entry.pixel))
            .collect();
        let wanted = words(descriptor);
        self.arch.dispatch(|| best_two(&candidates, &wanted))
    }

    /// Entries within a radius, with their squared distances.
    fn near(&self, pixel: [f64; 2], radius_px: f64) -> impl Iterator<Item = (&Entry, f64)> + '_ {
        let squared_radius = radius_px * radius_px;
        let reach = |axis: usize, cells: usize| {
            let at = |x: f64| ((x - self.origin[axis]) / self.cell_px).floor();
            let (low, high) = (at(pixel[axis] - radius_px), at(pixel[axis] + radius_px));
            let any = radius_px >= 0.0 && high >= 0.0 && low < cells as f64;
            let end = if any {
                (high as usize).min(cells - 1) + 1
            } else {
                0
            };
            low.max(0.0) as usize..end
        };
        let columns = reach(0, self.columns);
        let rows = if columns.is_empty() {
            0..0
        } else {
            reach(1, self.rows)
        };
        rows.flat_map(move |row| {
            let first = row * self.columns + columns.start;
            let last = row * self.columns + columns.end;
            let (start, end) = (self.starts[first], self.starts[last]);
            &self.entries[start as usize..end as usize]
        })
        .map(move |entry| (entry, squared(entry.pixel, pixel)))
        .filter(move |(_, squared)| *squared <= squared_radius)
    }

    fn cell(&self, pixel: [f64; 2]) -> usize {
        let at = |axis: usize, cells: usize| {
            (((pixel[axis] - self.origin[axis]) / self.cell_px) as usize).min(cells - 1)
        };
        at(1, self.rows) * self.columns + at(0, self.columns)
    }
}

impl Entry {
    fn new((feature, found): (u32, &Feature)) -> Self {
        Self {
            feature,
            pixel: found.pixel,
            size_px: found.size_px,
            words: words(&found.descriptor),
        }
    }
}

fn squared(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

#[inline(always)]
fn best_two(candidates: &[&Entry], wanted: &Words) -> Option<Nearest> {
    let distances = candidates
        .iter()
        .map(|entry| distance(&entry.words, wanted));
    let distances: Vec<u32> = distances.collect();
    let of = |index: &usize| (distances[*index], candidates[*index].feature);
    let best = (0..candidates.len()).min_by_key(of)?;
    let entry = candidates[best];
    let elsewhere = |other: &&Entry| {
        squared(entry.pixel, other.pixel).sqrt() > 0.25 * entry.size_px.max(other.size_px)
    };
    let others = candidates.iter().zip(&distances);
    let runner_up = others
        .filter(|(other, _)| elsewhere(other))
        .map(|(_, distance)| *distance)
        .min();
    Some(Nearest {
        feature: entry.feature,
        distance: distances[best],
        runner_up,
    })
}
