//! The rows of an image that is turned, one after the other.
//!
//! Only those that the boxes about one row show are kept: they stay in the processor's cache, and a heading takes no more
//! memory however high the image is.

use std::collections::VecDeque;
use std::ops::Range;

use super::{HEADINGS, Turned};
use crate::ground::boxes::description::{ACROSS, ALONG, BINS, reach_m};
use crate::ground::boxes::overhead::{DIRECTIONS, STEP};
use crate::processor::vectorised;

/// A bin has so many parts: whole numbers of them are from each direction and heading to the next, so that sums are exact.
const PARTS: usize = 96;
const FROM_DIRECTION: usize = BINS * PARTS / DIRECTIONS;
const FROM_HEADING: usize = BINS * PARTS / HEADINGS;
const _: () = assert!(FROM_DIRECTION * DIRECTIONS == BINS * PARTS);
const _: () = assert!(FROM_HEADING * HEADINGS == BINS * PARTS);

/// By direction of a gradient, its parts in the two bins that it belongs to.
fn votes(heading: usize) -> Vec<[i32; BINS]> {
    let votes = |direction: usize| {
        let place = direction * FROM_DIRECTION + (HEADINGS - heading) * FROM_HEADING;
        let (bin, parts) = (place / PARTS, place % PARTS);
        let mut votes = [0; BINS];
        votes[bin % BINS] = (PARTS - parts) as i32;
        votes[(bin + 1) % BINS] = parts as i32;
        votes
    };
    (0..DIRECTIONS).map(votes).collect()
}

/// A row of an image that is turned: of each place the cell about it.
pub(super) struct Cells {
    /// Roots of the mean histogram.
    pub(super) roots: Vec<[f32; BINS]>,
    /// Their squares, added up.
    pub(super) squares: Vec<f32>,
    /// The columns where they are not zero.
    filled: Range<usize>,
}

/// The rows of an image that is turned that boxes about one of them show.
pub(super) struct Band<'a> {
    turned: &'a Turned<'a>,
    votes: Vec<[i32; BINS]>,
    /// Rows that were read, and empty ones beyond them.
    read: usize,
    /// Rows about which all is known that boxes show.
    pub(super) complete: usize,
    /// Rows that are read before all that boxes about one of them show is known.
    ahead: usize,
    /// How far from a place a box about it shows something (m).
    reach_m: f64,
    numbers: Vec<i32>,
    histograms: Window<BINS>,
    samples: Window<1>,
    /// What a sum over a cell is multiplied with for the mean.
    part: f32,
    /// By row, of which as many are kept as boxes show.
    cells: Vec<Cells>,
    /// The same of the samples that were seen about each place.
    seen: Vec<Vec<i32>>,
}

impl<'a> Band<'a> {
    /// Before the first row; boxes show cells so many rows from their middles.
    pub(super) fn new(turned: &'a Turned<'a>, across: isize) -> Self {
        let reach = reach_m(&turned.middle);
        let cell = [
            turned.radius(reach[0] / ALONG as f64),
            turned.radius(reach[1] / ACROSS as f64),
        ];
        let window = reach.map(|side| turned.radius(side));
        let ahead = window[1].max(cell[1] + across.unsigned_abs());
        let samples = (2 * cell[0] + 1) * (2 * cell[1] + 1);
        let kept = 2 * ahead + 2;
        let columns = turned.columns;
        let cells = || Cells {
            roots: vec![[0.0; BINS]; columns],
            squares: vec![0.0; columns],
            filled: 0..0,
        };
        Self {
            turned,
            votes: votes(turned.heading),
            read: 0,
            complete: 0,
            ahead,
            // As whole steps, a cell and what is summed over it are at most a step farther away.
            reach_m: 0.5 * reach[0].hypot(reach[1]) + 4.0 * turned.step_m,
            numbers: vec![-1; columns],
            histograms: Window::new(columns, cell),
            samples: Window::new(columns, window),
            part: STEP / (PARTS * samples) as f32,
            cells: (0..kept).map(|_| cells()).collect(),
            seen: vec![vec![0; columns]; kept],
        }
    }

    pub(super) fn cells(&self, row: usize) -> &Cells {
        &self.cells[row % self.cells.len()]
    }

    pub(super) fn seen(&self, row: usize) -> &[i32] {
        &self.seen[row % self.seen.len()]
    }

    /// Reads the next row.
    pub(super) fn read_on(&mut self) {
        vectorised(
            #[inline(always)]
            || {
                self.sum();
                self.root();
            },
        );
        self.read += 1;
        self.complete = self.read.saturating_sub(self.ahead);
    }

    /// Adds the next row to the sums; below the image there is nothing.
    #[inline(always)]
    fn sum(&mut self) {
        let inside = match self.read < self.turned.rows {
            true => self.number(),
            false => 0..0,
        };
        let gradients = self.turned.gradients;
        let numbers = &self.numbers;
        let cell = |column: usize| gradients.seen(numbers[column]);
        let votes = &self.votes;
        self.histograms.enter(
            inside.clone(),
            #[inline(always)]
            |column| match cell(column) {
                Some([steps, direction]) => {
                    votes[usize::from(direction)].map(|parts| parts.wrapping_mul(steps.into()))
                }
                None => [0; BINS],
            },
        );
        self.samples.enter(
            inside,
            #[inline(always)]
            |column| [i32::from(cell(column).is_some())],
        );
    }

    /// The numbers of the cells that the next row's places lie in, of the columns that boxes show.
    #[inline(always)]
    fn number(&mut self) -> Range<usize> {
        let (gradients, centre) = (self.turned.gradients, self.turned.centre());
        let near = self.turned.near(self.read, self.reach_m);
        let numbers = &mut self.numbers[near.clone()];
        for (column, number) in near.clone().zip(numbers) {
            *number = gradients.number(centre(column, self.read));
        }
        near
    }

    /// Keeps what the sums that are complete with the next row say.
    #[inline(always)]
    fn root(&mut self) {
        if let Some(row) = self.read.checked_sub(self.histograms.radius[1]) {
            let kept = self.cells.len();
            let cells = &mut self.cells[row % kept];
            let filled = self.histograms.filled();
            let changed = hull(&cells.filled, &filled);
            cells.filled = filled;
            let lines = cells.roots[changed.clone()]
                .iter_mut()
                .zip(&mut cells.squares[changed.clone()]);
            for ((roots, squares), sums) in lines.zip(&self.histograms.sums[changed]) {
                *roots = sums.map(|sum| (sum as f32 * self.part).sqrt());
                *squares = roots.iter().map(|root| root * root).sum();
            }
        }
        if let Some(row) = self.read.checked_sub(self.samples.radius[1]) {
            let kept = self.seen.len();
            let seen = self.seen[row % kept].iter_mut();
            seen.zip(&self.samples.sums)
                .for_each(|(seen, [sum])| *seen = *sum);
        }
    }
}

/// Sums over windows about each place of a row.
struct Window<const N: usize> {
    /// From the place to both sides, along the row and across it.
    radius: [usize; 2],
    /// The sums.
    sums: Vec<[i32; N]>,
    /// Sums over the part of each row that a window covers, by row, the first one first.
    lines: VecDeque<Line<N>>,
    /// The last row's values.
    values: Vec<[i32; N]>,
}

/// Values of a row; those outside of the columns that are filled say nothing.
struct Line<const N: usize> {
    filled: Range<usize>,
    values: Vec<[i32; N]>,
}

impl<const N: usize> Window<N> {
    fn new(columns: usize, radius: [usize; 2]) -> Self {
        Self {
            radius,
            sums: vec![[0; N]; columns],
            lines: VecDeque::new(),
            values: vec![[0; N]; columns],
        }
    }

    /// The columns in which any of the rows is filled.
    fn filled(&self) -> Range<usize> {
        let lines = self.lines.iter();
        lines.fold(0..0, |all, line| hull(&all, &line.filled))
    }

    /// The next row, of which only these columns are not zero, enters the window, and the first one leaves it.
    #[inline(always)]
    fn enter(&mut self, filled: Range<usize>, value: impl Fn(usize) -> [i32; N]) {
        let [along, across] = self.radius;
        let leaves = (self.lines.len() > 2 * across).then(|| self.lines.pop_front());
        let mut line = leaves.flatten().unwrap_or_else(|| Line {
            filled: 0..0,
            values: vec![[0; N]; self.sums.len()],
        });
        let gone = line.filled.clone();
        for (sum, value) in self.sums[gone.clone()].iter_mut().zip(&line.values[gone]) {
            *sum = less(*sum, value);
        }
        let values = &mut self.values[filled.clone()];
        for (column, entered) in filled.clone().zip(values.iter_mut()) {
            *entered = value(column);
        }
        line.sum(filled.start, values, along);
        let here = line.filled.clone();
        for (sum, value) in self.sums[here.clone()].iter_mut().zip(&line.values[here]) {
            *sum = more(*sum, value);
        }
        self.lines.push_back(line);
    }
}

impl<const N: usize> Line<N> {
    /// Makes it the sums over so many columns to both sides of each, of a row that is zero but for values from a column on.
    #[inline(always)]
    fn sum(&mut self, from: usize, values: &[[i32; N]], radius: usize) {
        let end = (from + values.len() + radius).min(self.values.len());
        self.filled = match values.is_empty() {
            true => 0..0,
            false => from.saturating_sub(radius)..end,
        };
        let at = |column: usize| values.get(column.wrapping_sub(from));
        let mut sum = [0; N];
        let before = from..self.filled.start + radius;
        before
            .filter_map(at)
            .for_each(|value| sum = more(sum, value));
        let first = self.filled.start;
        for (column, line) in (first..).zip(&mut self.values[self.filled.clone()]) {
            if let Some(enters) = at(column + radius) {
                sum = more(sum, enters);
            }
            *line = sum;
            if let Some(leaves) = at(column.wrapping_sub(radius)) {
                sum = less(sum, leaves);
            }
        }
    }
}

/// The columns from the first of two ranges to the last.
fn hull(one: &Range<usize>, other: &Range<usize>) -> Range<usize> {
    match (one.is_empty(), other.is_empty()) {
        (true, _) => other.clone(),
        (_, true) => one.clone(),
        _ => one.start.min(other.start)..one.end.max(other.end),
    }
}

#[inline(always)]
fn more<const N: usize>(sum: [i32; N], value: &[i32; N]) -> [i32; N] {
    std::array::from_fn(|bin| sum[bin].wrapping_add(value[bin]))
}

#[inline(always)]
fn less<const N: usize>(sum: [i32; N], value: &[i32; N]) -> [i32; N] {
    std::array::from_fn(|bin| sum[bin].wrapping_sub(value[bin]))
}
