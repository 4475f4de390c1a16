//! Which spaces were taken during a drive.
//!
//! A car is seen as points that stand above the floor of its space; wrong points stand on a free one now and then. How many
//! there are depends on cameras and light, so it is learnt from the drive itself: counts of points are those of free or of
//! taken spaces, each with a mean of their own (a mixture of two geometric distributions, which are as wide as they can be
//! for their means; Dempster, Laird & Rubin 1977). A space without such points was free only if somebody looked.

use rayon::prelude::*;
use rstar::RTree;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::GroundBox;

/// The part of a space that its car stands on wherever it stops, and that what stands on its neighbours or behind it does not
/// reach even where the space was drawn or found a third of a metre beside its place. Cars are 3.6 m long and 1.6 m wide at
/// least, spaces 4.8 m and 2.4; a car stays a third of a metre away from the next space, as its doors must open.
const INNER: [f64; 2] = [0.75, 0.7];
/// Part of the inner space that must have been looked at before nothing there means that it was free.
const LOOKED: f64 = 0.5;
/// Points on a taken space and on a free one, before any is counted; each weighs as much as one space. A car shows cameras
/// that pass some tens of features; of points that pass as exact, few are wrong.
const EXPECTED: [f64; 2] = [30.0, 0.3];
/// Rounds in which means and probabilities are found from each other: each halves the rest and more.
const ROUNDS: usize = 30;

/// What stands on the ground.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct OccupancyParams {
    /// Points above this stand on the floor (m): kerbs and wheel stops are lower, and points that are exact to 0.1 m and lie on
    /// the floor are not as high.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub lowest_m: f64,
    /// Points above this belong to what hangs over a space (m): ceilings begin at 2.2 m, and cars end at 2.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub highest_m: f64,
}

impl Default for OccupancyParams {
    fn default() -> Self {
        Self {
            lowest_m: 0.3,
            highest_m: 2.1,
        }
    }
}

/// Points that stood on the floor during a drive.
pub struct Obstacles(RTree<[f64; 2]>);

impl Obstacles {
    /// Of points by place in the map and height above the floor (m).
    pub fn new(points: impl Iterator<Item = ([f64; 2], f64)>, params: &OccupancyParams) -> Self {
        let stands = |height: f64| (params.lowest_m..=params.highest_m).contains(&height);
        let standing = points
            .filter(|(at, height)| stands(*height) && at.iter().all(|value| value.is_finite()));
        Self(RTree::bulk_load(standing.map(|(at, _)| at).collect()))
    }

    fn on(&self, space: &GroundBox) -> u32 {
        let inner = inner(space);
        let reach = 0.5 * inner.length_m.hypot(inner.width_m);
        let near = self.0.locate_within_distance(space.centre, reach * reach);
        let is_inside = |point: &&[f64; 2]| {
            let [along, left] = inner.inside(**point);
            along.abs() <= 0.5 * inner.length_m && left.abs() <= 0.5 * inner.width_m
        };
        near.filter(is_inside).count() as u32
    }
}

fn inner(space: &GroundBox) -> GroundBox {
    GroundBox {
        length_m: INNER[0] * space.length_m,
        width_m: INNER[1] * space.width_m,
        ..*space
    }
}

/// What a drive saw of a space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occupancy {
    /// Points that stood on its inner part.
    pub standing: u32,
    /// Part of it that was looked at.
    pub looked: f64,
    /// Probability that it was taken; `None` where not enough was seen of it to say.
    pub taken: Option<f64>,
}

/// What a drive saw of each space, in their order. `looked`: whether somebody looked at a point of the ground; it is asked
/// on a grid of `step_m`.
pub fn occupancy(
    spaces: &[GroundBox],
    obstacles: &Obstacles,
    step_m: f64,
    looked: impl Fn([f64; 2]) -> bool + Sync,
) -> Vec<Occupancy> {
    let seen = spaces.par_iter().map(|space| Occupancy {
        standing: obstacles.on(space),
        looked: looked_at(space, step_m, &looked),
        taken: None,
    });
    let mut seen: Vec<Occupancy> = seen.collect();
    let tells = |one: &Occupancy| one.looked >= LOOKED || one.standing > 0;
    let counts: Vec<u32> = seen
        .iter()
        .filter(|one| tells(one))
        .map(|one| one.standing)
        .collect();
    let model = Counts::learn(&counts);
    for one in &mut seen {
        let taken = model.taken(one.standing);
        one.taken = Some(taken).filter(|taken| one.looked >= LOOKED || *taken >= 0.5);
    }
    seen
}

/// Part of a space's inner part that was looked at, by points of a grid in it.
fn looked_at(space: &GroundBox, step_m: f64, looked: impl Fn([f64; 2]) -> bool) -> f64 {
    let inner = inner(space);
    let steps = [inner.length_m, inner.width_m]
        .map(|side| (side / step_m).ceil().clamp(1.0, 100.0) as usize);
    let to_map = inner.to_map();
    let at =
        |index: usize, count: usize, side: f64| ((index as f64 + 0.5) / count as f64 - 0.5) * side;
    let points = (0..steps[0]).flat_map(|i| (0..steps[1]).map(move |j| [i, j]));
    let seen = points.filter(|[i, j]| {
        looked(to_map([
            at(*i, steps[0], inner.length_m),
            at(*j, steps[1], inner.width_m),
        ]))
    });
    seen.count() as f64 / (steps[0] * steps[1]) as f64
}

/// How many points stand on taken and on free spaces, and how many of these there are.
struct Counts {
    means: [f64; 2],
    share: f64,
}

impl Counts {
    fn learn(counts: &[u32]) -> Self {
        let mut model = Self {
            means: EXPECTED,
            share: 0.5,
        };
        for _ in 0..ROUNDS {
            let mut weights = [1.0; 2];
            let mut sums = EXPECTED;
            for count in counts {
                let taken = model.taken(*count);
                for (of, part) in [taken, 1.0 - taken].into_iter().enumerate() {
                    weights[of] += part;
                    sums[of] += part * f64::from(*count);
                }
            }
            model.means = [0, 1].map(|of| sums[of] / weights[of]);
            model.share = weights[0] / (weights[0] + weights[1]);
        }
        model
    }

    /// Probability that a space with so many points was taken.
    fn taken(&self, count: u32) -> f64 {
        let [taken, free] = self
            .means
            .map(|mean| f64::from(count) * (mean / (1.0 + mean)).ln() - mean.ln_1p());
        let odds = (self.share / (1.0 - self.share)).ln() + taken - free;
        1.0 / (1.0 + (-odds).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn space(x: f64) -> GroundBox {
        GroundBox {
            centre: [x, 0.0],
            yaw: std::f64::consts::FRAC_PI_2,
            length_m: 5.0,
            width_m: 2.4,
        }
    }

    /// So many points at a height on a space, along its middle.
    fn points(x: f64, height_m: f64, count: usize) -> impl Iterator<Item = ([f64; 2], f64)> {
        let along = move |at: usize| (at as f64 + 0.5) / count as f64 * 4.0 - 2.0;
        (0..count).map(move |at| ([x, along(at)], height_m))
    }

    #[test]
    fn what_stands_on_a_space_takes_it_and_neighbours_floor_and_ceiling_do_not() {
        let spaces = [0.0, 2.4, 4.8, 7.2].map(space);
        let seen = points(0.0, 1.0, 20)
            .chain(points(0.0 + 1.4, 0.8, 20)) // the car's mirror, over the line
            .chain(points(4.8, 0.05, 20))
            .chain(points(7.2, 2.6, 20));
        let obstacles = Obstacles::new(seen, &OccupancyParams::default());
        let found = occupancy(&spaces, &obstacles, 0.5, |_| true);
        let taken: Vec<bool> = found
            .iter()
            .map(|one| one.taken.unwrap_or(0.5) > 0.5)
            .collect();
        assert_eq!(taken, [true, false, false, false]);
        assert!(
            found
                .iter()
                .all(|one| one.looked == 1.0 && one.taken.is_some())
        );
    }

    #[test]
    fn a_space_that_nobody_looked_at_is_not_free() {
        let spaces = [0.0, 2.4, 4.8].map(space);
        let obstacles = Obstacles::new(points(4.8, 1.0, 9), &OccupancyParams::default());
        let found = occupancy(&spaces, &obstacles, 0.5, |[x, _]| x < 1.2);
        assert!(found[0].taken.is_some_and(|taken| taken < 0.1));
        assert_eq!(found[1].taken, None);
        assert!(found[2].taken.is_some_and(|taken| taken > 0.9));
    }

    #[test]
    fn what_counts_as_many_points_is_learnt_from_the_drive() {
        // Five points are a car where others have as few, and noise where others have hundreds.
        let few = Counts::learn(&[5, 4, 6, 5, 0, 0, 0]);
        let many = Counts::learn(&[300, 400, 350, 5, 4, 6, 7, 5]);
        assert!(few.taken(5) > 0.9 && many.taken(5) < 0.5);
        // Where all are free, or all taken, the other kind is what one expects.
        assert!(Counts::learn(&[0; 50]).taken(1) < 0.5);
        assert!(Counts::learn(&[40; 50]).taken(40) > 0.99);
        assert!(Counts::learn(&[]).taken(0) < 0.1);
    }
}
