//! The images of all cameras at one time.

use std::collections::VecDeque;

use super::continuity::LONGEST_PAUSE_S;
use super::rates::by_rate;
use super::{Outside, nanoseconds};
use crate::geometry::pose::Pose;

/// One image of one camera; `I` says where its pixels are.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure<I> {
    /// When, ns UTC.
    pub stamp: i64,
    /// Name of the camera.
    pub camera: String,
    /// The image.
    pub image: I,
}

/// At most one exposure of each camera. Its stamp is that of the first of its slowest cameras.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FrameSet<I> {
    pub(super) stamp: i64,
    pub(super) exposures: Vec<Exposure<I>>,
    /// The rate of its slowest cameras among those of the rig: 0 is the slowest.
    pub(super) rank: usize,
}

impl<I> FrameSet<I> {
    fn takes(&self, exposure: &Exposure<I>, max_gap_ns: i64) -> bool {
        let of_camera = |other: &Exposure<I>| other.camera == exposure.camera;
        exposure.stamp.saturating_sub(self.stamp) <= max_gap_ns
            && !self.exposures.iter().any(of_camera)
    }

    /// Whether all exposures of another set are this near to its stamp.
    fn is_near(&self, other: &Self, max_gap_ns: i64) -> bool {
        let near = |exposure: &Exposure<I>| {
            i64::try_from(exposure.stamp.abs_diff(self.stamp)).is_ok_and(|gap| gap <= max_gap_ns)
        };
        other.exposures.iter().all(near)
    }
}

/// Sets of cameras of one rate, whose exposures are in order of stamp: each is of the frames that follow its first.
fn consecutive<I>(exposures: Vec<Exposure<I>>, rank: usize, max_gap_ns: i64) -> Vec<FrameSet<I>> {
    let mut sets: Vec<FrameSet<I>> = Vec::new();
    for exposure in exposures {
        match sets.last_mut() {
            Some(set) if set.takes(&exposure, max_gap_ns) => set.exposures.push(exposure),
            _ => sets.push(FrameSet {
                stamp: exposure.stamp,
                exposures: vec![exposure],
                rank,
            }),
        }
    }
    sets
}

/// The sets of slower cameras, each with the nearest set of faster ones, and the other sets of the faster ones; in order of
/// stamp, as both are.
fn joined<I>(
    slower: Vec<FrameSet<I>>,
    faster: Vec<FrameSet<I>>,
    max_gap_ns: i64,
) -> Vec<FrameSet<I>> {
    let mut faster = VecDeque::from(faster);
    let mut sets = Vec::with_capacity(slower.len().max(faster.len()));
    for mut set in slower {
        let after = faster.partition_point(|other| other.stamp <= set.stamp);
        let neighbours = [after.checked_sub(1), Some(after)].into_iter().flatten();
        let near = neighbours.filter_map(|at| {
            let other = faster
                .get(at)
                .filter(|other| set.is_near(other, max_gap_ns))?;
            Some((other.stamp.abs_diff(set.stamp), at))
        });
        if let Some((_, nearest)) = near.min() {
            sets.extend(faster.drain(..nearest));
            let exposures = faster.pop_front().map(|other| other.exposures);
            set.exposures.extend(exposures.unwrap_or_default());
        }
        sets.push(set);
    }
    sets.extend(faster);
    sets.sort_by_key(|set| set.stamp);
    sets
}

/// A frame set that odometry has passed.
#[derive(Debug, Clone)]
pub(super) struct PosedFrameSet<I> {
    pub(super) set: FrameSet<I>,
    pub(super) pose: Pose,
    /// The stretch of odometry that it lies in.
    pub(super) stretch: u32,
}

/// A session's frame sets: those that odometry has passed have a pose.
#[derive(Debug, Clone)]
pub(super) struct FrameSets<I> {
    pub(super) placed: VecDeque<PosedFrameSet<I>>,
    pub(super) ahead: VecDeque<FrameSet<I>>,
    /// Exposures left out: the camera has another one with their stamp.
    pub(super) repeated: u64,
    /// The time from the first set to the last one, ns.
    span_ns: i64,
}

impl<I> FrameSets<I> {
    /// Sets of exposures in any order; of several with one camera and stamp the first one given stays.
    pub(super) fn new(mut exposures: Vec<Exposure<I>>, max_gap_ns: i64) -> Self {
        exposures.sort_by(|a, b| (a.stamp, &a.camera).cmp(&(b.stamp, &b.camera)));
        let all = exposures.len();
        exposures.dedup_by(|b, a| (a.stamp, &a.camera) == (b.stamp, &b.camera));
        let repeated = (all - exposures.len()) as u64;
        let mut sets = Vec::new();
        for (rank, exposures) in by_rate(exposures).into_iter().enumerate() {
            let of_rate = consecutive(exposures, rank, max_gap_ns);
            sets = joined(sets, of_rate, max_gap_ns);
        }
        let ahead = VecDeque::from(sets);
        let ends = ahead.front().zip(ahead.back());
        let span_ns = ends.map_or(0, |(first, last)| last.stamp.saturating_sub(first.stamp));
        Self {
            placed: VecDeque::new(),
            ahead,
            repeated,
            span_ns,
        }
    }

    /// The exposures ahead that lie outside of the odometry's time by more than is borne: `beyond` says of a stamp how many
    /// nanoseconds.
    pub(super) fn outside(&self, least_ns: i64, beyond: impl Fn(i64) -> i64) -> Outside {
        let borne_ns = borne_ns(self.span_ns, least_ns);
        let mut outside = Outside::default();
        for set in &self.ahead {
            let beyond_ns = beyond(set.stamp);
            if beyond_ns > borne_ns {
                outside.frames += set.exposures.len() as u64;
                outside.farthest_ns = outside.farthest_ns.max(beyond_ns);
            }
        }
        outside
    }

    /// Gives a pose of this stretch to the frame sets up to `to`; those that lie before `from`, or before `to` where
    /// there is no path between the two, have none and are dropped.
    pub(super) fn place(&mut self, stretch: u32, from: Option<(i64, &Pose)>, to: (i64, &Pose)) {
        while let Some(set) = self.ahead.pop_front_if(|set| set.stamp <= to.0) {
            let from = from
                .filter(|from| from.0 < set.stamp)
                .or((set.stamp == to.0).then_some(to));
            if let Some(from) = from {
                let pose = Pose::at_stamp(set.stamp, from, to);
                self.placed.push_back(PosedFrameSet { set, pose, stretch });
            }
        }
    }
}

/// How long before odometry begins and after it ends frames are borne that it does not reach, ns.
///
/// A recorder does not begin with all topics at once, and cameras are often switched on first: a tenth of the time of a
/// drive (`span_ns`) may lie outside, so that half a drive without odometry is told of any drive; but `least_ns` in any
/// case, and no more than odometry may pause within a drive.
pub fn borne_ns(span_ns: i64, least_ns: i64) -> i64 {
    let most_ns = nanoseconds(LONGEST_PAUSE_S);
    (span_ns / 10).min(most_ns).max(least_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sets(exposures: &[(&str, i64)]) -> FrameSets<usize> {
        let given = exposures.iter().enumerate();
        let exposure = |(image, (camera, stamp)): (usize, &(&str, i64))| Exposure {
            stamp: *stamp,
            camera: (*camera).to_owned(),
            image,
        };
        FrameSets::new(given.map(exposure).collect(), 40)
    }

    fn images(set: &FrameSet<usize>) -> Vec<usize> {
        set.exposures.iter().map(|found| found.image).collect()
    }

    #[test]
    fn a_set_ends_by_time_and_by_camera() {
        let sets = sets(&[
            ("left", 100),
            ("left", 0),
            ("front", 30),
            ("rear", 60),
            ("rear", 60),
        ]);
        let found: Vec<_> = sets
            .ahead
            .iter()
            .map(|set| (set.stamp, images(set)))
            .collect();
        assert_eq!(found, [(0, vec![1, 2]), (60, vec![3, 0])]);
        assert_eq!(sets.repeated, 1);
    }

    #[test]
    fn sets_of_slower_cameras_take_the_nearest_of_faster_ones_and_keep_their_stamps() {
        let mut exposures = Vec::new();
        for at in 0..20 {
            exposures.extend([("left", at * 100), ("rear", at * 100 + 30)]);
        }
        // The front's are 5 before and 28, 61 … after the first of the left camera.
        exposures.extend((0..60).map(|at| ("front", at * 33 - 5)));
        let sets = sets(&exposures);
        let slow: Vec<_> = sets.ahead.iter().filter(|set| set.rank == 0).collect();
        let stamps = slow.iter().map(|set| set.stamp);
        assert!(stamps.eq((0..20).map(|at| at * 100)));
        for set in &slow {
            let cameras: Vec<_> = set.exposures.iter().map(|of| of.camera.as_str()).collect();
            assert_eq!(cameras, ["left", "rear", "front"]);
            let front = set.exposures[2].stamp;
            assert!((front - set.stamp).abs() <= 17, "{front} of {}", set.stamp);
        }
        let alone: Vec<_> = sets.ahead.iter().filter(|set| set.rank == 1).collect();
        assert_eq!(alone.len(), 40);
        assert!(alone.iter().all(|set| set.exposures.len() == 1));
        assert!(sets.ahead.iter().is_sorted_by_key(|set| set.stamp));
    }

    #[test]
    fn sets_are_placed_on_the_path_or_dropped() {
        let mut sets = sets(&[("a", 0), ("a", 50), ("a", 150), ("a", 250), ("a", 400)]);
        let at = |x: f64| Pose::from_yaw(x, 0.0, 0.0);
        sets.place(0, None, (50, &at(1.0)));
        sets.place(0, Some((50, &at(1.0))), (250, &at(3.0)));
        let placed = sets.placed.iter();
        let placed: Vec<_> = placed
            .map(|placed| (placed.set.stamp, placed.pose.translation.x))
            .collect();
        assert_eq!(placed, [(50, 1.0), (150, 2.0), (250, 3.0)]);
        assert_eq!(sets.ahead.len(), 1);
    }

    #[test]
    fn a_tenth_of_the_time_of_frames_may_lie_outside_but_not_more_than_odometry_may_pause() {
        const S: i64 = 1_000_000_000;
        let late = |seconds: i64, end: i64| {
            let frames: Vec<_> = (0..=seconds).map(|second| ("a", second * S)).collect();
            let outside = sets(&frames).outside(S, |stamp| stamp - end * S);
            (outside.frames, outside.farthest_ns / S)
        };
        assert_eq!(late(4, 3), (0, 0));
        assert_eq!(late(4, 2), (1, 2));
        assert_eq!(late(30, 27), (0, 0));
        assert_eq!(late(30, 15), (12, 15));
        assert_eq!(late(1000, 995), (0, 0));
        assert_eq!(late(1000, 994), (1, 6));
    }
}
