//! The keyframes that a map needs, however many drives have gone through it.
//!
//! A map that keeps every keyframe grows with the number of drives, though a place stays as large as it is. Keyframes
//! that stand at one spot show the same landmarks alike: a binary descriptor survives a change of direction of about 25
//! degrees ([`association`](crate::metric_map::association)), so of 45 degrees from one side to the other, and a landmark
//! 2.5 m to the side, as near as those of a car park are, turns by that much over two metres. Of a spot of two metres,
//! then, a few keyframes are kept: one after the other, the one whose landmarks are worth most, where a landmark is worth
//! the number of drives that saw it (what only one saw may have driven away), and half as much for each kept keyframe of
//! the spot that shows it already. So those that look another way come next, whatever cameras a vehicle has: a rig that
//! sees all around shows from one spot the same both ways, a single camera does not. A map so made is as large as the
//! place.
//!
//! After Mühlfellner, Bürki, Bosse, Derendarz, Philippsen & Furgale, *Summary maps for lifelong visual localization*
//! (2016): landmarks are worth keeping by the number of drives that saw them; here the keyframes are chosen that see
//! them, as adjustment wants whole keyframes. Halving is the greedy cover of Dymczyk et al., *The gist of maps* (2015), with
//! a landmark wanted more than once.
//!
//! Nor does a drive have to do with all of a large map: what it sees is near it ([`touched`]).

use std::collections::BTreeMap;

use rstar::{PointDistance, RTree};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::geometry::pose::Pose;

/// Height of the layers that count as one, metres: about a storey's, so that no floor's unevenness divides it.
const STOREY_M: f64 = 2.5;

/// How much of the drives before is kept, and adjusted with new ones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SummaryParams {
    /// Side of the squares that count as one spot (m).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub spot_m: f64,
    /// Keyframes kept of one spot, at most. Four are one each half metre; for cameras that look one way, one each metre and
    /// direction of driving.
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
            spot_keyframes: 4,
            reach_m: 10.0,
        }
    }
}

/// A keyframe that may be kept.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// `map_from_vehicle`.
    pub pose: Pose,
    /// Is it kept in any case?
    pub held: bool,
    /// Landmarks it shows, by name.
    pub landmarks: Vec<u32>,
}

/// Which keyframes are kept; `drives` is the number of drives that saw a landmark. Of equal ones the first.
pub fn summary(
    candidates: &[Candidate],
    drives: &dyn Fn(u32) -> usize,
    params: &SummaryParams,
) -> Vec<bool> {
    let mut spots: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (at, candidate) in candidates.iter().enumerate() {
        let spot = spot(&candidate.pose, params.spot_m);
        spots.entry(spot).or_default().push(at);
    }
    let mut kept: Vec<bool> = candidates.iter().map(|one| one.held).collect();
    for at_spot in spots.into_values() {
        let (held, mut others): (Vec<usize>, Vec<usize>) =
            at_spot.into_iter().partition(|at| kept[*at]);
        let mut shown: BTreeMap<u32, i32> = BTreeMap::new();
        let show = |at: usize, shown: &mut BTreeMap<u32, i32>| {
            for landmark in &candidates[at].landmarks {
                *shown.entry(*landmark).or_default() += 1;
            }
        };
        held.iter().for_each(|at| show(*at, &mut shown));
        for _ in held.len()..params.spot_keyframes {
            let worth = |at: &usize| -> f64 {
                let landmarks = candidates[*at].landmarks.iter();
                let worth = |name: &u32| {
                    drives(*name) as f64 * 0.5_f64.powi(shown.get(name).copied().unwrap_or(0))
                };
                landmarks.map(worth).sum()
            };
            let worths = others.iter().map(worth).enumerate();
            let best = worths.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
            let Some((best, _)) = best else {
                break;
            };
            let best = others.remove(best);
            kept[best] = true;
            show(best, &mut shown);
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

/// Where a vehicle is, roughly.
fn spot(map_from_vehicle: &Pose, spot_m: f64) -> [i64; 3] {
    let place = map_from_vehicle.translation;
    let [column, row] = [place.x, place.y].map(|value| (value / spot_m).floor());
    let storey = (place.z / STOREY_M).round();
    [column, row, storey].map(|value| value as i64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// A drive along 20 m whose keyframes show ten landmarks each, two metres ahead of them, named from `first` on.
    fn drive(offset_m: f64, yaw: f64, first: u32) -> impl Iterator<Item = Candidate> {
        (0..100_u32).map(move |at| Candidate {
            pose: Pose::from_yaw(0.2 * f64::from(at), offset_m, yaw),
            held: false,
            landmarks: (first + at / 10 * 10..).take(10).collect(),
        })
    }

    fn count(kept: &[bool]) -> usize {
        kept.iter().filter(|kept| **kept).count()
    }

    #[test]
    fn a_map_is_as_large_as_the_place_and_not_as_its_drives() {
        let size = |drives: u32| {
            let all = (0..drives).flat_map(|drive_| drive(0.01 * f64::from(drive_), 0.0, 0));
            let all: Vec<Candidate> = all.collect();
            count(&summary(
                &all,
                &|_| drives as usize,
                &SummaryParams::default(),
            ))
        };
        assert_eq!((size(1), size(2), size(30)), (40, 40, 40));
    }

    #[test]
    fn what_other_drives_saw_is_kept_and_so_is_what_must_be() {
        let mut all: Vec<Candidate> = drive(0.1, 0.0, 0).chain(drive(0.2, 0.0, 1000)).collect();
        all[7].held = true;
        let drives = |landmark: u32| if landmark < 1000 { 1 } else { 9 };
        let kept = summary(&all, &drives, &SummaryParams::default());
        assert!(kept[7] && count(&kept[100..]) == 39);
        assert_eq!(count(&kept), 40);
    }

    #[test]
    fn what_shows_something_else_is_kept_beside_what_shows_more() {
        // The other way, a single camera sees other landmarks, that fewer drives saw.
        let back = drive(0.1, std::f64::consts::PI, 1000);
        let all: Vec<Candidate> = drive(0.1, 0.0, 0).chain(back).collect();
        let drives = |landmark: u32| if landmark < 1000 { 3 } else { 2 };
        let kept = summary(&all, &drives, &SummaryParams::default());
        assert_eq!((count(&kept[..100]), count(&kept[100..])), (20, 20));
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
}
