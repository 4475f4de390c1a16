//! Parking spaces in rows, with numbers, each towards the lane that it is entered from.
//!
//! Spaces are neighbours where they look the same way, or the opposite one, and lie side by side; where the lane runs along
//! a space, neighbours lie one behind the other. What neighbours join is a row.

use super::GroundBox;
use super::box_index::BoxIndex;
use crate::ground::segment::nearest_share;
use crate::solving::parts::parts;
use rayon::prelude::*;

/// Neighbours look the same way within this angle (rad), or the opposite one: what a row bends by from one to the next.
const ALIKE: f64 = 0.2;
/// Neighbours are a width apart, give or take this part of it.
const SLACK: f64 = 0.3;

/// From the middle of a space to the lane that it is entered from, at most, as a rule (m): half a space of 5 m, and the 6 m of
/// an aisle, on whose far side the lane may be.
pub const ENTERED_WITHIN_M: f64 = 8.5;

/// The centre line of a lane, from above.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneLine {
    /// Its number.
    pub lane: u32,
    /// Points in the map (m).
    pub points: Vec<[f64; 2]>,
}

/// Where a space is entered from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// The lane.
    pub lane: u32,
    /// From the middle of the space to the nearest point of the lane (m).
    pub distance_m: f64,
    /// That point in the map (m).
    point: [f64; 2],
    /// The lane's direction there (rad).
    direction: f64,
}

/// A space with its number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NumberedSpace {
    /// Which of the boxes it is.
    pub index: usize,
    /// The box, its length away from the lane.
    pub place: GroundBox,
    /// Counted from 1, over all rows.
    pub number: u32,
    /// Its row, counted from 1.
    pub row: u32,
    /// Its place in the row, counted from 1.
    pub in_row: u32,
    /// Where it is entered from; `None` where no lane is within reach.
    pub entry: Option<Entry>,
}

/// Numbers boxes row by row, from the south-west. `reach_m`: how far from the middle of a space its lane may be.
///
/// Takes time with the product of boxes and points of lanes.
pub fn numbered(boxes: &[GroundBox], lanes: &[LaneLine], reach_m: f64) -> Vec<NumberedSpace> {
    let spaces: Vec<(GroundBox, Option<Entry>)> = boxes
        .par_iter()
        .map(|place| facing(*place, entry(place, lanes, reach_m)))
        .collect();
    let mut rows = rows(&spaces);
    for row in &mut rows {
        along(row, &spaces);
    }
    let least = |row: &[usize], axis: usize| {
        let at = row.iter().map(|one| spaces[*one].0.centre[axis]);
        at.fold(f64::INFINITY, f64::min)
    };
    rows.sort_by(|a, b| {
        let by = |axis: usize| least(a, axis).total_cmp(&least(b, axis));
        by(1).then(by(0))
    });
    let places = rows
        .iter()
        .enumerate()
        .flat_map(|(row, all)| all.iter().enumerate().map(move |(at, one)| (row, at, *one)));
    places
        .zip(1..)
        .map(|((row, in_row, index), number)| NumberedSpace {
            index,
            place: spaces[index].0,
            number,
            row: row as u32 + 1,
            in_row: in_row as u32 + 1,
            entry: spaces[index].1,
        })
        .collect()
}

/// Where a space is entered from, if it is by this lane: the lane's point nearest to its middle, in the map (m); `None` of a
/// lane without length.
pub fn entered_at(place: &GroundBox, lane: &LaneLine) -> Option<[f64; 2]> {
    let entry = entry(place, std::slice::from_ref(lane), f64::INFINITY);
    entry.map(|entry| entry.point)
}

/// The nearest lane.
fn entry(place: &GroundBox, lanes: &[LaneLine], reach_m: f64) -> Option<Entry> {
    let segments = lanes.iter().flat_map(|lane| {
        let ends = lane.points.windows(2);
        ends.map(|ends| (lane.lane, ends[0], ends[1]))
    });
    let found = segments.map(|(lane, from, to)| {
        let along = [to[0] - from[0], to[1] - from[1]];
        let share = nearest_share(place.centre, [from, to]);
        let point = [0, 1].map(|axis| from[axis] + share * along[axis]);
        Entry {
            lane,
            distance_m: (place.centre[0] - point[0]).hypot(place.centre[1] - point[1]),
            point,
            direction: along[1].atan2(along[0]),
        }
    });
    let near = found.filter(|entry| entry.distance_m <= reach_m);
    near.min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
}

/// The box with its length away from the lane.
fn facing(place: GroundBox, entry: Option<Entry>) -> (GroundBox, Option<Entry>) {
    let is_ahead = entry.is_some_and(|entry| place.inside(entry.point)[0] > 0.0);
    (if is_ahead { place.turned() } else { place }, entry)
}

/// Indices of boxes that neighbours join.
fn rows(spaces: &[(GroundBox, Option<Entry>)]) -> Vec<Vec<usize>> {
    let places: Vec<GroundBox> = spaces.iter().map(|(place, _)| *place).collect();
    let index = BoxIndex::of(&places);
    parts(
        places.len(),
        |_| true,
        |one| {
            let near = index.indices_near(&places[one]);
            near.filter(move |other| are_neighbours(&spaces[one], &spaces[*other]))
        },
    )
}

type Space = (GroundBox, Option<Entry>);

/// Either may tell: at a bend the lane runs along one of them alone.
fn are_neighbours(one: &Space, other: &Space) -> bool {
    has_beside(one, other) || has_beside(other, one)
}

/// Whether a space has another one where its lane says that neighbours lie.
fn has_beside((one, entry): &Space, (other, _): &Space) -> bool {
    let turn = (one.yaw - other.yaw).rem_euclid(std::f64::consts::PI);
    if turn.min(std::f64::consts::PI - turn) > ALIKE {
        return false;
    }
    let [ahead, left] = one.inside(other.centre).map(f64::abs);
    let about = |found: f64, expected: f64| (found / expected - 1.0).abs() <= SLACK;
    let (length_m, width_m) = (
        0.5 * (one.length_m + other.length_m),
        0.5 * (one.width_m + other.width_m),
    );
    let is_along = entry.is_some_and(|entry| (entry.direction - one.yaw).cos().abs() > 0.8);
    if is_along {
        about(ahead, length_m) && left <= SLACK * width_m
    } else {
        about(left, width_m) && ahead <= 0.5 * length_m
    }
}

/// Sorts a row along its longer extent, eastwards, or northwards where it runs north.
fn along(row: &mut [usize], spaces: &[Space]) {
    let extent = |axis: usize| {
        let at = row.iter().map(|one| spaces[*one].0.centre[axis]);
        let (low, high) = at.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
            (low.min(at), high.max(at))
        });
        high - low
    };
    let axis = usize::from(extent(1) > extent(0));
    row.sort_by(|a, b| {
        let at = |one: &usize| spaces[*one].0.centre[axis];
        at(a).total_cmp(&at(b)).then(a.cmp(b))
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_3};

    fn space(x: f64, y: f64, yaw: f64) -> GroundBox {
        GroundBox {
            centre: [x, y],
            yaw,
            length_m: 5.0,
            width_m: 2.4,
        }
    }

    fn lane(lane: u32, y: f64) -> LaneLine {
        let points = vec![[-20.0, y], [40.0, y]];
        LaneLine { lane, points }
    }

    #[test]
    fn a_space_whose_lane_bends_is_of_its_row_in_whatever_order() {
        let mut boxes: Vec<GroundBox> = (0..4)
            .map(|at| space(2.4 * f64::from(at), 0.0, FRAC_PI_2))
            .collect();
        // Round the last space's corner: there the lane runs along it.
        let bent = LaneLine {
            lane: 1,
            points: vec![[-20.0, 6.0], [8.0, 6.0], [12.0, 3.0], [12.0, -9.0]],
        };
        for _ in 0..4 {
            boxes.rotate_left(1);
            let found = numbered(&boxes, std::slice::from_ref(&bent), 8.0);
            assert!(found.iter().all(|one| one.row == 1), "{found:?}");
        }
    }

    #[test]
    fn rows_back_to_back_are_two_and_are_entered_from_their_own_lanes() {
        let south = (0..3).map(|at| space(2.4 * f64::from(at), 0.0, FRAC_PI_2));
        let north = (0..3).map(|at| space(2.4 * f64::from(at), 5.0, FRAC_PI_2));
        let boxes: Vec<GroundBox> = south.chain(north).rev().collect();
        let found = numbered(&boxes, &[lane(7, -6.0), lane(8, 11.0)], 8.0);
        let rows: Vec<(u32, u32)> = found.iter().map(|one| (one.row, one.in_row)).collect();
        assert_eq!(rows, [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)]);
        assert!(
            found
                .windows(2)
                .all(|pair| pair[1].number == pair[0].number + 1)
        );
        for one in found {
            let lane = if one.row == 1 { 7 } else { 8 };
            assert_eq!(one.entry.map(|entry| entry.lane), Some(lane));
            let away = if one.row == 1 { 1.0 } else { -1.0 };
            assert!((one.place.yaw.sin() - away).abs() < 1e-9);
        }
    }

    #[test]
    fn spaces_along_a_lane_are_a_row_one_behind_the_other() {
        let kerb = (0..4).map(|at| space(6.0 * f64::from(at), 3.0, 0.0));
        let found = numbered(&kerb.collect::<Vec<_>>(), &[lane(1, 0.0)], 8.0);
        assert!(found.iter().all(|one| one.row == 1));
        assert_eq!(
            found.iter().map(|one| one.index).collect::<Vec<_>>(),
            [0, 1, 2, 3]
        );
    }

    #[test]
    fn slanted_spaces_are_a_row_and_a_gap_parts_rows() {
        let pitch_m = 2.4 / FRAC_PI_3.sin();
        let places = [0.0, 1.0, 2.0, 4.0, 5.0].map(|at| space(pitch_m * at, 0.0, FRAC_PI_3));
        let found = numbered(&places, &[], 8.0);
        let rows: Vec<u32> = found.iter().map(|one| one.row).collect();
        assert_eq!(rows, [1, 1, 1, 2, 2]);
        assert!(found.iter().all(|one| one.entry.is_none()));
    }
}
