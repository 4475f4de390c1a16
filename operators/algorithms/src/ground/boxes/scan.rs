//! The places of an image where a description fits.
//!
//! At each heading the image is turned, its gradients are sorted into histograms and summed over cells once; a box
//! anywhere is then a choice of cells, and a linear score a sum of products.
//!
//! Only peaks are kept, so what is found does not depend on how the image was cut.

use rayon::prelude::*;

use super::GroundBox;
use super::box_index::BoxIndex;
use super::description::{ACROSS, ALONG, BINS, LEAST_SEEN, LENGTH, describe, norm, reach_m, votes};
use super::overhead::Gradients;
use crate::processor::vectorised;

/// Headings over half a turn: at 7.5 degrees a box 5 m long is off by 16 cm at its ends at most, a third of a cell.
const HEADINGS: usize = 24;
/// Samples across a box's width: a drawn line is a tenth of a metre wide, a space 2.4 m.
const SAMPLES: f64 = 24.0;
/// Samples from one place that is tried to the next.
const STRIDE: usize = 2;
/// Boxes that overlap by more than this are one; neighbours in a row do not overlap at all.
pub(super) const SAME: f64 = 0.2;

/// A box with what a linear function of its description gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scored {
    /// The box.
    pub place: GroundBox,
    /// The score.
    pub score: f64,
}

/// The boxes of these lengths and widths whose score is highest among those that overlap, of those that are `asked` for: the
/// best first, `most` of them at most. `weights` are those of [`describe`]'s numbers.
pub fn scan(
    gradients: &Gradients,
    weights: &[f64],
    sizes_m: &[[f64; 2]],
    asked: impl Fn(&GroundBox) -> bool + Sync,
    most: usize,
) -> Vec<Scored> {
    let headings = sizes_m
        .iter()
        .flat_map(|size| (0..HEADINGS).map(move |heading| (*size, heading)));
    let headings: Vec<([f64; 2], usize)> = headings.collect();
    let found = headings.into_par_iter().flat_map_iter(|(size, heading)| {
        let yaw = std::f64::consts::PI * heading as f64 / HEADINGS as f64;
        let mut found = Turned::new(gradients, size, yaw).fitting(weights);
        found.retain(|one| asked(&one.place));
        found
    });
    let mut apart = apart(found.collect(), |one| *one);
    apart.truncate(most);
    let refined = apart
        .into_par_iter()
        .map(|one| refined(gradients, weights, one));
    self::apart(refined.collect(), |one| *one)
}

/// The best of those that overlap, the best first.
pub fn apart<T>(mut found: Vec<T>, scored: impl Fn(&T) -> Scored) -> Vec<T> {
    let key = |place: GroundBox| [place.centre[0], place.centre[1], place.yaw];
    found.sort_by(|a, b| {
        let (a, b) = (scored(a), scored(b));
        let by_place = key(a.place).partial_cmp(&key(b.place));
        let by_place = by_place.unwrap_or(std::cmp::Ordering::Equal);
        b.score.total_cmp(&a.score).then(by_place)
    });
    let mut taken = BoxIndex::new(found.iter().map(|one| scored(one).place));
    let is_clear = |one: &T| {
        let place = scored(one).place;
        let is_clear = taken
            .near(&place)
            .all(|other| other.overlap(&place) <= SAME);
        if is_clear {
            taken.add(place);
        }
        is_clear
    };
    let clear: Vec<bool> = found.iter().map(is_clear).collect();
    let mut clear = clear.into_iter();
    found.retain(|_| clear.next() == Some(true));
    found
}

/// The place where a description fits best near one where it fits.
fn refined(gradients: &Gradients, weights: &[f64], from: Scored) -> Scored {
    let step_m = from.place.width_m / SAMPLES;
    let turn = 0.5 * std::f64::consts::PI / HEADINGS as f64;
    best_near(from.place, step_m, turn, 2, |place| {
        scored(gradients, weights, place)
    })
    .unwrap_or(from)
}

/// Moved and turned until no small step makes it better, with steps that are halved so many times; `None` where there is
/// nothing to score.
pub(super) fn best_near(
    from: GroundBox,
    mut step_m: f64,
    mut turn: f64,
    halvings: usize,
    scored: impl Fn(&GroundBox) -> Option<f64>,
) -> Option<Scored> {
    let mut best = Scored {
        place: from,
        score: scored(&from)?,
    };
    for _ in 0..=halvings {
        for _ in 0..4 {
            let steps = [
                ([step_m, 0.0], 0.0),
                ([-step_m, 0.0], 0.0),
                ([0.0, step_m], 0.0),
                ([0.0, -step_m], 0.0),
                ([0.0, 0.0], turn),
                ([0.0, 0.0], -turn),
            ];
            let before = best.score;
            for (by, turn) in steps {
                let place = GroundBox {
                    centre: best.place.point(by),
                    yaw: best.place.yaw + turn,
                    ..best.place
                };
                if let Some(score) = scored(&place)
                    && score > best.score
                {
                    best = Scored { place, score };
                }
            }
            if best.score == before {
                break;
            }
        }
        step_m *= 0.5;
        turn *= 0.5;
    }
    Some(best)
}

fn scored(gradients: &Gradients, weights: &[f64], place: &GroundBox) -> Option<f64> {
    let values = describe(gradients, place)?;
    let products = values.iter().zip(weights);
    Some(
        products
            .map(|(value, weight)| f64::from(*value) * weight)
            .sum(),
    )
}

/// The image turned to a heading, as histograms summed over cells of a box.
struct Turned {
    middle: [f64; 2],
    size_m: [f64; 2],
    yaw: f64,
    step_m: f64,
    columns: usize,
    rows: usize,
    /// By place and bin: the root of the mean over a cell about that place.
    cells: Vec<[f32; BINS]>,
    /// By place: the part of a box about it that was seen.
    seen: Vec<f32>,
}

impl Turned {
    fn new(gradients: &Gradients, size_m: [f64; 2], yaw: f64) -> Self {
        let (sin, cos) = yaw.sin_cos();
        let sides =
            [gradients.columns, gradients.rows].map(|count| count as f64 * gradients.cell_m);
        let step_m = (size_m[1] / SAMPLES).max(gradients.cell_m);
        let [columns, rows] = [
            sides[0] * cos.abs() + sides[1] * sin.abs(),
            sides[0] * sin.abs() + sides[1] * cos.abs(),
        ]
        .map(|side| (side / step_m).ceil().max(1.0) as usize);
        let mut turned = Self {
            middle: [
                gradients.west_m + 0.5 * sides[0],
                gradients.north_m - 0.5 * sides[1],
            ],
            size_m,
            yaw,
            step_m,
            columns,
            rows,
            cells: Vec::new(),
            seen: Vec::new(),
        };
        let half_turns = (yaw / std::f64::consts::PI) as f32;
        let mut histograms = vec![[0.0; BINS]; columns * rows];
        let mut seen = vec![[0.0]; columns * rows];
        let centre = turned.centre();
        for place in 0..columns * rows {
            let at = centre(place % columns, place / columns);
            if let Some([strength, direction]) = gradients.near(at) {
                seen[place] = [1.0];
                for (bin, share) in votes(strength, direction - half_turns) {
                    histograms[place][bin] += share;
                }
            }
        }
        let reach = reach_m(&turned.middle());
        let cell = [reach[0] / ALONG as f64, reach[1] / ACROSS as f64];
        turned.cells = turned.means(histograms, cell);
        // Running sums of what is not negative may end below it by what was rounded.
        let rooted = |value: f32| value.max(0.0).sqrt();
        let cells = turned.cells.iter_mut();
        cells.for_each(|bins| *bins = bins.map(rooted));
        turned.seen = turned
            .means(seen, reach)
            .into_iter()
            .map(|[seen]| seen)
            .collect();
        turned
    }

    /// The box about the image's middle.
    fn middle(&self) -> GroundBox {
        GroundBox {
            centre: self.middle,
            yaw: self.yaw,
            length_m: self.size_m[0],
            width_m: self.size_m[1],
        }
    }

    /// Places by column and row, in the map.
    fn centre(&self) -> impl Fn(usize, usize) -> [f64; 2] + use<> {
        let to_map = self.middle().to_map();
        let (columns, rows, step_m) = (self.columns, self.rows, self.step_m);
        let from_middle = move |at: usize, count: usize| (at as f64 - 0.5 * count as f64) * step_m;
        move |column, row| to_map([from_middle(column, columns), from_middle(row, rows)])
    }

    /// The box about a place.
    fn place(&self, column: usize, row: usize) -> GroundBox {
        GroundBox {
            centre: self.centre()(column, row),
            ..self.middle()
        }
    }

    /// Means over rectangles of these sides about each place.
    fn means<const N: usize>(&self, mut values: Vec<[f32; N]>, sides_m: [f64; 2]) -> Vec<[f32; N]> {
        let [along, across] =
            sides_m.map(|side| (0.5 * side / self.step_m - 0.5).round().max(0.0) as usize);
        means_along(&mut values, self.columns, along);
        means_across(&values, self.columns, across)
    }

    /// Places whose score no neighbour exceeds, both ways round.
    fn fitting(&self, weights: &[f64]) -> Vec<Scored> {
        let forwards: Vec<[f32; BINS]> = weights[..LENGTH - 1]
            .chunks_exact(BINS)
            .map(|cell| std::array::from_fn(|bin| cell[bin] as f32))
            .collect();
        let [long, wide] = reach_m(&self.middle());
        let half = [long, wide].map(|reach| (0.5 * reach / self.step_m).ceil() as usize);
        let range = |half: usize, count: usize| {
            (half..count.saturating_sub(half))
                .step_by(STRIDE)
                .collect::<Vec<usize>>()
        };
        let (columns, rows) = (range(half[0], self.columns), range(half[1], self.rows));
        let [ahead, back] = self.scores(&forwards, weights[LENGTH - 1], &columns, &rows);
        let mut found = self.peaks(&ahead, &columns, &rows);
        let turned = self.peaks(&back, &columns, &rows).into_iter();
        found.extend(turned.map(|one| Scored {
            place: one.place.turned(),
            ..one
        }));
        found
    }

    /// By place, row by row: its score as it lies, and turned round. The cells of a box that is turned round are its own in
    /// the opposite order.
    fn scores(
        &self,
        weights: &[[f32; BINS]],
        constant: f64,
        columns: &[usize],
        rows: &[usize],
    ) -> [Vec<f64>; 2] {
        let reach = reach_m(&self.middle());
        let offset = |at: usize, count: usize, reach: f64| {
            (((at as f64 + 0.5) / count as f64 - 0.5) * reach / self.step_m).round() as isize
        };
        let offsets: Vec<isize> = (0..ALONG * ACROSS)
            .map(|cell| {
                let along = offset(cell / ACROSS, ALONG, reach[0]);
                let left = offset(cell % ACROSS, ACROSS, reach[1]);
                left * self.columns as isize + along
            })
            .collect();
        let squares = |cell: &[f32; BINS]| cell.iter().map(|value| value * value).sum();
        let squares: Vec<f32> = self.cells.iter().map(squares).collect();
        let template = Template {
            offsets,
            ahead: weights,
            constant,
        };
        let places = rows.iter().flat_map(|row| {
            columns
                .iter()
                .map(move |column| row * self.columns + column)
        });
        let mut scores: Vec<[f64; 2]> = Vec::with_capacity(rows.len() * columns.len());
        vectorised(
            #[inline(always)]
            || {
                for place in places {
                    let is_seen = f64::from(self.seen[place]) >= LEAST_SEEN;
                    scores.push(if is_seen {
                        template.scores(&self.cells, &squares, place)
                    } else {
                        [f64::NEG_INFINITY; 2]
                    });
                }
            },
        );
        [0, 1].map(|way| scores.iter().map(|score| score[way]).collect())
    }

    /// Places whose score no neighbour exceeds.
    fn peaks(&self, scores: &[f64], columns: &[usize], rows: &[usize]) -> Vec<Scored> {
        let wide = columns.len();
        let is_peak = |at: &usize| {
            let (column, row) = (at % wide, at / wide);
            let (left, right) = (column.saturating_sub(1), (column + 1).min(wide - 1));
            let (top, bottom) = (row.saturating_sub(1), (row + 1).min(rows.len() - 1));
            let mut near = (top..=bottom)
                .flat_map(|row| (left..=right).map(move |column| row * wide + column));
            scores[*at].is_finite() && near.all(|other| scores[other] <= scores[*at])
        };
        let scored = |at: usize| Scored {
            place: self.place(columns[at % wide], rows[at / wide]),
            score: scores[at],
        };
        (0..scores.len()).filter(is_peak).map(scored).collect()
    }
}

/// Weights of a box's cells, and how far in the list of places each cell is from the box's middle.
struct Template<'a> {
    offsets: Vec<isize>,
    ahead: &'a [[f32; BINS]],
    constant: f64,
}

impl Template<'_> {
    /// The score of the box about a place, and of the same box turned round.
    #[inline(always)]
    fn scores(&self, cells: &[[f32; BINS]], squares: &[f32], place: usize) -> [f64; 2] {
        let (mut ahead, mut back, mut total) = ([0.0_f32; BINS], [0.0_f32; BINS], 0.0_f32);
        let ways = self.ahead.iter().zip(self.ahead.iter().rev());
        for (offset, (ahead_weights, back_weights)) in self.offsets.iter().zip(ways) {
            let at = place.wrapping_add_signed(*offset);
            total += squares[at];
            for bin in 0..BINS {
                ahead[bin] += cells[at][bin] * ahead_weights[bin];
                back[bin] += cells[at][bin] * back_weights[bin];
            }
        }
        let norm = norm(total);
        [ahead, back].map(|sums| f64::from(sums.iter().sum::<f32>() / norm) + self.constant)
    }
}

/// Means over `2 radius + 1` values to both sides along each line of `length` values.
fn means_along<const N: usize>(values: &mut [[f32; N]], length: usize, radius: usize) {
    let part = 1.0 / (2 * radius + 1) as f32;
    for line in values.chunks_mut(length) {
        let from = line.to_vec();
        let mut sum = [0.0; N];
        for at in 0..length + radius {
            if let Some(enters) = from.get(at) {
                (0..N).for_each(|bin| sum[bin] += enters[bin]);
            }
            if let Some(leaves) = at.checked_sub(2 * radius + 1) {
                (0..N).for_each(|bin| sum[bin] -= from[leaves][bin]);
            }
            if let Some(middle) = at.checked_sub(radius) {
                line[middle] = sum.map(|sum| sum * part);
            }
        }
    }
}

/// The same over lines of `length` values before and after each.
fn means_across<const N: usize>(
    values: &[[f32; N]],
    length: usize,
    radius: usize,
) -> Vec<[f32; N]> {
    let part = 1.0 / (2 * radius + 1) as f32;
    let lines: Vec<&[[f32; N]]> = values.chunks(length).collect();
    let mut means = Vec::with_capacity(values.len());
    let mut sums = vec![[0.0; N]; length];
    for at in 0..lines.len() + radius {
        if let Some(enters) = lines.get(at) {
            add(&mut sums, enters, 1.0);
        }
        if let Some(leaves) = at.checked_sub(2 * radius + 1) {
            add(&mut sums, lines[leaves], -1.0);
        }
        if at >= radius {
            means.extend(sums.iter().map(|sum| sum.map(|sum| sum * part)));
        }
    }
    means
}

fn add<const N: usize>(sums: &mut [[f32; N]], values: &[[f32; N]], sign: f32) {
    for (sum, value) in sums.iter_mut().zip(values) {
        (0..N).for_each(|bin| sum[bin] += sign * value[bin]);
    }
}
