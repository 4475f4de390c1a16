//! Where exactly a box lies: its gradients laid over those of the boxes that were drawn.
//!
//! A description knows of cells half a metre wide, so it finds a box to a decimetre or two. Here the mean of what the drawn
//! boxes show, at four times the resolution, is moved over the image until it correlates best; and it is laid on in each size
//! that was drawn, as lines half a decimetre beside those of another size are in the same cells.

use super::GroundBox;
use super::description::{ACROSS, ALONG, reach_m};
use super::overhead::Gradients;
use super::scan::best_near;
use crate::processor::vectorised;

/// Samples along a box and across it: a decimetre for a parking space.
const SIDES: [usize; 2] = [5 * ALONG, 5 * ACROSS];

/// What boxes of a kind show, in the mean.
#[derive(Debug, Clone, PartialEq)]
pub struct Template {
    /// Gradients with their direction doubled, in the box's frame, along its length and then across.
    values: Vec<[f32; 2]>,
}

/// The gradients in a box, of one strength all together; `None` where there are none. Those of the box turned round are
/// the same in the opposite order.
pub(super) fn laid_out(gradients: &Gradients, of: &GroundBox) -> Option<Vec<[f32; 2]>> {
    let mut values = vec![[0.0_f32; 2]; SIDES[0] * SIDES[1]];
    vectorised(
        #[inline(always)]
        || lay_out(gradients, of, &mut values),
    );
    let squares: f32 = values.iter().map(|[x, y]| x * x + y * y).sum();
    let norm = squares.sqrt();
    values
        .iter_mut()
        .for_each(|value| *value = value.map(|it| it / norm));
    (norm > 0.0).then_some(values)
}

#[inline(always)]
fn lay_out(gradients: &Gradients, of: &GroundBox, values: &mut [[f32; 2]]) {
    let reach = reach_m(of);
    let (sin, cos) = (2.0 * of.yaw).sin_cos();
    let (sin, cos) = (sin as f32, cos as f32);
    let at = |at: usize, axis: usize| ((at as f64 + 0.5) / SIDES[axis] as f64 - 0.5) * reach[axis];
    let to_map = of.to_map();
    let mut numbers = [0; SIDES[1]];
    let (mut across, mut down) = ([0.0; SIDES[1]], [0.0; SIDES[1]]);
    for (column, values) in values.chunks_exact_mut(SIDES[1]).enumerate() {
        let along = at(column, 0);
        let shares = across.iter_mut().zip(&mut down);
        for (row, (number, share)) in numbers.iter_mut().zip(shares).enumerate() {
            let four = gradients.four(to_map([along, at(row, 1)]));
            (*number, [*share.0, *share.1]) = four;
        }
        for (row, value) in values.iter_mut().enumerate() {
            let [x, y] = gradients.mean(numbers[row], [across[row], down[row]]);
            *value = [cos * x + sin * y, cos * y - sin * x];
        }
    }
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

    /// Of what the boxes that were drawn show ([`laid_out`]), each the way round that looks more like those before.
    pub(super) fn learn(drawn: impl Iterator<Item = Vec<[f32; 2]>>) -> Self {
        let mut sums = vec![[0.0; 2]; SIDES[0] * SIDES[1]];
        for mut values in drawn {
            let ahead = correlation(sums.iter(), &values);
            if correlation(sums.iter().rev(), &values) > ahead {
                values.reverse();
            }
            for (sum, value) in sums.iter_mut().zip(values) {
                (0..2).for_each(|axis| sum[axis] += value[axis]);
            }
        }
        Self { values: sums }
    }

    /// The box moved and turned to where it correlates best, within a few decimetres, in the size of these (lengths and widths,
    /// m) in which it does so.
    pub fn laid_on(
        &self,
        gradients: &Gradients,
        place: GroundBox,
        sizes_m: &[[f64; 2]],
    ) -> GroundBox {
        if self.values.is_empty() {
            return place;
        }
        let step_m = place.width_m / 24.0;
        let scored = |place: &GroundBox| {
            let values = laid_out(gradients, place)?;
            Some(f64::from(correlation(values.iter(), &self.values)))
        };
        let sized = sizes_m.iter().flat_map(|size_m| sized(place, *size_m));
        let tried = sized.flat_map(|place| nearby(place, step_m));
        let tried = tried.filter_map(|place| Some((scored(&place)?, place)));
        let best = tried.max_by(|one, other| one.0.total_cmp(&other.0));
        let from = best.map_or(place, |(_, place)| place);
        best_near(from, step_m, 0.04, 3, scored).map_or(from, |found| found.place)
    }
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

/// Steps to each side from which the best is looked for.
const AROUND: i32 = 3;

/// A box, moved by steps along and across: a line has weaker ones on both sides, and what is laid on these fits better than
/// anything a step away.
fn nearby(place: GroundBox, step_m: f64) -> impl Iterator<Item = GroundBox> {
    let steps = move || (-AROUND..=AROUND).map(move |step| f64::from(step) * step_m);
    let moved = steps().flat_map(move |along| steps().map(move |left| [along, left]));
    moved.map(move |by| GroundBox {
        centre: place.point(by),
        ..place
    })
}

fn correlation<'a>(one: impl Iterator<Item = &'a [f32; 2]>, other: &[[f32; 2]]) -> f32 {
    one.zip(other).map(|([x, y], [a, b])| x * a + y * b).sum()
}
