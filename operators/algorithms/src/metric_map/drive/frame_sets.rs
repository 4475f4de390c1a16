//! The images of all cameras at one time.

use std::collections::VecDeque;

use super::continuity::LONGEST_PAUSE_S;
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

/// At most one exposure of each camera. Its stamp is that of the first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FrameSet<I> {
    pub(super) stamp: i64,
    pub(super) exposures: Vec<Exposure<I>>,
}

impl<I> FrameSet<I> {
    fn takes(&self, exposure: &Exposure<I>, max_gap_ns: i64) -> bool {
        let of_camera = |other: &Exposure<I>| other.camera == exposure.camera;
        exposure.stamp.saturating_sub(self.stamp) <= max_gap_ns
            && !self.exposures.iter().any(of_camera)
    }
}

/// A frame set that odometry has passed.
#[derive(Debug, Clone)]
pub(super) struct Placed<I> {
    pub(super) set: FrameSet<I>,
    pub(super) pose: Pose,
    /// The stretch of odometry that it lies in.
    pub(super) stretch: u32,
}

/// A session's frame sets: those that odometry has passed have a pose.
#[derive(Debug, Clone)]
pub(super) struct FrameSets<I> {
    pub(super) placed: VecDeque<Placed<I>>,
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
        let mut ahead: VecDeque<FrameSet<I>> = VecDeque::new();
        for exposure in exposures {
            match ahead.back_mut() {
                Some(set) if set.takes(&exposure, max_gap_ns) => set.exposures.push(exposure),
                _ => ahead.push_back(FrameSet {
                    stamp: exposure.stamp,
                    exposures: vec![exposure],
                }),
            }
        }
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
                self.placed.push_back(Placed { set, pose, stretch });
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
