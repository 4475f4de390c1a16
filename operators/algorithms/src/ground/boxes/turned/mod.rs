//! The image turned to a heading, row by row.
//!
//! Gradients are sorted into histograms and summed over the cells of a box; a box anywhere is then a choice of cells, and a
//! linear score a sum of products.

mod band;
#[cfg(test)]
mod tests;

use std::ops::Range;

use self::band::{Band, Cells};
use super::GroundBox;
use super::description::{ACROSS, ALONG, BINS, LEAST_SEEN, LENGTH, norm, reach_m};
use super::overhead::Gradients;
use super::scan::Scored;
use super::searched::Searched;
use crate::processor::vectorised;

/// Headings over half a turn: at 7.5 degrees a box 5 m long is off by 16 cm at its ends at most, a third of a cell.
pub(super) const HEADINGS: usize = 24;
/// Samples across a box's width: a drawn line is a tenth of a metre wide, a space 2.4 m.
pub(super) const SAMPLES: f64 = 24.0;
/// Samples from one place that is tried to the next.
const STRIDE: usize = 2;
/// Places that are scored together: what is known of them stays in the processor's registers.
const TOGETHER: usize = 4;

/// How a heading lies to the map's x axis (rad, anticlockwise).
pub(super) fn yaw(heading: usize) -> f64 {
    std::f64::consts::PI * heading as f64 / HEADINGS as f64
}

/// The image turned to a heading: its places are so many steps from one another, along a box and across it.
pub(super) struct Turned<'a> {
    gradients: &'a Gradients,
    heading: usize,
    /// The box about the image's middle.
    middle: GroundBox,
    /// Where boxes are searched for.
    searched: &'a Searched,
    /// All places where they are at this heading: the south-western and the north-eastern corner (m).
    corners: [[f64; 2]; 2],
    step_m: f64,
    columns: usize,
    rows: usize,
}

impl<'a> Turned<'a> {
    /// For boxes of this length and width (m), at this one of all headings; `None` where none is searched for at it.
    pub(super) fn new(
        gradients: &'a Gradients,
        searched: &'a Searched,
        size_m: [f64; 2],
        heading: usize,
    ) -> Option<Self> {
        let corners = searched.corners(heading)?;
        let yaw = yaw(heading);
        let (sin, cos) = yaw.sin_cos();
        let sides =
            [gradients.columns, gradients.rows].map(|count| count as f64 * gradients.cell_m);
        let step_m = (size_m[1] / SAMPLES).max(gradients.cell_m);
        let [columns, rows] = [
            sides[0] * cos.abs() + sides[1] * sin.abs(),
            sides[0] * sin.abs() + sides[1] * cos.abs(),
        ]
        .map(|side| (side / step_m).ceil().max(1.0) as usize);
        Some(Self {
            searched,
            corners,
            gradients,
            heading,
            middle: GroundBox {
                centre: [
                    gradients.west_m + 0.5 * sides[0],
                    gradients.north_m - 0.5 * sides[1],
                ],
                yaw,
                length_m: size_m[0],
                width_m: size_m[1],
            },
            step_m,
            columns,
            rows,
        })
    }

    /// Places by column and row, in the map.
    fn centre(&self) -> impl Fn(usize, usize) -> [f64; 2] + use<> {
        let to_map = self.middle.to_map();
        let (columns, rows, step_m) = (self.columns, self.rows, self.step_m);
        let from_middle = move |at: usize, count: usize| (at as f64 - 0.5 * count as f64) * step_m;
        move |column, row| to_map([from_middle(column, columns), from_middle(row, rows)])
    }

    /// The columns of a row between the corners, or no farther beyond (m) than this, and a few beside them.
    fn near(&self, row: usize, beyond_m: f64) -> Range<usize> {
        let centre = self.centre();
        let [from, to] = [centre(0, row), centre(self.columns, row)];
        // Of the row, the share at which it comes in and goes out on each axis.
        let shares = [0, 1].map(|axis| {
            let [low, high] = self.corners.map(|corner| corner[axis]);
            let share = |side: f64| (side - from[axis]) / (to[axis] - from[axis]);
            [share(low - beyond_m), share(high + beyond_m)]
        });
        let first = shares.iter().map(|[one, other]| one.min(*other));
        let last = shares.iter().map(|[one, other]| one.max(*other));
        let first = self.columns as f64 * first.fold(0.0, f64::max);
        let last = self.columns as f64 * last.fold(1.0, f64::min);
        let last = (last.ceil() as usize).saturating_add(2).min(self.columns);
        (first.floor() as usize).saturating_sub(1).min(last)..last
    }

    /// Steps from a place to the farthest one in a window of this side (m) about it.
    fn radius(&self, side_m: f64) -> usize {
        (0.5 * side_m / self.step_m - 0.5).round().max(0.0) as usize
    }

    /// Places whose score no neighbour exceeds, both ways round. The cells of a box that is turned round are its own in the
    /// opposite order.
    pub(super) fn fitting(&self, weights: &[f64]) -> Vec<Scored> {
        let half = reach_m(&self.middle).map(|reach| (0.5 * reach / self.step_m).ceil() as usize);
        let tried = |half: usize, count: usize| {
            let tried = (half..count.saturating_sub(half)).step_by(STRIDE);
            tried.collect::<Vec<usize>>()
        };
        let (columns, rows) = (tried(half[0], self.columns), tried(half[1], self.rows));
        let [ahead, back] = self.scores(weights, &columns, &rows);
        let constant = weights[LENGTH - 1];
        let mut found = self.peaks(&ahead, constant, &columns, &rows);
        let turned = self.peaks(&back, constant, &columns, &rows).into_iter();
        found.extend(turned.map(|one| Scored {
            place: one.place.turned(),
            ..one
        }));
        found
    }

    /// By place that is tried, row by row: its score without the constant, as it lies and turned round.
    fn scores(&self, weights: &[f64], columns: &[usize], rows: &[usize]) -> [Vec<f32>; 2] {
        let mut scores = [0, 1].map(|_| Vec::with_capacity(columns.len() * rows.len()));
        let template = Template::new(self, weights);
        let mut band = Band::new(self, template.across.into_iter().max().unwrap_or(0));
        let asked = self.asked(columns, rows);
        let asked = asked.chunks(columns.len().max(1));
        for (row, asked) in rows.iter().zip(asked) {
            while band.complete <= *row {
                band.read_on();
            }
            vectorised(
                #[inline(always)]
                || template.score(&band, *row, columns, asked, &mut scores),
            );
        }
        scores
    }

    /// By place that is tried, row by row: whether it is searched, or a neighbour of one that is, that none of these is a peak
    /// which is none.
    fn asked(&self, columns: &[usize], rows: &[usize]) -> Vec<bool> {
        let centre = &self.centre();
        let searched = rows.iter().flat_map(|row| {
            let near = self.near(*row, self.step_m);
            columns.iter().map(move |column| {
                near.contains(column) && self.searched.has(centre(*column, *row), self.heading)
            })
        });
        let searched: Vec<bool> = searched.collect();
        let places = [columns.len(), rows.len()];
        let asked = (0..searched.len()).map(|at| {
            let mut around = around(at, places);
            searched[at] || around.any(|other| searched[other])
        });
        asked.collect()
    }

    /// Places whose score no neighbour exceeds.
    fn peaks(
        &self,
        scores: &[f32],
        constant: f64,
        columns: &[usize],
        rows: &[usize],
    ) -> Vec<Scored> {
        let wide = columns.len();
        let is_peak = |at: &usize| {
            if !scores[*at].is_finite() {
                return false;
            }
            let mut near = around(*at, [wide, rows.len()]);
            near.all(|other| scores[other] <= scores[*at])
        };
        let centre = self.centre();
        let scored = |at: usize| Scored {
            place: GroundBox {
                centre: centre(columns[at % wide], rows[at / wide]),
                ..self.middle
            },
            score: f64::from(scores[at]) + constant,
        };
        (0..scores.len()).filter(is_peak).map(scored).collect()
    }
}

/// A place among so many columns and rows, and its neighbours.
fn around(at: usize, [columns, rows]: [usize; 2]) -> impl Iterator<Item = usize> {
    let (column, row) = (at % columns, at / columns);
    let (left, right) = (column.saturating_sub(1), (column + 1).min(columns - 1));
    let (top, bottom) = (row.saturating_sub(1), (row + 1).min(rows - 1));
    (top..=bottom).flat_map(move |row| (left..=right).map(move |column| row * columns + column))
}

/// Weights of a box's cells, and how far from its middle they lie.
struct Template {
    /// Along the box and then across it.
    weights: Vec<[f32; BINS]>,
    /// Columns from the middle.
    along: [isize; ALONG],
    /// Rows from the middle.
    across: [isize; ACROSS],
    /// Samples about a place that must have been seen.
    least_seen: f64,
}

impl Template {
    fn new(turned: &Turned<'_>, weights: &[f64]) -> Self {
        let reach = reach_m(&turned.middle);
        let offset = |at: usize, count: usize, reach: f64| {
            (((at as f64 + 0.5) / count as f64 - 0.5) * reach / turned.step_m).round() as isize
        };
        let weights = weights[..LENGTH - 1].chunks_exact(BINS);
        let seen = reach.map(|side| 2 * turned.radius(side) + 1);
        Self {
            weights: weights
                .map(|cell| std::array::from_fn(|bin| cell[bin] as f32))
                .collect(),
            along: std::array::from_fn(|at| offset(at, ALONG, reach[0])),
            across: std::array::from_fn(|at| offset(at, ACROSS, reach[1])),
            least_seen: LEAST_SEEN * (seen[0] * seen[1]) as f64,
        }
    }

    /// Adds the scores of a row; columns that are not asked for are not looked at.
    #[inline(always)]
    fn score(
        &self,
        band: &Band<'_>,
        row: usize,
        columns: &[usize],
        asked: &[bool],
        scores: &mut [Vec<f32>; 2],
    ) {
        let lines = self
            .across
            .map(|across| band.cells(row.wrapping_add_signed(across)));
        let seen = band.seen(row);
        let is_seen = |(column, is_asked): (&usize, &bool)| {
            *is_asked && f64::from(seen[*column]) >= self.least_seen
        };
        let (groups, rest) = columns.as_chunks::<TOGETHER>();
        let (asked_groups, asked_rest) = asked.as_chunks::<TOGETHER>();
        for (group, asked) in groups.iter().zip(asked_groups) {
            let are_seen = std::array::from_fn(|at| is_seen((&group[at], &asked[at])));
            self.score_group(&lines, *group, are_seen, scores);
        }
        for one in rest.iter().zip(asked_rest) {
            self.score_group(&lines, [*one.0], [is_seen(one)], scores);
        }
    }

    /// Adds the scores of neighbours, and of what lies there turned round.
    #[inline(always)]
    fn score_group<const N: usize>(
        &self,
        lines: &[&Cells; ACROSS],
        columns: [usize; N],
        are_seen: [bool; N],
        scores: &mut [Vec<f32>; 2],
    ) {
        if !are_seen.contains(&true) {
            scores
                .iter_mut()
                .for_each(|scores| scores.extend([f32::NEG_INFINITY; N]));
            return;
        }
        let (mut ahead, mut back) = ([[0.0_f32; BINS]; N], [[0.0_f32; BINS]; N]);
        let mut totals = [0.0_f32; N];
        let mut ways = self.weights.iter().zip(self.weights.iter().rev());
        for along in self.along {
            let from = columns[0].wrapping_add_signed(along);
            let places = from..from + STRIDE * (N - 1) + 1;
            for (line, (ahead_weights, back_weights)) in lines.iter().zip(&mut ways) {
                let roots = &line.roots[places.clone()];
                let squares = &line.squares[places.clone()];
                let cell = |at: usize| &roots[STRIDE * at];
                let plus = |sums: [[f32; BINS]; N], weights: &[f32; BINS]| {
                    std::array::from_fn(|at| plus_products(sums[at], cell(at), weights))
                };
                ahead = plus(ahead, ahead_weights);
                back = plus(back, back_weights);
                totals = std::array::from_fn(|at| totals[at] + squares[STRIDE * at]);
            }
        }
        let ways = ahead.iter().zip(&back);
        for ((way, total), is_seen) in ways.zip(totals).zip(are_seen) {
            let norm = norm(total);
            let scored = |sums: &[f32; BINS]| match is_seen {
                true => sums.iter().sum::<f32>() / norm,
                false => f32::NEG_INFINITY,
            };
            scores[0].push(scored(way.0));
            scores[1].push(scored(way.1));
        }
    }
}

/// Sums of products, one for each bin: of arrays that are made anew, which stay in the processor's registers.
#[inline(always)]
fn plus_products(sums: [f32; BINS], values: &[f32; BINS], weights: &[f32; BINS]) -> [f32; BINS] {
    std::array::from_fn(|bin| sums[bin] + values[bin] * weights[bin])
}
