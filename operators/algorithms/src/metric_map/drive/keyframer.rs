//! Due points and frame sets brought together.

use std::collections::VecDeque;

use super::continuity::{Continued, Continuity};
use super::frame_sets::{FrameSet, FrameSets, PosedFrameSet};
use super::selector::{Due, KeyframeSelector};
use super::{DriveLosses, Exposure, KeyframeParams, Outside, nanoseconds};
use crate::geometry::pose::Pose;

/// One keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe<I> {
    /// Its number: the first is 0.
    pub number: u32,
    /// That of its frame set; without images, when the path length was reached. ns UTC.
    pub stamp: i64,
    /// The stretch of unbroken odometry that it lies in: 0, and one more behind each break.
    pub stretch: u32,
    /// Pose of the vehicle at that stamp, in the frame that the stretch's odometry began in.
    pub odom_from_vehicle: Pose,
    /// Driven path since the start, without breaks, metres.
    pub distance_m: f64,
    /// Its images, by camera; none where no frame set came in time.
    pub exposures: Vec<Exposure<I>>,
}

/// One drive at work: odometry goes in, due points come up, and wait for their frame set.
#[derive(Debug, Clone)]
pub struct Keyframer<I> {
    continuity: Continuity,
    path: Path,
    sets: FrameSets<I>,
    max_wait_ns: i64,
    /// Frames before the first message and after the last one.
    outside: [Outside; 2],
    /// The latest message.
    previous: Option<(i64, Pose)>,
    /// Stamp of the last keyframe.
    last: Option<i64>,
    given: u32,
}

impl<I> Keyframer<I> {
    /// A drive with these exposures, in any order; of several with one camera and stamp the first one counts. The
    /// parameters have passed [`KeyframeParams::check`].
    pub fn new(params: KeyframeParams, exposures: Vec<Exposure<I>>) -> Self {
        Self {
            continuity: Continuity::new(params.limits),
            path: Path::new(KeyframeSelector::new(params)),
            sets: FrameSets::new(exposures, nanoseconds(params.max_gap_s)),
            max_wait_ns: nanoseconds(params.max_wait_s),
            outside: [Outside::default(); 2],
            previous: None,
            last: None,
            given: 0,
        }
    }

    /// Takes the next odometry message, and gives the keyframes that nothing which is still to come can change.
    pub fn push(&mut self, stamp: i64, odom_from_vehicle: &Pose) -> Vec<Keyframe<I>> {
        let Some(Continued { pose, anew }) = self.continuity.push(stamp, odom_from_vehicle) else {
            return Vec::new();
        };
        if anew {
            self.path.selector.break_off();
        }
        self.path.push(stamp, &pose);
        if self.previous.is_none() {
            let before = |set: i64| stamp.saturating_sub(set);
            self.outside[0] = self.sets.outside(self.max_wait_ns, before);
        }
        let from = self.previous.filter(|_| !anew);
        let from = from.as_ref().map(|(stamp, pose)| (*stamp, pose));
        self.sets.place(self.path.stretch, from, (stamp, &pose));
        self.previous = Some((stamp, pose));
        std::iter::from_fn(|| self.next(false)).collect()
    }

    /// There is no more odometry: gives the other keyframes.
    pub fn finish(&mut self) -> Vec<Keyframe<I>> {
        if let Some((stamp, _)) = self.previous {
            let after = |set: i64| set.saturating_sub(stamp);
            self.outside[1] = self.sets.outside(self.max_wait_ns, after);
        }
        std::iter::from_fn(|| self.next(true)).collect()
    }

    /// What was left out so far; late frames are known once it is finished.
    pub fn losses(&self) -> DriveLosses {
        let [early_frames, late_frames] = self.outside;
        DriveLosses {
            repeated_frames: self.sets.repeated,
            early_frames,
            late_frames,
            ..self.continuity.losses()
        }
    }

    fn next(&mut self, finished: bool) -> Option<Keyframe<I>> {
        let due = self.path.next_after(self.last)?;
        while self
            .sets
            .placed
            .pop_front_if(|placed| placed.set.stamp < due.stamp)
            .is_some()
        {}
        let wait_ns = self.max_wait_ns;
        let in_time = |set: &FrameSet<I>| set.stamp.saturating_sub(due.stamp) <= wait_ns;
        if self.sets.placed.is_empty() && !finished && self.sets.ahead.front().is_some_and(in_time)
        {
            return None;
        }
        let serves =
            |placed: &PosedFrameSet<I>| placed.stretch == due.stretch && in_time(&placed.set);
        let keyframe = match self.sets.placed.front().is_some_and(serves) {
            true => {
                let best = self.best(finished)?;
                self.sets.placed.drain(..best);
                let placed = self.sets.placed.pop_front()?;
                self.of_set(placed)
            }
            false => self.keyframe(due, Vec::new()),
        };
        self.path.due.pop_front();
        Some(keyframe)
    }

    /// The place of the set that serves whom the first placed one could: the first of those with the slowest cameras before
    /// the next due point, which is served by what follows it. Whoever took the first one always would let faster cameras
    /// take keyframes away from slower ones. `None` where odometry that is still to come decides.
    fn best(&self, finished: bool) -> Option<usize> {
        let first = self.sets.placed.front()?;
        let rank = first.set.rank;
        if rank == 0 {
            return Some(0);
        }
        let (last, following) = self.path.around(first.set.stamp);
        let last = last.unwrap_or(first.set.stamp);
        let may_serve = |set: &&FrameSet<I>| {
            set.stamp.saturating_sub(last) <= self.max_wait_ns
                && following.is_none_or(|due| set.stamp < due)
        };
        let placed = self.sets.placed.iter();
        let of_stretch = placed.take_while(|placed| placed.stretch == first.stretch);
        let placed = of_stretch.map(|placed| &placed.set).take_while(may_serve);
        if following.is_none() && !finished {
            let ahead = self.sets.ahead.iter().take_while(may_serve);
            if placed.clone().chain(ahead).any(|set| set.rank < rank) {
                return None;
            }
        }
        let (best, _) = placed.enumerate().min_by_key(|(_, set)| set.rank)?;
        Some(best)
    }

    fn of_set(&mut self, placed: PosedFrameSet<I>) -> Keyframe<I> {
        let PosedFrameSet {
            mut set,
            pose,
            stretch,
        } = placed;
        set.exposures.sort_by(|a, b| a.camera.cmp(&b.camera));
        let at = Due {
            stamp: set.stamp,
            odom_from_vehicle: pose,
            path_m: self.path.distance_m(set.stamp, &pose),
            stretch,
        };
        self.keyframe(at, set.exposures)
    }

    fn keyframe(&mut self, at: Due, exposures: Vec<Exposure<I>>) -> Keyframe<I> {
        let number = self.given;
        self.given = self.given.saturating_add(1);
        self.last = Some(at.stamp);
        Keyframe {
            number,
            stamp: at.stamp,
            stretch: at.stretch,
            odom_from_vehicle: at.odom_from_vehicle,
            distance_m: at.path_m,
            exposures,
        }
    }
}

/// The driven path, as due points that no frame set has served yet; their path goes on over stretches.
#[derive(Debug, Clone)]
struct Path {
    selector: KeyframeSelector,
    stretch: u32,
    /// Path driven in the stretches before this one.
    before_stretch_m: f64,
    due: VecDeque<Due>,
    last_m: f64,
}

impl Path {
    fn new(selector: KeyframeSelector) -> Self {
        Self {
            selector,
            stretch: 0,
            before_stretch_m: 0.0,
            due: VecDeque::new(),
            last_m: 0.0,
        }
    }

    fn push(&mut self, stamp: i64, pose: &Pose) {
        for mut due in self.selector.push(stamp, pose) {
            if due.stretch != self.stretch {
                self.stretch = due.stretch;
                self.before_stretch_m = self.last_m;
            }
            due.path_m += self.before_stretch_m;
            self.last_m = due.path_m;
            self.due.push_back(due);
        }
    }

    /// The next due point after an instant; those up to it are dropped.
    fn next_after(&mut self, stamp: Option<i64>) -> Option<Due> {
        let passed = |due: &mut Due| stamp.is_some_and(|stamp| due.stamp <= stamp);
        while self.due.pop_front_if(passed).is_some() {}
        self.due.front().copied()
    }

    /// Stamps of the last due point up to an instant, and of the next one behind it.
    fn around(&self, stamp: i64) -> (Option<i64>, Option<i64>) {
        let following = self.due.partition_point(|due| due.stamp <= stamp);
        let stamp_of = |at: usize| self.due.get(at).map(|due| due.stamp);
        (
            following.checked_sub(1).and_then(stamp_of),
            stamp_of(following),
        )
    }

    /// Driven path at a pose: that of the last due point before it, and the straight line from there.
    fn distance_m(&self, stamp: i64, pose: &Pose) -> f64 {
        let before = self.due.iter().take_while(|due| due.stamp <= stamp).last();
        before.map_or(0.0, |due| {
            due.path_m + (pose.translation - due.odom_from_vehicle.translation).norm()
        })
    }
}

#[cfg(test)]
mod tests;
