//! How boxes lie to lanes: a space is entered from one, and lies to it as those do that people drew, whichever way the lane
//! goes.

use std::f64::consts::{FRAC_PI_2, PI};

use super::GroundBox;
use super::box_index::BoxIndex;
use super::rows::{ENTERED_WITHIN_M, LaneLine};
use super::teaching::Example;
use super::turned::{HEADINGS, yaw};

/// Angles that differ by less are one (rad): two headings of the search, and what a lane bends by beside a row that does not.
const ALIKE: f64 = 0.3;
/// Lanes are taken for straight over so much (m): their points are nearer to each other, and scatter.
const STRAIGHT_M: f64 = 2.0;
/// Angles of a box and of the same turned round differ by less (rad): they are rounded.
const ROUNDED: f64 = 1e-9;

/// Headings of the search, a bit each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct HeadingSet(u32);

const _: () = assert!(HEADINGS <= u32::BITS as usize);

impl HeadingSet {
    const NONE: Self = Self(0);
    /// All of them.
    pub(super) const ALL: Self = Self(u32::MAX);

    /// Those that are so.
    fn of(is_so: impl Fn(usize) -> bool) -> Self {
        let headings = (0..HEADINGS).filter(|heading| is_so(*heading));
        headings.fold(Self::NONE, |all, heading| all.with(Self(1 << heading)))
    }

    /// Those of both.
    fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether one is among them.
    #[inline(always)]
    pub(super) fn has(self, heading: usize) -> bool {
        (self.0 >> heading) & 1 == 1
    }
}

/// The angles at which boxes of a kind lie to lanes.
pub(super) struct Headings {
    /// From 0, along a lane, to a quarter turn, across it (rad); empty where nothing is known.
    angles: Vec<f64>,
    /// Straight pieces of lanes, with as much around them as a lane is from its boxes.
    pieces: BoxIndex,
    /// By piece: the headings at which a box lies to it as others do.
    fitting: Vec<HeadingSet>,
}

impl Headings {
    /// Those of the boxes of the kind that have a lane near, each to its nearest one.
    pub(super) fn learn(examples: &[Example], lanes: &[LaneLine]) -> Self {
        let lines: Vec<GroundBox> = lanes.iter().flat_map(pieces).collect();
        let pieces = BoxIndex::of(&lines);
        let ones = examples.iter().filter(|one| one.is_one());
        let angles = ones.filter_map(|one| {
            let near = pieces.near(&one.place);
            let away = near.map(|piece| (away_m(piece, &one.place), piece));
            let near = away.filter(|(away_m, _)| *away_m <= ENTERED_WITHIN_M);
            let (_, nearest) = near.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
            Some(between(one.place.yaw, nearest.yaw))
        });
        let angles: Vec<f64> = angles.collect();
        let fitting = lines.iter().map(|piece| {
            HeadingSet::of(|heading| {
                is_known(&angles, between(yaw(heading), piece.yaw), ALIKE + ROUNDED)
            })
        });
        Self {
            fitting: fitting.collect(),
            angles,
            pieces,
        }
    }

    /// The headings at which a box of the kind may be allowed whose middle is no farther than this (m) from a point, and maybe
    /// some others.
    pub(super) fn about(&self, point: [f64; 2], within_m: f64) -> HeadingSet {
        if self.angles.is_empty() {
            return HeadingSet::ALL;
        }
        let around = GroundBox {
            centre: point,
            yaw: 0.0,
            length_m: 2.0 * within_m,
            width_m: 2.0 * within_m,
        };
        let (mut allowed, mut is_beside) = (HeadingSet::NONE, false);
        for (number, piece) in self.pieces.numbered_near(&around) {
            let [x, y] = [0, 1].map(|axis| piece.centre[axis] - point[axis]);
            let reach_m = 0.5 * piece.length_m + within_m;
            if x * x + y * y > reach_m * reach_m {
                continue;
            }
            let away_m = away_m(piece, &around);
            if away_m <= ENTERED_WITHIN_M + within_m {
                allowed = allowed.with(self.fitting[*number]);
            }
            is_beside |= away_m <= ENTERED_WITHIN_M - within_m;
        }
        match is_beside {
            true => allowed,
            // Somewhere there may be no lane near.
            false => HeadingSet::ALL,
        }
    }

    /// Whether a box of the kind may lie so: to a lane near it as others do, or anyhow where no lane is near.
    pub(super) fn allow(&self, place: &GroundBox) -> bool {
        if self.angles.is_empty() {
            return true;
        }
        let near = self.pieces.near(place);
        let mut near = near.filter(|piece| away_m(piece, place) <= ENTERED_WITHIN_M);
        let lies_so =
            |piece: &GroundBox| is_known(&self.angles, between(place.yaw, piece.yaw), ALIKE);
        match near.next() {
            Some(first) => lies_so(first) || near.any(lies_so),
            None => true,
        }
    }
}

/// Whether an angle differs by less than this from one that is known (rad).
fn is_known(known: &[f64], angle: f64, by_less_than: f64) -> bool {
    let mut known = known.iter();
    known.any(|known| (known - angle).abs() < by_less_than)
}

/// The angle between two lines, at most a quarter turn (rad).
fn between(one: f64, other: f64) -> f64 {
    let turn = (one - other).rem_euclid(PI);
    FRAC_PI_2 - (turn - FRAC_PI_2).abs()
}

/// The straight pieces of a lane.
fn pieces(lane: &LaneLine) -> Vec<GroundBox> {
    let mut pieces = Vec::new();
    let Some((first, others)) = lane.points.split_first() else {
        return pieces;
    };
    let mut from = *first;
    for (left, to) in (0..others.len()).rev().zip(others) {
        let length_m = (to[0] - from[0]).hypot(to[1] - from[1]);
        let is_last = left == 0 && length_m > 0.0;
        if length_m >= STRAIGHT_M || is_last {
            pieces.push(piece(from, *to));
            from = *to;
        }
    }
    pieces
}

/// A piece with what is about it.
fn piece(from: [f64; 2], to: [f64; 2]) -> GroundBox {
    let along = [to[0] - from[0], to[1] - from[1]];
    GroundBox {
        centre: [0, 1].map(|axis| 0.5 * (from[axis] + to[axis])),
        yaw: along[1].atan2(along[0]),
        length_m: along[0].hypot(along[1]) + 2.0 * ENTERED_WITHIN_M,
        width_m: 2.0 * ENTERED_WITHIN_M,
    }
}

/// How far the middle of a box is from a piece (m).
fn away_m(piece: &GroundBox, place: &GroundBox) -> f64 {
    let [along, left] = piece.inside(place.centre);
    let beyond_m = along.abs() - (0.5 * piece.length_m - ENTERED_WITHIN_M);
    beyond_m.max(0.0).hypot(left)
}

#[cfg(test)]
mod tests {
    use super::super::teaching::Judgement;
    use super::*;

    fn space(x: f64, y: f64, degrees: f64) -> GroundBox {
        GroundBox {
            centre: [x, y],
            yaw: degrees.to_radians(),
            length_m: 5.0,
            width_m: 2.4,
        }
    }

    fn said(place: GroundBox, judgement: Judgement) -> Example {
        Example { place, judgement }
    }

    /// One eastwards, driven to and fro, and one to the north-east that leaves it.
    fn lanes() -> Vec<LaneLine> {
        let lane = |lane: u32, points: Vec<[f64; 2]>| LaneLine { lane, points };
        vec![
            lane(0, vec![[0.0, 0.0], [15.0, 0.0], [60.0, 0.0]]),
            lane(1, vec![[60.0, 0.0], [0.0, 0.0]]),
            lane(2, vec![[60.0, 0.0], [100.0, 40.0]]),
        ]
    }

    #[test]
    fn boxes_lie_to_every_lane_as_those_that_were_drawn_do() {
        let drawn = [said(space(5.0, 5.0, 90.0), Judgement::Drawn)];
        let headings = Headings::learn(&drawn, &lanes());
        let allowed = |x: f64, y: f64| {
            let degrees = (0..24).map(|at| 7.5 * f64::from(at));
            let allowed = degrees.filter(|degrees| headings.allow(&space(x, y, *degrees)));
            allowed.collect::<Vec<f64>>()
        };
        assert_eq!(allowed(30.0, -5.0), [75.0, 82.5, 90.0, 97.5, 105.0]);
        assert_eq!(allowed(85.0, 20.0), [120.0, 127.5, 135.0, 142.5, 150.0]);
        // Where both are near, to either of them.
        let both = [allowed(30.0, -5.0), allowed(85.0, 20.0)].concat();
        assert_eq!(allowed(62.0, 4.0), both);
        // Whichever end is called its front.
        assert!(headings.allow(&space(30.0, 5.0, 270.0)));
        // Beside no lane, beyond its end or its side: anyhow.
        assert_eq!(allowed(-9.0, 0.0).len(), 24);
        assert_eq!(allowed(30.0, 9.0).len(), 24);
        assert_eq!(allowed(1e12, -1e12).len(), 24);
    }

    #[test]
    fn slanted_boxes_are_slanted_to_both_sides_and_others_lie_along() {
        let drawn = [
            said(space(5.0, 5.0, 60.0), Judgement::Drawn),
            said(space(40.0, 3.0, 180.0), Judgement::Accepted),
        ];
        let headings = Headings::learn(&drawn, &lanes());
        for degrees in [0.0, 60.0, 120.0, 180.0] {
            assert!(headings.allow(&space(30.0, -5.0, degrees)), "{degrees}");
        }
        for degrees in [30.0, 90.0, 150.0] {
            assert!(!headings.allow(&space(30.0, -5.0, degrees)), "{degrees}");
        }
    }

    #[test]
    fn without_lanes_or_boxes_beside_them_boxes_lie_anyhow() {
        let near = [said(space(5.0, 5.0, 90.0), Judgement::Drawn)];
        let far = [said(space(5.0, 50.0, 90.0), Judgement::Drawn)];
        let none = [said(space(5.0, 5.0, 90.0), Judgement::Rejected)];
        let point = [LaneLine {
            lane: 0,
            points: vec![[5.0, 0.0]],
        }];
        let learnt = [
            Headings::learn(&near, &[]),
            Headings::learn(&near, &point),
            Headings::learn(&far, &lanes()),
            Headings::learn(&none, &lanes()),
        ];
        for headings in learnt {
            assert!(headings.allow(&space(30.0, 5.0, 45.0)));
        }
    }
}
