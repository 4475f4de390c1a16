//! Due points and frame sets brought together.

use std::collections::VecDeque;

use super::continuity::{Continued, Continuity};
use super::frame_sets::{FrameSet, FrameSets, Placed};
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
        let serves = |placed: &mut Placed<I>| placed.stretch == due.stretch && in_time(&placed.set);
        let keyframe = match self.sets.placed.pop_front_if(serves) {
            Some(placed) => self.of_set(placed),
            None => self.keyframe(due, Vec::new()),
        };
        self.path.due.pop_front();
        Some(keyframe)
    }

    fn of_set(&mut self, placed: Placed<I>) -> Keyframe<I> {
        let Placed {
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

    /// Driven path at a pose: that of the last due point before it, and the straight line from there.
    fn distance_m(&self, stamp: i64, pose: &Pose) -> f64 {
        let before = self.due.iter().take_while(|due| due.stamp <= stamp).last();
        before.map_or(0.0, |due| {
            due.path_m + (pose.translation - due.odom_from_vehicle.translation).norm()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;

    /// Stamps (s), path (m) and numbers of exposures of a drive along x, at one metre of baseline.
    fn drive(odometry: &[(i64, f64)], frames: &[(i64, &str)]) -> Vec<(i64, f64, usize)> {
        let params = KeyframeParams {
            baseline_m: 1.0,
            ..KeyframeParams::default()
        };
        let exposures = frames.iter().map(|(second, camera)| Exposure {
            stamp: second * S,
            camera: (*camera).to_owned(),
            image: (),
        });
        let mut keyframer = Keyframer::new(params, exposures.collect());
        let mut found = Vec::new();
        for (second, x) in odometry {
            found.extend(keyframer.push(second * S, &Pose::from_yaw(*x, 0.0, 0.0)));
        }
        found.extend(keyframer.finish());
        assert!(
            (0..)
                .zip(&found)
                .all(|(number, keyframe)| keyframe.number == number)
        );
        let short = |of: Keyframe<()>| (of.stamp / S, of.distance_m, of.exposures.len());
        found.into_iter().map(short).collect()
    }

    #[test]
    fn a_due_point_is_served_by_the_next_frame_set() {
        let odometry = [(0, 0.0), (1, 0.5), (2, 1.5), (3, 2.5)];
        let frames = [(0, "a"), (0, "b"), (1, "a"), (2, "a"), (2, "b"), (3, "b")];
        let found = drive(&odometry, &frames);
        assert_eq!(found, [(0, 0.0, 2), (2, 1.5, 2), (3, 2.5, 1)]);
    }

    #[test]
    fn nobody_waits_longer_than_allowed() {
        let odometry = [(0, 0.0), (5, 5.0), (10, 10.0)];
        let found = drive(&odometry, &[(3, "a"), (10, "a")]);
        // The sets of 3 s and 10 s serve whoever is due up to a second earlier.
        let bare: Vec<_> = found
            .iter()
            .filter(|found| found.2 == 0)
            .map(|found| found.0)
            .collect();
        assert_eq!(bare, [0, 1, 4, 5, 6, 7, 8]);
        assert_eq!(found.len(), 9);
    }

    #[test]
    fn path_goes_on_over_a_jump_but_no_frame_set_lies_in_it() {
        let odometry = [(0, 0.0), (2, 2.0), (4, 300.0), (5, 301.0)];
        let found = drive(&odometry, &[(3, "a"), (5, "a")]);
        assert_eq!(found, [(0, 0.0, 0), (1, 1.0, 0), (2, 2.0, 0), (5, 3.0, 1)]);
    }

    #[test]
    fn no_frame_set_serves_a_due_point_of_another_stretch() {
        let mut keyframer = Keyframer::new(
            KeyframeParams {
                baseline_m: 1.0,
                ..KeyframeParams::default()
            },
            vec![Exposure {
                stamp: 26 * S / 10,
                camera: "a".into(),
                image: (),
            }],
        );
        let odometry = [(0, 0.0), (20, 2.0), (25, 300.0), (35, 301.0)];
        let mut found = Vec::new();
        for (tenth, x) in odometry {
            let pose = Pose::from_yaw(x, 0.0, 0.0);
            found.extend(keyframer.push(tenth * S / 10, &pose));
        }
        found.extend(keyframer.finish());
        let short = found
            .iter()
            .map(|of| (of.stamp * 10 / S, of.stretch, of.exposures.len()));
        let expected = [(0, 0, 0), (10, 0, 0), (20, 0, 0), (26, 1, 1), (35, 1, 0)];
        assert_eq!(short.collect::<Vec<_>>(), expected);
    }
}
