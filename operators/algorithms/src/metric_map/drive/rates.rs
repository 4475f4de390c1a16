//! Cameras of one rate, apart from those of others.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use super::Exposure;

/// Rates that differ by less than this factor are one: stamps waver, and clocks drift.
const ALIKE: f64 = 1.1;
/// The rate of a camera is known from so many steps between frames on.
const FEWEST_STEPS: usize = 8;

/// The exposures of cameras of one rate, for each rate from the slowest on; in the order given, which is that of stamps.
///
/// The rate of a camera is the median of the steps between its frames: one that drops some of them, begins late or stops
/// keeps its rate. Cameras of a few frames are taken to be as slow as the slowest.
pub(super) fn by_rate<I>(exposures: Vec<Exposure<I>>) -> Vec<Vec<Exposure<I>>> {
    let ranks = ranks(&exposures);
    let mut groups: Vec<Vec<Exposure<I>>> = Vec::new();
    for exposure in exposures {
        let rank = ranks.get(&exposure.camera).copied().unwrap_or(0);
        if groups.len() <= rank {
            groups.resize_with(rank + 1, Vec::new);
        }
        groups[rank].push(exposure);
    }
    groups
}

/// The place of each camera whose rate is known among the rates, 0 for the slowest.
fn ranks<I>(exposures: &[Exposure<I>]) -> BTreeMap<String, usize> {
    let mut slowest_first: Vec<(&str, i64)> = periods(exposures).into_iter().collect();
    slowest_first.sort_by_key(|(_, period_ns)| Reverse(*period_ns));
    let (mut rank, mut longest_ns) = (0, None);
    let ranked = slowest_first.into_iter().map(|(camera, period_ns)| {
        let of_rank = *longest_ns.get_or_insert(period_ns);
        if period_ns as f64 * ALIKE < of_rank as f64 {
            rank += 1;
            longest_ns = Some(period_ns);
        }
        (camera.to_owned(), rank)
    });
    ranked.collect()
}

/// The usual time from one frame of a camera to its next, ns.
fn periods<I>(exposures: &[Exposure<I>]) -> BTreeMap<&str, i64> {
    let mut stamps: BTreeMap<&str, Vec<i64>> = BTreeMap::new();
    for exposure in exposures {
        let of_camera = stamps.entry(&exposure.camera).or_default();
        of_camera.push(exposure.stamp);
    }
    let period = |(camera, stamps): (_, Vec<i64>)| {
        let pairs = stamps.iter().zip(stamps.iter().skip(1));
        let mut steps: Vec<i64> = pairs.map(|(a, b)| b.saturating_sub(*a)).collect();
        if steps.len() < FEWEST_STEPS {
            return None;
        }
        let middle = (steps.len() - 1) / 2;
        Some((camera, *steps.select_nth_unstable(middle).1))
    };
    stamps.into_iter().filter_map(period).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cameras of each rate, from the slowest on, of cameras by their stamps.
    fn rates(cameras: &[(&str, Vec<i64>)]) -> Vec<Vec<String>> {
        let mut exposures = Vec::new();
        for (camera, stamps) in cameras {
            exposures.extend(stamps.iter().map(|stamp| Exposure {
                stamp: *stamp,
                camera: (*camera).to_owned(),
                image: (),
            }));
        }
        exposures.sort_by_key(|exposure| exposure.stamp);
        let names = |group: Vec<Exposure<()>>| {
            assert!(group.is_sorted_by_key(|exposure| exposure.stamp));
            let mut names: Vec<_> = group.into_iter().map(|found| found.camera).collect();
            names.sort_unstable();
            names.dedup();
            names
        };
        by_rate(exposures).into_iter().map(names).collect()
    }

    fn every(step: i64) -> Vec<i64> {
        (0..40).map(|frame| frame * step).collect()
    }

    #[test]
    fn cameras_go_by_their_rate_from_the_slowest_on() {
        let cameras = [
            ("front", every(40)),
            ("left", every(100)),
            ("rear", every(104)),
            ("top", every(1000)),
        ];
        let expected = [vec!["top"], vec!["left", "rear"], vec!["front"]];
        assert_eq!(rates(&cameras), expected);
        assert!(rates(&[]).is_empty());
    }

    #[test]
    fn drops_jitter_a_late_begin_and_an_early_end_leave_the_rate_as_it_is() {
        let kept = |frames: fn(i64) -> bool| -> Vec<i64> {
            (0..40)
                .filter(|at| frames(*at))
                .map(|at| at * 100)
                .collect()
        };
        let jitter = (0..40).map(|at| at * 100 + [0, 9, -7, 12, -3][at as usize % 5]);
        let cameras = [
            ("drops", kept(|at| at % 5 != 1 && at % 7 != 3)),
            ("ends", kept(|at| at < 12)),
            ("late", kept(|at| at > 25)),
            ("shakes", jitter.collect()),
            ("steady", every(100)),
        ];
        assert_eq!(rates(&cameras).len(), 1);
    }

    #[test]
    fn a_camera_of_a_few_frames_is_as_slow_as_the_slowest() {
        let few = vec![3, 4, 5, 6, 7, 8, 9, 10];
        let cameras = [("few", few), ("front", every(40)), ("left", every(100))];
        assert_eq!(rates(&cameras), [vec!["few", "left"], vec!["front"]]);
    }
}
