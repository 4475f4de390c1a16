//! The places of an image where a description fits.
//!
//! At each heading the image is turned and scored everywhere (`turned`), and what fits best there moved and turned
//! until it fits no better.
//!
//! Only peaks are kept, so what is found does not depend on how the image was cut.

use rayon::prelude::*;

use super::GroundBox;
use super::box_index::BoxIndex;
use super::description::describe;
use super::headings::Headings;
use super::overhead::Gradients;
use super::searched::Searched;
use super::turned::{HEADINGS, SAMPLES, Turned, yaw};

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

/// The boxes of these lengths and widths whose score is highest among those that overlap, of those that are `asked` for and lie
/// as `headings` allow, all between two corners (south-west and north-east, m): the best first, `most` of them at most.
/// `weights` are those of [`describe`]'s numbers.
pub(super) fn scan(
    gradients: &Gradients,
    corners: [[f64; 2]; 2],
    weights: &[f64],
    sizes_m: &[[f64; 2]],
    headings: &Headings,
    asked: impl Fn(&GroundBox) -> bool + Sync,
    most: usize,
) -> Vec<Scored> {
    let searched = Searched::new(gradients, corners, headings);
    let turned = sizes_m.iter().flat_map(|size_m| {
        let searched = &searched;
        let turned = move |heading| Turned::new(gradients, searched, *size_m, heading);
        (0..HEADINGS).filter_map(turned)
    });
    let turned: Vec<Turned<'_>> = turned.collect();
    let found = turned.into_par_iter().flat_map_iter(|turned| {
        let mut found = turned.fitting(weights);
        found.retain(|one| asked(&one.place) && headings.allow(&one.place));
        found
    });
    let apart = apart(found.collect(), most, |one| *one);
    let refined = apart
        .into_par_iter()
        .map(|one| refined(gradients, weights, one));
    self::apart(refined.collect(), most, |one| *one)
}

/// The best of those that overlap, the best first, `most` of them at most.
pub fn apart<T>(mut found: Vec<T>, most: usize, scored: impl Fn(&T) -> Scored) -> Vec<T> {
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
    found.into_iter().filter(is_clear).take(most).collect()
}

/// The place where a description fits best near one where it fits.
fn refined(gradients: &Gradients, weights: &[f64], from: Scored) -> Scored {
    let step_m = from.place.width_m / SAMPLES;
    let turn = 0.5 * yaw(1);
    best_near(from.place, step_m, turn, 2, |place| {
        scored(gradients, weights, place)
    })
    .unwrap_or(from)
}

/// Steps on each scale that are tried, at most.
const TRIED: usize = 24;

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
        // Each beside the one that leads back.
        let steps = [
            ([step_m, 0.0], 0.0),
            ([-step_m, 0.0], 0.0),
            ([0.0, step_m], 0.0),
            ([0.0, -step_m], 0.0),
            ([0.0, 0.0], turn),
            ([0.0, 0.0], -turn),
        ];
        let mut in_vain = 0;
        let mut taken = None;
        for at in (0..steps.len()).cycle().take(TRIED) {
            let (by, turn) = steps[at];
            let place = GroundBox {
                centre: best.place.point(by),
                yaw: best.place.yaw + turn,
                ..best.place
            };
            let leads_back = taken == Some(at ^ 1);
            match (!leads_back).then(|| scored(&place)).flatten() {
                Some(score) if score > best.score => {
                    best = Scored { place, score };
                    (in_vain, taken) = (0, Some(at));
                }
                _ => in_vain += 1,
            }
            if in_vain == steps.len() {
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::cell::Cell;

    use super::*;

    /// A hill with its top at a place that no step leads to exactly.
    #[test]
    fn a_box_is_moved_until_no_step_makes_it_better() {
        let top = GroundBox {
            centre: [2.03, -1.07],
            yaw: 0.31,
            length_m: 5.0,
            width_m: 2.4,
        };
        let tried = Cell::new(0);
        let score = |place: &GroundBox| {
            tried.set(tried.get() + 1);
            let [x, y] = [0, 1].map(|axis| place.centre[axis] - top.centre[axis]);
            Some(-x * x - 2.0 * y * y - 3.0 * (place.yaw - top.yaw).powi(2))
        };
        let from = GroundBox {
            centre: [1.9, -1.2],
            yaw: 0.4,
            ..top
        };
        let found = best_near(from, 0.1, 0.06, 3, score).unwrap();
        // Each scale ends with six steps in vain, fewer where one of them leads back.
        assert!(tried.get() <= 1 + 4 * 12, "{}", tried.get());
        let (step_m, turn) = (0.1 / 8.0, 0.06 / 8.0);
        let steps = [([step_m, 0.0], 0.0), ([0.0, step_m], 0.0), ([0.0; 2], turn)];
        for (by, turn) in steps {
            for sign in [1.0, -1.0] {
                let place = GroundBox {
                    centre: found.place.point(by.map(|by| sign * by)),
                    yaw: found.place.yaw + sign * turn,
                    ..found.place
                };
                assert!(score(&place).unwrap() <= found.score + 1e-12);
            }
        }
        assert_eq!(best_near(from, 0.1, 0.06, 3, |_| None), None);
    }

    #[test]
    fn of_boxes_that_overlap_the_best_is_kept_and_no_more_than_are_asked_for() {
        let scored = |x: f64, score: f64| Scored {
            place: GroundBox {
                centre: [x, 0.0],
                yaw: 0.0,
                length_m: 2.0,
                width_m: 2.0,
            },
            score,
        };
        let found = vec![
            scored(0.0, 1.0),
            scored(0.5, 3.0),
            scored(9.0, 2.0),
            scored(5.0, 0.5),
        ];
        let scores = |most: usize| {
            let kept = apart(found.clone(), most, |one| *one).into_iter();
            kept.map(|one| one.score).collect::<Vec<f64>>()
        };
        assert_eq!(scores(9), [3.0, 2.0, 0.5]);
        assert_eq!(scores(2), [3.0, 2.0]);
        assert!(scores(0).is_empty());
    }
}
