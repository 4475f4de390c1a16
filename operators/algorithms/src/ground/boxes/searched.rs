//! Where boxes are searched for, and at which headings: what no lane allows is not looked at.

use rayon::prelude::*;

use super::headings::{HeadingSet, Headings};
use super::overhead::Gradients;

/// Blocks along each side of what is searched: those of a part of 102 m are 1.6 m wide, a fifth of how far lanes reach.
const BLOCKS: usize = 64;
/// Squares along each side of a block: between two aisles the border of what is beside either is half a metre from that of the
/// other.
const SQUARES: usize = 4;

/// What is searched, by squares.
pub(super) struct Searched {
    /// The south-western corner (m).
    corner: [f64; 2],
    /// Sides of a square (m).
    side_m: [f64; 2],
    /// By square, block by block: the headings at which boxes are searched for there.
    headings: Vec<HeadingSet>,
}

impl Searched {
    /// The part of an image between a south-western and a north-eastern corner (m), at headings that may be allowed there.
    pub(super) fn new(
        gradients: &Gradients,
        [south_west, north_east]: [[f64; 2]; 2],
        headings: &Headings,
    ) -> Self {
        // Of a box about a place outside of the image too little was seen.
        let [first, last] = [gradients.within([0.0, 1.0]), gradients.within([1.0, 0.0])];
        let corner = [0, 1].map(|axis| south_west[axis].max(first[axis]));
        let side_m = [0, 1].map(|axis| {
            let side_m = north_east[axis].min(last[axis]) - corner[axis];
            side_m.max(0.0) / (BLOCKS * SQUARES) as f64
        });
        // About a square, or a larger one, that begins so many squares from the corner. It is taken for a little larger, as
        // numbers are rounded.
        let about = |from: [usize; 2], squares: usize| {
            let sides = squares as f64;
            let middle =
                [0, 1].map(|axis| corner[axis] + (from[axis] as f64 + 0.5 * sides) * side_m[axis]);
            headings.about(middle, 0.51 * sides * side_m[0].hypot(side_m[1]))
        };
        let blocks = (0..BLOCKS * BLOCKS).into_par_iter().flat_map_iter(|block| {
            let first = block * SQUARES * SQUARES;
            let all = about(place(first), SQUARES);
            // Beside no lane, or at the border of what is: closer.
            let is_uncertain = all == HeadingSet::ALL;
            let squares = first..first + SQUARES * SQUARES;
            squares.map(move |at| {
                if is_uncertain {
                    about(place(at), 1)
                } else {
                    all
                }
            })
        });
        Self {
            corner,
            side_m,
            headings: blocks.collect(),
        }
    }

    /// The south-western and the north-eastern corner (m) of all squares where boxes are searched for at a heading; `None`
    /// where they are nowhere.
    pub(super) fn corners(&self, heading: usize) -> Option<[[f64; 2]; 2]> {
        let squares = (0..).zip(&self.headings);
        let squares = squares.filter(|(_, headings)| headings.has(heading));
        let hull = squares.fold(None, |hull: Option<[[usize; 2]; 2]>, (at, _)| {
            let square = place(at);
            let [low, high] = hull.unwrap_or([square; 2]);
            Some([
                [0, 1].map(|axis| low[axis].min(square[axis])),
                [0, 1].map(|axis| high[axis].max(square[axis])),
            ])
        });
        let [low, high] = hull?;
        let corner = |square: [usize; 2]| {
            [0, 1].map(|axis| self.corner[axis] + square[axis] as f64 * self.side_m[axis])
        };
        Some([corner(low), corner(high.map(|at| at + 1))])
    }

    /// Whether boxes about a point of the map are searched for at a heading; of a point outside what the nearest one inside
    /// says.
    #[inline(always)]
    pub(super) fn has(&self, point: [f64; 2], heading: usize) -> bool {
        let square = [0, 1].map(|axis| {
            let squares = (point[axis] - self.corner[axis]) / self.side_m[axis];
            (squares as usize).min(BLOCKS * SQUARES - 1)
        });
        self.headings[number(square)].has(heading)
    }
}

/// The number of a square, by squares from the south-western corner.
#[inline(always)]
fn number([column, row]: [usize; 2]) -> usize {
    let block = row / SQUARES * BLOCKS + column / SQUARES;
    block * SQUARES * SQUARES + row % SQUARES * SQUARES + column % SQUARES
}

/// How many squares from the south-western corner the one of a number is.
fn place(number: usize) -> [usize; 2] {
    let (block, square) = (number / (SQUARES * SQUARES), number % (SQUARES * SQUARES));
    [
        block % BLOCKS * SQUARES + square % SQUARES,
        block / BLOCKS * SQUARES + square / SQUARES,
    ]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::GroundBox;
    use super::super::description::LENGTH;
    use super::super::rows::LaneLine;
    use super::super::scan::{Scored, scan};
    use super::super::teaching::{Example, Judgement};
    use super::super::turned::{HEADINGS, yaw};
    use super::*;
    use crate::solving::random::SplitMix64;

    const CORNERS: [[f64; 2]; 2] = [[1.0, 1.0], [19.0, 15.0]];
    const SIZES_M: [[f64; 2]; 2] = [[1.6, 0.8], [2.0, 1.4]];

    /// Gradients at random, 20 × 16 m, with their south-western corner at the origin.
    fn gradients(random: &mut SplitMix64) -> Gradients {
        let mut cell = |_| [0, 1].map(|_| (255.0 * random.unit()) as u8);
        let cells = (0..200 * 160).map(&mut cell).collect();
        Gradients::new(0.1, 200, [0.0, 16.0], cells)
    }

    fn lane(from: [f64; 2], to: [f64; 2]) -> LaneLine {
        let points = vec![from, to];
        LaneLine { lane: 0, points }
    }

    /// What a box across the first of the lanes teaches, a metre beside its beginning.
    fn across(lanes: &[LaneLine]) -> Headings {
        let drawn = lanes.first().map(|lane| Example {
            place: GroundBox {
                centre: [lane.points[0][0], lane.points[0][1] - 1.0],
                yaw: yaw(12),
                length_m: 1.6,
                width_m: 0.8,
            },
            judgement: Judgement::Drawn,
        });
        Headings::learn(drawn.as_slice(), lanes)
    }

    fn searched(lanes: &[LaneLine]) -> Searched {
        let gradients = gradients(&mut SplitMix64(1));
        Searched::new(&gradients, CORNERS, &across(lanes))
    }

    #[test]
    fn boxes_that_are_found_are_those_that_are_allowed_of_all() {
        let mut random = SplitMix64(7);
        let gradients = gradients(&mut random);
        let weights: Vec<f64> = (0..LENGTH).map(|_| random.unit() - 0.5).collect();
        let anyhow = across(&[]);
        let is_inside = |place: &GroundBox| {
            (0..2).all(|axis| (CORNERS[0][axis]..CORNERS[1][axis]).contains(&place.centre[axis]))
        };
        let found = |headings: &Headings, by: &Headings| -> Vec<Scored> {
            let asked = |place: &GroundBox| is_inside(place) && by.allow(place);
            scan(
                &gradients,
                CORNERS,
                &weights,
                &SIZES_M,
                headings,
                asked,
                usize::MAX,
            )
        };
        let all = found(&anyhow, &anyhow);
        assert!(all.len() > 20, "{}", all.len());
        let eastwards = |y: f64| lane([-20.0, y], [40.0, y]);
        let near_some = [
            vec![eastwards(8.0)],
            vec![eastwards(-2.0)],
            vec![eastwards(-5.0), lane([24.0, 25.0], [26.0, 8.0])],
        ];
        for lanes in near_some {
            let headings = across(&lanes);
            let allowed = found(&anyhow, &headings);
            assert_ne!(allowed, all);
            assert_eq!(found(&headings, &anyhow), allowed, "{lanes:?}");
        }
        let nowhere_near = across(&[eastwards(-20.0)]);
        assert_eq!(found(&nowhere_near, &anyhow), all);
    }

    #[test]
    fn headings_that_no_place_allows_are_not_turned() {
        let turned = |searched: Searched| {
            let headings = (0..HEADINGS).filter(|heading| searched.corners(*heading).is_some());
            headings.collect::<Vec<usize>>()
        };
        let beside_all = searched(&[lane([-20.0, 8.0], [40.0, 8.0])]);
        assert_eq!(turned(beside_all), [10, 11, 12, 13, 14]);
        let none = searched(&[]);
        assert_eq!(turned(none), (0..HEADINGS).collect::<Vec<usize>>());
    }

    #[test]
    fn beside_a_lane_only_headings_that_it_allows_are_searched() {
        // Places are beside it that lie less than 6.5 m north.
        let searched = searched(&[lane([-20.0, -2.0], [40.0, -2.0])]);
        for (y, along, is_searched) in [(3.0, 0, false), (3.0, 12, true), (9.0, 0, true)] {
            for x in [-5.0, 1.5, 10.0, 18.5, 25.0] {
                assert_eq!(searched.has([x, y], along), is_searched, "{x} {y} {along}");
            }
        }
        let [south_west, north_east] = searched.corners(0).unwrap();
        assert!((5.0..6.5).contains(&south_west[1]), "{south_west:?}");
        assert!((north_east[1] - CORNERS[1][1]).abs() < 1e-9);
        assert_eq!(south_west[0], CORNERS[0][0]);
        let across = searched.corners(12).unwrap();
        assert_eq!(across[0], CORNERS[0]);
    }

    /// Boxes back to back between two aisles are 8 m from both lanes: there is nothing between that allows all headings.
    #[test]
    fn what_two_lanes_are_beside_has_no_gap() {
        let lanes = [-3.0, 13.0].map(|y| lane([-20.0, y], [40.0, y]));
        let searched = searched(&lanes);
        assert!(searched.corners(0).is_none());
        let squares = (BLOCKS * SQUARES).pow(2);
        assert!((0..squares).all(|at| number(place(at)) == at));
    }

    #[test]
    fn an_image_without_cells_is_searched_without_a_fault() {
        let nothing = Gradients::new(0.1, 0, [0.0; 2], Vec::new());
        let lanes = [lane([-20.0, 8.0], [40.0, 8.0])];
        for corners in [CORNERS, [[f64::NEG_INFINITY; 2], [f64::INFINITY; 2]]] {
            let weights = vec![1.0; LENGTH];
            let headings = across(&lanes);
            let found = scan(
                &nothing,
                corners,
                &weights,
                &SIZES_M,
                &headings,
                |_| true,
                9,
            );
            assert_eq!(found, []);
        }
    }
}
