//! Which spaces were taken during a drive.
//!
//! A car is seen as points that stand above the floor of its space, most of them on the end that it turns to the lane; wrong
//! points stand on a free space now and then. How many there are depends on cameras and light, so it is learnt from the
//! drive itself: counts of points are those of free or of taken spaces, each with a mean of their own (a mixture of two
//! geometric distributions, which are as wide as they can be for their means; Dempster, Laird & Rubin 1977). A space without
//! such points was free only if somebody looked.

use rayon::prelude::*;
use rstar::RTree;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::GroundBox;

/// The part of a space that its car stands on wherever it stops, and that what stands on its neighbours or behind it does not
/// reach even where the space was drawn or found a third of a metre beside its place. Cars are 3.6 m long and 1.6 m wide at
/// least, spaces 4.8 m and 2.4; a car stays a third of a metre away from the next space, as its doors must open. Nothing but
/// the car stands at the end by which it is entered, so there the part goes on to the space's edge.
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

/// The part of a space that tells whether there was a car.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Space(GroundBox);

impl Space {
    /// Of a space whose length leads away from the lane that it is entered from, and the point of the lane nearest to it; no
    /// point where no lane is known. Where the lane runs along the space, others lie ahead of both its ends.
    pub fn new(place: &GroundBox, lane: Option<[f64; 2]>) -> Self {
        let half = 0.5 * INNER[0];
        let is_ahead = |point: [f64; 2]| place.inside(point)[0] <= -0.5 * place.length_m;
        let entry = if lane.is_some_and(is_ahead) {
            0.5
        } else {
            half
        };
        Self(GroundBox {
            centre: place.point([0.5 * (half - entry) * place.length_m, 0.0]),
            length_m: (half + entry) * place.length_m,
            width_m: INNER[1] * place.width_m,
            ..*place
        })
    }
}

/// Points that stood on the floor during a drive.
pub struct Obstacles {
    standing: RTree<[f64; 2]>,
    /// Whether there were points at all, on the floor or above.
    is_seen: bool,
}

impl Obstacles {
    /// Of points by place in the map and height above the floor (m).
    pub fn new(points: impl Iterator<Item = ([f64; 2], f64)>, params: &OccupancyParams) -> Self {
        let stands = |height: f64| (params.lowest_m..=params.highest_m).contains(&height);
        let mut points = points.peekable();
        let is_seen = points.peek().is_some();
        let standing = points
            .filter(|(at, height)| stands(*height) && at.iter().all(|value| value.is_finite()));
        Self {
            standing: RTree::bulk_load(standing.map(|(at, _)| at).collect()),
            is_seen,
        }
    }

    fn on(&self, Space(inner): &Space) -> u32 {
        let reach = 0.5 * inner.length_m.hypot(inner.width_m);
        let near = self
            .standing
            .locate_within_distance(inner.centre, reach * reach);
        let is_inside = |point: &&[f64; 2]| {
            let [along, left] = inner.inside(**point);
            along.abs() <= 0.5 * inner.length_m && left.abs() <= 0.5 * inner.width_m
        };
        near.filter(is_inside).count() as u32
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
/// on a grid of `step_m`. A drive without points saw no cars, so of it no space is known to be free.
pub fn occupancy(
    spaces: &[Space],
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
        let is_known = obstacles.is_seen && one.looked >= LOOKED;
        one.taken = Some(taken).filter(|taken| is_known || *taken >= 0.5);
    }
    seen
}

/// Part of a space's inner part that was looked at, by points of a grid in it.
fn looked_at(Space(inner): &Space, step_m: f64, looked: impl Fn([f64; 2]) -> bool) -> f64 {
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

    fn place(x: f64) -> GroundBox {
        GroundBox {
            centre: [x, 0.0],
            yaw: std::f64::consts::FRAC_PI_2,
            length_m: 5.0,
            width_m: 2.4,
        }
    }

    fn space(x: f64) -> Space {
        Space::new(&place(x), None)
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

    /// What cameras of few pixels see of a car is the end that it turns to them.
    #[test]
    fn at_the_end_by_which_a_space_is_entered_all_that_stands_there_is_its_car() {
        let end = |x: f64, y: f64| (0..6).map(move |at| ([x + 0.1 * f64::from(at), y], 0.8));
        let seen = end(0.0, -2.2).chain(end(4.8, 2.2));
        let obstacles = Obstacles::new(seen, &OccupancyParams::default());
        let standing = |lane: Option<[f64; 2]>| {
            let spaces = [0.0, 2.4, 4.8].map(|x| Space::new(&place(x), lane));
            let found = occupancy(&spaces, &obstacles, 0.5, |_| true);
            found.iter().map(|one| one.standing).collect::<Vec<_>>()
        };
        // A lane ahead of the row; the wall behind it counts no more than before.
        assert_eq!(standing(Some([2.4, -6.0])), [6, 0, 0]);
        // No lane; one that runs beside the spaces, which lie one behind the other.
        assert_eq!(standing(None), [0, 0, 0]);
        assert_eq!(standing(Some([8.0, -1.0])), [0, 0, 0]);
    }

    #[test]
    fn a_drive_that_shows_no_points_knows_of_no_free_space() {
        let on_floor = Obstacles::new(points(0.0, 0.05, 9), &OccupancyParams::default());
        let nothing = Obstacles::new(points(0.0, 0.05, 0), &OccupancyParams::default());
        let taken =
            |obstacles: &Obstacles| occupancy(&[space(0.0)], obstacles, 0.5, |_| true)[0].taken;
        assert!(taken(&on_floor).is_some_and(|taken| taken < 0.1));
        assert_eq!(taken(&nothing), None);
    }

    /// Points on 34 spaces of a simulated car park, as four cameras of 160 by 120 pixels saw them: 16 free ones, then those
    /// with cars on them.
    #[test]
    fn cars_that_show_few_points_are_told_from_free_spaces() {
        let mut free = [0_u32; 16];
        free[15] = 1;
        let cars: [u32; 18] = [
            6, 6, 5, 4, 38, 49, 15, 69, 8, 25, 21, 18, 30, 25, 23, 23, 14, 19,
        ];
        let counts: Vec<u32> = free.into_iter().chain(cars).collect();
        let model = Counts::learn(&counts);
        assert!(cars.iter().all(|count| model.taken(*count) > 0.95));
        assert!(model.taken(0) < 0.1);
        let doubt = model.taken(1);
        assert!(
            (0.3..0.7).contains(&doubt),
            "one point says little: {doubt}"
        );
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
