//! The keyframes that a map needs, however many drives have gone through it.
//!
//! A map that keeps every keyframe grows with the number of drives, though a place stays as large as it is. Keyframes
//! that stand at one spot and look one way show the same landmarks alike: a binary descriptor survives a change of
//! direction of about 25 degrees ([`association`](crate::metric_map::association)), so of 45 degrees from one side to
//! the other, and a landmark 2.5 m to the side, as near as those of a car park are, turns by that much over two metres. Of
//! a spot of two metres and a sector of 45 degrees, then, so many keyframes are kept: those that show most landmarks which another
//! drive shows, too. What only one drive saw may have driven away. A map so made is as large as the place.
//!
//! After Mühlfellner, Bürki, Bosse, Derendarz, Philippsen & Furgale, *Summary maps for lifelong visual localization*
//! (2016): landmarks are worth keeping by the number of drives that saw them; here the keyframes are chosen that see
//! them, as adjustment wants whole keyframes.
//!
//! Nor does a drive have to do with all of a large map: what it sees is near it ([`touched`]).

use std::collections::BTreeMap;

use rstar::{PointDistance, RTree};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::geometry::pose::Pose;

/// Height of the layers that count as one, metres: about a storey's, so that no floor's unevenness divides it.
const STOREY_M: f64 = 2.5;
/// Sectors that directions of view are sorted into.
const SECTORS: f64 = 8.0;

/// How much of the drives before is kept, and adjusted with new ones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SummaryParams {
    /// Side of the squares that count as one spot (m).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub spot_m: f64,
    /// Keyframes kept of one spot and one direction, at most. At a keyframe every 0.2 m, ten are those of one drive.
    #[schemars(range(min = 1))]
    pub spot_keyframes: usize,
    /// Keyframes before that stand within this range of a new one (m) are adjusted with it; those within twice the range
    /// hold them where the map is; the others are not touched. About as far as a car park's landmarks are seen.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub reach_m: f64,
}

impl Default for SummaryParams {
    fn default() -> Self {
        Self {
            spot_m: 2.0,
            spot_keyframes: 10,
            reach_m: 10.0,
        }
    }
}

/// A keyframe that may be kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// `map_from_vehicle`.
    pub pose: Pose,
    /// Is it kept in any case?
    pub held: bool,
    /// Landmarks it shows that another drive shows, too.
    pub shared: usize,
    /// Landmarks it shows.
    pub seen: usize,
}

/// Which keyframes are kept. Of equal ones the first.
pub fn summary(candidates: &[Candidate], params: &SummaryParams) -> Vec<bool> {
    let mut spots: BTreeMap<[i64; 4], Vec<usize>> = BTreeMap::new();
    for (at, candidate) in candidates.iter().enumerate() {
        let spot = spot(&candidate.pose, params.spot_m);
        spots.entry(spot).or_default().push(at);
    }
    let mut kept: Vec<bool> = candidates.iter().map(|one| one.held).collect();
    for mut at_spot in spots.into_values() {
        at_spot.sort_by_key(|at| {
            let Candidate {
                held, shared, seen, ..
            } = candidates[*at];
            (!held, std::cmp::Reverse((shared, seen)), *at)
        });
        for at in at_spot.into_iter().take(params.spot_keyframes) {
            kept[at] = true;
        }
    }
    kept
}

/// What new drives are to a keyframe of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Touch {
    /// It is adjusted with them.
    Adjusted,
    /// It stays, and holds those that are adjusted.
    Holding,
    /// It has nothing to do with them.
    Untouched,
}

/// How near keyframes (positions in the map, m) are to those of new drives. Without new drives, all are adjusted.
pub fn touched(known: &[[f64; 3]], new: &[[f64; 3]], params: &SummaryParams) -> Vec<Touch> {
    let new = RTree::bulk_load(new.to_vec());
    let touch = |place: &[f64; 3]| {
        let nearest = new.nearest_neighbor(place);
        let away = nearest.map_or(0.0, |new| new.distance_2(place).sqrt());
        if away <= params.reach_m {
            Touch::Adjusted
        } else if away <= 2.0 * params.reach_m {
            Touch::Holding
        } else {
            Touch::Untouched
        }
    };
    known.iter().map(touch).collect()
}

/// Where a vehicle is and whither it looks, roughly.
fn spot(map_from_vehicle: &Pose, spot_m: f64) -> [i64; 4] {
    let place = map_from_vehicle.translation;
    let [column, row] = [place.x, place.y].map(|value| (value / spot_m).floor());
    let storey = (place.z / STOREY_M).round();
    let ahead = map_from_vehicle.rotation * nalgebra::Vector3::x();
    let turns = ahead.y.atan2(ahead.x) / std::f64::consts::TAU;
    let sector = (turns * SECTORS).round().rem_euclid(SECTORS);
    [column, row, storey, sector].map(|value| value as i64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn drive(offset_m: f64, shared: usize) -> impl Iterator<Item = Candidate> {
        (0..100).map(move |at| Candidate {
            pose: Pose::from_yaw(0.2 * f64::from(at), offset_m, 0.0),
            held: false,
            shared,
            seen: 2 * shared,
        })
    }

    fn count(kept: &[bool]) -> usize {
        kept.iter().filter(|kept| **kept).count()
    }

    #[test]
    fn a_map_is_as_large_as_the_place_and_not_as_its_drives() {
        let size = |drives: u32| {
            let all = (0..drives).flat_map(|drive_| drive(0.01 * f64::from(drive_), 10));
            let all: Vec<Candidate> = all.collect();
            count(&summary(&all, &SummaryParams::default()))
        };
        assert_eq!((size(1), size(2), size(30)), (100, 100, 100));
    }

    #[test]
    fn what_other_drives_saw_is_kept_and_so_is_what_must_be() {
        let mut all: Vec<Candidate> = drive(0.1, 1).chain(drive(0.2, 3)).collect();
        all[7].held = true;
        let kept = summary(&all, &SummaryParams::default());
        assert!(kept[7] && count(&kept[100..]) == 99);
        assert_eq!(count(&kept), 100);
    }

    #[test]
    fn what_is_far_from_new_drives_is_not_touched() {
        let known: Vec<[f64; 3]> = (0..5).map(|at| [10.0 * f64::from(at), 0.0, 0.0]).collect();
        let params = SummaryParams::default();
        assert_eq!(
            touched(&known, &[[0.0, 1.0, 0.0], [-5.0, 0.0, 0.0]], &params),
            [
                Touch::Adjusted,
                Touch::Holding,
                Touch::Untouched,
                Touch::Untouched,
                Touch::Untouched
            ]
        );
        assert_eq!(touched(&known, &[], &params), [Touch::Adjusted; 5]);
    }

    #[test]
    fn whoever_drives_the_other_way_sees_something_else() {
        let back = drive(0.1, 1).map(|one| Candidate {
            pose: Pose::from_yaw(one.pose.translation.x, 0.1, std::f64::consts::PI),
            ..one
        });
        let all: Vec<Candidate> = drive(0.1, 1).chain(drive(0.1, 1)).chain(back).collect();
        assert_eq!(count(&summary(&all, &SummaryParams::default())), 200);
    }
}
