//! A vehicle's own body in the images of its camera: structure that stays where it is while the vehicle drives.
//!
//! ```text
//!  images metres apart ─► gradients of a coarse grid ─► cells whose gradient keeps its direction ─► closed
//!                                                                                                     │
//!            mask ◄─ and what they cut off from the scenery ◄─ those joined to the image's border ◄───┘
//! ```
//!
//! That a pixel keeps its value says little: sky does, and asphalt. An edge that keeps its place and direction for
//! hundreds of metres says much: what moves past shows each cell now this edge, now that one, and none most of the time.
//! Paint reflects what moves past; so the inside of a body is found by its outline, not by itself. A body reaches into
//! the image from its border. What the outline cuts off from the rest is masked too, unless it is much of the image: the
//! outline of a body does not pass through its middle, but a horizon might. The black outside of a fisheye's image circle
//! is found like a body, and is as little scenery.
//!
//! The doubt goes to the scenery: an outline that shows only at times, or has a gap, masks its own cells and no more.

use rayon::prelude::*;

use crate::solving::parts::parts;

/// Cells across an image: fine enough for a feature's neighbourhood, coarse enough that shaking does not matter.
const COLUMNS: u32 = 200;

/// Gradients below this (grey values per cell) are noise.
const FAINTEST: f32 = 2.0;

/// An edge is the body's where so many of the images have it. Lane markings along the way reach eight in ten.
const SHARE: f64 = 0.9;

/// An image has the edge where its gradient is this part of the median's, and within 45° of its direction.
const PART: f32 = 0.3;

/// Gaps of the outline that are closed (cells to either side).
const CLOSED: usize = 2;

/// Outlines of fewer cells are chance.
const FEWEST_CELLS: usize = 20;

/// More of an image than this is not cut off by a body.
const MOST_ENCLOSED: f64 = 0.25;

/// What a camera saw of the vehicle that carries it.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    grid: Grid,
    /// By cell.
    covered: Vec<bool>,
}

impl Body {
    /// By pixel of the image, row by row: whether it shows the body.
    pub fn pixels(&self) -> Vec<bool> {
        let Grid { size, cell, .. } = self.grid;
        let [width, height] = size.map(|side| side as usize);
        let at = |pixel: usize| {
            let (column, row) = (pixel % width / cell, pixel / width / cell);
            self.covered[row * self.grid.columns + column]
        };
        (0..width * height).map(at).collect()
    }

    /// The share of the image that shows it.
    pub fn share(&self) -> f64 {
        let covered = self.covered.iter().filter(|covered| **covered).count();
        covered as f64 / self.covered.len().max(1) as f64
    }
}

/// Cells of an image, as wide as high.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Grid {
    /// Width and height of the image (px).
    size: [u32; 2],
    /// Side of a cell (px).
    cell: usize,
    columns: usize,
    rows: usize,
}

impl Grid {
    fn new(size: [u32; 2]) -> Self {
        let cell = size[0].div_ceil(COLUMNS).max(size[1].div_ceil(COLUMNS));
        let cell = cell.max(1) as usize;
        let [columns, rows] = size.map(|side| (side as usize).div_ceil(cell));
        Self {
            size,
            cell,
            columns,
            rows,
        }
    }

    fn cells(&self) -> usize {
        self.columns * self.rows
    }

    /// Mean grey values by cell.
    fn means(&self, grey: &[u8]) -> Vec<f32> {
        let [width, height] = self.size.map(|side| side as usize);
        let mean = |at: usize| {
            let (left, top) = (at % self.columns * self.cell, at / self.columns * self.cell);
            let (right, bottom) = ((left + self.cell).min(width), (top + self.cell).min(height));
            let rows = (top..bottom).flat_map(|row| &grey[row * width + left..row * width + right]);
            let sum: u32 = rows.map(|value| u32::from(*value)).sum();
            sum as f32 / ((right - left) * (bottom - top)) as f32
        };
        (0..self.cells()).map(mean).collect()
    }

    /// The cell beside another one; at the border that one.
    fn beside(&self, at: usize, [right, down]: [isize; 2]) -> usize {
        let column = (at % self.columns).saturating_add_signed(right);
        let row = (at / self.columns).saturating_add_signed(down);
        row.min(self.rows - 1) * self.columns + column.min(self.columns - 1)
    }

    /// Sobel's gradient (grey values per cell) along rows and columns.
    fn gradients(&self, means: &[f32]) -> Vec<[f32; 2]> {
        let gradient = |at: usize| {
            let value = |right: isize, down: isize| means[self.beside(at, [right, down])];
            let across = |side: isize| value(side, -1) + 2.0 * value(side, 0) + value(side, 1);
            let along = |side: isize| value(-1, side) + 2.0 * value(0, side) + value(1, side);
            [(across(1) - across(-1)) / 8.0, (along(1) - along(-1)) / 8.0]
        };
        (0..self.cells()).map(gradient).collect()
    }

    /// Cells that share a side.
    fn adjacent(&self, at: usize) -> impl Iterator<Item = usize> + '_ {
        let sides = [[1, 0], [-1, 0], [0, 1], [0, -1]];
        sides.into_iter().map(move |side| self.beside(at, side))
    }

    /// Cells that share a side or a corner.
    fn around(&self, at: usize) -> impl Iterator<Item = usize> + '_ {
        let corners = [[1, 1], [-1, 1], [1, -1], [-1, -1]];
        let corners = corners.into_iter().map(move |side| self.beside(at, side));
        self.adjacent(at).chain(corners)
    }

    fn is_border(&self, at: usize) -> bool {
        let (column, row) = (at % self.columns, at / self.columns);
        column == 0 || row == 0 || column + 1 == self.columns || row + 1 == self.rows
    }

    /// The cells that are set, or have a neighbour that is.
    fn grown(&self, set: &[bool]) -> Vec<bool> {
        let grown = |at: usize| set[at] || self.adjacent(at).any(|other| set[other]);
        (0..self.cells()).map(grown).collect()
    }

    /// Gaps of up to twice [`CLOSED`] cells filled.
    fn closed(&self, set: &[bool]) -> Vec<bool> {
        let mut closed = set.to_vec();
        for _ in 0..CLOSED {
            closed = self.grown(&closed);
        }
        let mut open: Vec<bool> = closed.iter().map(|set| !set).collect();
        for _ in 0..CLOSED {
            open = self.grown(&open);
        }
        open.into_iter().map(|open| !open).collect()
    }
}

/// One camera's images, of which the body is looked for.
#[derive(Debug, Clone)]
pub struct BodySearch {
    grid: Grid,
    /// By image, by cell.
    gradients: Vec<Vec<[f32; 2]>>,
}

impl BodySearch {
    /// For images of this width and height, which are not 0.
    pub fn new(size: [u32; 2]) -> Self {
        Self {
            grid: Grid::new(size),
            gradients: Vec::new(),
        }
    }

    /// Takes an image: grey values, row by row. One of another size is left out; says so with `false`.
    pub fn add(&mut self, size: [u32; 2], grey: &[u8]) -> bool {
        let pixels = size.map(|side| side as usize);
        let fits = size == self.grid.size && grey.len() == pixels[0] * pixels[1];
        if fits {
            let gradients = self.grid.gradients(&self.grid.means(grey));
            self.gradients.push(gradients);
        }
        fits
    }

    /// How many images were taken.
    pub fn images(&self) -> usize {
        self.gradients.len()
    }

    /// What stayed in these images; fewer than `fewest` prove nothing.
    pub fn found(&self, fewest: usize) -> Body {
        let grid = self.grid;
        let mut covered = vec![false; grid.cells()];
        if self.images() >= fewest.max(1) {
            let edges: Vec<bool> = (0..grid.cells())
                .into_par_iter()
                .map(|cell| self.stays(cell))
                .collect();
            let closed = grid.closed(&edges);
            let outlines = parts(grid.cells(), |at| closed[at], |at| grid.around(at));
            let is_body = |outline: &&Vec<usize>| {
                outline.len() >= FEWEST_CELLS && outline.iter().any(|at| grid.is_border(*at))
            };
            for outline in outlines.iter().filter(is_body) {
                outline.iter().for_each(|at| covered[*at] = true);
            }
            fill(&grid, &mut covered);
        }
        Body { grid, covered }
    }

    /// Whether a cell's gradient keeps its direction.
    fn stays(&self, cell: usize) -> bool {
        let of_cell = || self.gradients.iter().map(|image| image[cell]);
        let [x, y] = [0, 1].map(|axis| median(of_cell().map(|gradient| gradient[axis]).collect()));
        let size = x.hypot(y);
        if size <= FAINTEST {
            return false;
        }
        let agrees = |[gx, gy]: &[f32; 2]| {
            let along = (gx * x + gy * y) / size;
            let across = (gx * y - gy * x) / size;
            along > PART * size && across.abs() < along
        };
        let agreeing = of_cell().filter(agrees).count();
        agreeing as f64 >= SHARE * self.images() as f64
    }
}

/// Covers what is cut off from the largest part that is left.
fn fill(grid: &Grid, covered: &mut [bool]) {
    let mut parts = parts(grid.cells(), |at| !covered[at], |at| grid.adjacent(at));
    parts.sort_by_key(|part| std::cmp::Reverse(part.len()));
    let most = MOST_ENCLOSED * grid.cells() as f64;
    for part in parts
        .iter()
        .skip(1)
        .filter(|part| part.len() as f64 <= most)
    {
        part.iter().for_each(|at| covered[*at] = true);
    }
}

/// The middle value of some; the upper of two.
fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    let (_, value, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
    *value
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [400, 300];

    /// A bonnet: below an arc, paint that reflects what is above it.
    fn bonnet(u: u32, v: u32) -> bool {
        let (x, y) = (f64::from(u) - 200.0, f64::from(v) - 700.0);
        x.hypot(y) < 460.0
    }

    /// Scenery that moves past: random blocks, another scene every image.
    fn scenery(image: u32, u: u32, v: u32) -> u8 {
        let block = u64::from(u / 10) * 1009 + u64::from(v / 10) * 9176 + u64::from(image) * 31;
        let mixed = block.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        40 + ((mixed >> 40) % 160) as u8
    }

    fn search(images: u32, grey: impl Fn(u32, u32, u32) -> u8) -> Body {
        let mut search = BodySearch::new(SIZE);
        for image in 0..images {
            let pixels = (0..SIZE[0] * SIZE[1]).map(|at| grey(image, at % SIZE[0], at / SIZE[0]));
            assert!(search.add(SIZE, &pixels.collect::<Vec<_>>()));
        }
        search.found(24)
    }

    #[test]
    fn a_bonnet_is_found_whole_though_its_paint_reflects() {
        let found = search(40, |image, u, v| match bonnet(u, v) {
            true => 10 + scenery(image, u, v) / 12,
            false => scenery(image, u, v),
        });
        let pixels = found.pixels();
        let is = |u: u32, v: u32| pixels[(v * SIZE[0] + u) as usize];
        let all = (0..SIZE[0] * SIZE[1]).map(|at| (at % SIZE[0], at / SIZE[0]));
        let wrong = all.filter(|(u, v)| is(*u, *v) != bonnet(*u, *v)).count();
        // The outline is a few pixels wide.
        assert!(is(200, 290) && wrong < 400 * 8, "{wrong}");
        assert!(found.share() > 0.1);
    }

    #[test]
    fn scenery_sky_and_a_horizon_are_no_body() {
        let none = search(40, |image, u, v| match v {
            ..100 => 230,
            _ => scenery(image, u, v),
        });
        // The skyline itself stays, and is joined to the border; what is above it is more than a body.
        assert!(none.share() < 0.05, "{}", none.share());
        assert_eq!(search(40, scenery).share(), 0.0);
        assert_eq!(search(40, |_, _, _| 128).share(), 0.0);
    }

    #[test]
    fn few_images_prove_nothing_and_other_sizes_are_left_out() {
        let few = search(23, |_, u, v| if bonnet(u, v) { 20 } else { 200 });
        assert_eq!(few.share(), 0.0);
        let mut search = BodySearch::new(SIZE);
        assert!(!search.add([2, 2], &[0; 4]) && !search.add(SIZE, &[0; 4]));
        assert_eq!(search.images(), 0);
    }
}
