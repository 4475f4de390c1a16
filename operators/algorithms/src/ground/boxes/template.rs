//! Where exactly a box lies: its gradients laid over those of the boxes that were drawn.
//!
//! A description knows of cells half a metre wide, so it finds a box to a decimetre or two. Here the mean of what the drawn
//! boxes show, at four times the resolution, is moved over the image until its product with what lies there is largest; and it
//! is laid on in each size that was drawn, as lines half a decimetre beside those of another size are in the same cells. The
//! image's contrast is levelled ([`super::overhead`]); levelled once more by what lies in each box, boxes would be drawn to where
//! little else does. What varies among the drawn boxes counts less: Fisher's linear discriminant, of samples that vary by
//! themselves.
//!
//! Source: Hariharan, Malik & Ramanan, *Discriminative decorrelation for clustering and classification* (2012), for gradients
//! divided by their covariance, of which the diagonal alone is known here.

use super::GroundBox;
use super::description::{ACROSS, ALONG, reach_m};
use super::overhead::Gradients;
use super::scan::{Scored, best_near};
use crate::processor::vectorised;

/// Samples along a box and across it: a decimetre for a parking space.
const SIDES: [usize; 2] = [5 * ALONG, 5 * ACROSS];

/// A sample is expected to vary as all do, as if it had been seen in so many boxes more. Of 1 to 16, more leave cars in, and
/// fewer believe what few boxes show; 4 and 8 are equally good.
const EXPECTED: f32 = 4.0;

/// A box is laid on as it was found and turned by so much to both sides (rad): its sides then lie beside the lines by half of one
/// at their ends.
const TURN: f64 = 0.04;

/// Points of a box's frame at which gradients are laid out.
#[derive(Debug, Clone, Copy)]
struct Grid {
    /// From one sample to the next it has so many points.
    parts: usize,
    /// And so many beyond the first sample and the last, along a box and across it.
    beyond: [usize; 2],
}

impl Grid {
    /// The samples themselves.
    const SAMPLES: Self = Self {
        parts: 1,
        beyond: [0; 2],
    };

    /// Those of a box, and of all that lie up to six decimetres ahead or behind and three to a side, of a parking space, by steps of
    /// half a sample: a line is a sample wide and has weaker ones on both sides, and what is laid on one of these fits better than
    /// what lies half a line beside its place.
    const AROUND: Self = Self {
        parts: 2,
        beyond: [10, 5],
    };

    /// Points along a box (0) or across it (1).
    const fn side(self, axis: usize) -> usize {
        self.parts * (SIDES[axis] - 1) + 1 + 2 * self.beyond[axis]
    }

    /// Where a point lies, as a share of what is described, from the box's middle.
    #[inline(always)]
    fn share(self, at: usize, axis: usize) -> f64 {
        let samples = (at as f64 - self.beyond[axis] as f64) / self.parts as f64;
        (samples + 0.5) / SIDES[axis] as f64 - 0.5
    }

    /// The place of a point across a box among those of its line: samples of one box are neighbours.
    #[inline(always)]
    const fn place(self, row: usize) -> usize {
        row % self.parts * self.side(1).div_ceil(self.parts) + row / self.parts
    }

    /// Steps from the first of the boxes to each, along and across.
    fn places(self) -> impl Iterator<Item = [usize; 2]> {
        let steps = move |axis: usize| 0..=2 * self.beyond[axis];
        steps(0).flat_map(move |along| steps(1).map(move |left| [along, left]))
    }

    /// Gradients at the points, in the box's frame, along its length and then across.
    fn lay_out(self, gradients: &Gradients, of: &GroundBox) -> Vec<[f32; 2]> {
        let mut values = vec![[0.0_f32; 2]; self.side(0) * self.side(1)];
        vectorised(
            #[inline(always)]
            || self.lay_out_into(gradients, of, &mut values),
        );
        values
    }

    #[inline(always)]
    fn lay_out_into(self, gradients: &Gradients, of: &GroundBox, values: &mut [[f32; 2]]) {
        const MOST: usize = Grid::AROUND.side(1);
        let reach = reach_m(of);
        let (sin, cos) = (2.0 * of.yaw).sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        let to_map = of.to_map();
        let mut numbers = [0; MOST];
        let (mut across, mut down) = ([0.0; MOST], [0.0; MOST]);
        let rows = self.side(1);
        for (column, values) in values.chunks_exact_mut(rows).enumerate() {
            let along = self.share(column, 0) * reach[0];
            let shares = across.iter_mut().zip(&mut down);
            for (row, (number, share)) in numbers.iter_mut().zip(shares).enumerate().take(rows) {
                let four = gradients.four(to_map([along, self.share(row, 1) * reach[1]]));
                (*number, [*share.0, *share.1]) = four;
            }
            for row in 0..rows {
                let [x, y] = gradients.mean(numbers[row], [across[row], down[row]]);
                values[self.place(row)] = [cos * x + sin * y, cos * y - sin * x];
            }
        }
    }
}

/// The gradients in a box, of one strength all together; `None` where there are none. Those of the box turned round are
/// the same in the opposite order.
pub(super) fn laid_out(gradients: &Gradients, of: &GroundBox) -> Option<Vec<[f32; 2]>> {
    let mut values = Grid::SAMPLES.lay_out(gradients, of);
    let squares: f32 = values.iter().map(|[x, y]| x * x + y * y).sum();
    let norm = squares.sqrt();
    values
        .iter_mut()
        .for_each(|value| *value = value.map(|it| it / norm));
    (norm > 0.0).then_some(values)
}

/// What boxes of a kind show, in the mean, and divided by its variance: a car is what some show and others do not, and would draw
/// boxes to where cars stand.
#[derive(Debug, Clone, PartialEq)]
pub struct Template {
    /// Gradients with their direction doubled, in the box's frame, along its length and then across.
    values: Vec<[f32; 2]>,
}

impl Template {
    /// From what [`Self::values`] gave, or from nothing, which moves no box; `None` where that is not as many finite numbers.
    pub fn from_values(values: Vec<[f32; 2]>) -> Option<Self> {
        let is_sound = [0, SIDES[0] * SIDES[1]].contains(&values.len())
            && values.iter().flatten().all(|value| value.is_finite());
        is_sound.then_some(Self { values })
    }

    /// The gradients.
    pub fn values(&self) -> &[[f32; 2]] {
        &self.values
    }

    /// Of what the boxes that were drawn show ([`laid_out`]), all the same way round.
    pub(super) fn learn(drawn: &[Vec<[f32; 2]>]) -> Self {
        let mut means = vec![[0.0_f32; 2]; SIDES[0] * SIDES[1]];
        for one in drawn {
            for (sum, value) in means.iter_mut().zip(one) {
                (0..2).for_each(|axis| sum[axis] += value[axis] / drawn.len() as f32);
            }
        }
        let spread = |at: usize| -> f32 {
            let from_mean = drawn.iter().map(|one| square_distance(one[at], means[at]));
            from_mean.sum::<f32>() / drawn.len() as f32
        };
        let spreads: Vec<f32> = (0..means.len()).map(spread).collect();
        let typical = spreads.iter().sum::<f32>() / spreads.len() as f32;
        let expected = typical * EXPECTED / drawn.len() as f32;
        let weighed = means.iter().zip(&spreads).map(|(mean, spread)| {
            let weight = typical / (spread + expected);
            mean.map(|value| {
                if weight.is_finite() {
                    weight * value
                } else {
                    value
                }
            })
        });
        Self {
            values: weighed.collect(),
        }
    }

    /// The box moved and turned to where the template fits best, within a few decimetres, in the size of these (lengths and
    /// widths, m) in which it does so.
    pub fn laid_on(
        &self,
        gradients: &Gradients,
        place: GroundBox,
        sizes_m: &[[f64; 2]],
    ) -> GroundBox {
        if self.values.is_empty() {
            return place;
        }
        let sized = sizes_m.iter().flat_map(|size_m| sized(place, *size_m));
        let turned = sized.flat_map(|place| {
            [-TURN, 0.0, TURN].map(|turn| GroundBox {
                yaw: place.yaw + turn,
                ..place
            })
        });
        let fitting = turned.map(|place| self.best_around(gradients, place));
        let best = fitting.max_by(|one, other| one.score.total_cmp(&other.score));
        let Some(from) = best.filter(|best| best.score > 0.0) else {
            return place;
        };
        let score = |place: &GroundBox| {
            let values = Grid::SAMPLES.lay_out(gradients, place);
            Some(f64::from(self.product(Grid::SAMPLES, &values, [0; 2])))
        };
        let step_m = from.place.width_m / 96.0;
        best_near(from.place, step_m, 0.5 * TURN, 2, score).map_or(from.place, |found| found.place)
    }

    /// Of the boxes around one that where the template fits best.
    fn best_around(&self, gradients: &Gradients, of: GroundBox) -> Scored {
        let grid = Grid::AROUND;
        let values = grid.lay_out(gradients, &of);
        let (mut best, mut at) = (f32::NEG_INFINITY, grid.beyond);
        vectorised(
            #[inline(always)]
            || {
                for place in grid.places() {
                    let product = self.product(grid, &values, place);
                    if product > best {
                        (best, at) = (product, place);
                    }
                }
            },
        );
        let reach = reach_m(&of);
        let by = [0, 1].map(|axis| {
            let steps = at[axis] as f64 - grid.beyond[axis] as f64;
            steps * reach[axis] / (grid.parts * SIDES[axis]) as f64
        });
        Scored {
            place: GroundBox {
                centre: of.point(by),
                ..of
            },
            score: f64::from(best),
        }
    }

    /// What the template gives with a box of those that are laid out, so many steps from the first.
    #[inline(always)]
    fn product(&self, grid: Grid, values: &[[f32; 2]], [along, left]: [usize; 2]) -> f32 {
        let mut sums = [[0.0_f32; 2]; SIDES[1]];
        let lines = values.chunks_exact(grid.side(1)).skip(along);
        let lines = lines.step_by(grid.parts);
        for (own, line) in self.values.chunks_exact(SIDES[1]).zip(lines) {
            let line = &line[grid.place(left)..][..SIDES[1]];
            for (sum, (own, value)) in sums.iter_mut().zip(own.iter().zip(line)) {
                (0..2).for_each(|axis| sum[axis] += own[axis] * value[axis]);
            }
        }
        sums.iter().flatten().sum()
    }
}

/// The square of the distance of two gradients.
fn square_distance(one: [f32; 2], other: [f32; 2]) -> f32 {
    (one[0] - other[0]).powi(2) + (one[1] - other[1]).powi(2)
}

/// A box in another size, where it was or with one of its ends.
fn sized(place: GroundBox, [length_m, width_m]: [f64; 2]) -> impl Iterator<Item = GroundBox> {
    let longer_m = 0.5 * (length_m - place.length_m);
    let sized = move |ahead_m: f64| GroundBox {
        centre: place.point([ahead_m, 0.0]),
        length_m,
        width_m,
        ..place
    };
    let ends = [-longer_m, longer_m];
    let ends = ends.into_iter().filter(|ahead_m| *ahead_m != 0.0);
    std::iter::once(0.0).chain(ends).map(sized)
}
