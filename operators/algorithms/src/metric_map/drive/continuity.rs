//! Where odometry goes on, and where it was set anew.
//!
//! A node that is started again begins at zero, a filter that is corrected jumps: neither is driven path. What is, follows
//! from what vehicles can do between two messages, however far apart these are ([`MotionLimits`]): at 1 Hz a car on a
//! motorway is 33 m farther with each message, at 50 Hz a step of one metre is none.
//!
//! With `w` the time over which the velocity `v` was last seen and `dt` the time to the next message, an acceleration of
//! at most `a` leaves the vehicle within
//!
//! ```text
//! ½ a dt (dt + w)  +  |v| τ  +  s
//! ```
//!
//! of where `v` leads: the velocity is that of the middle of `w`, stamps are off by up to `τ`, and `s` is what odometry
//! itself may be off by. Smaller jumps are not to be told from slipping wheels; who weighs odometry must be robust
//! against both.
//!
//! A vehicle does not stop because its odometry did: over a jump within a fifth of a second it is taken to have gone on
//! with its last twist, which is right to `½ a dt²`, some centimetres. What follows is continued from there, and the
//! chain is unbroken. Over longer ones nobody knows how it moved: a new stretch begins.

use std::collections::VecDeque;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::DriveLosses;
use crate::geometry::lie::se3;
use crate::geometry::pose::Pose;

/// Stamps are off by up to this (s): of a message that is stamped when it is received.
const STAMP_ERROR_S: f64 = 0.1;

/// What a step may be off by beside that (m, rad): ticks, and corrections of a filter.
const SLACK_M: f64 = 0.5;
const SLACK_RAD: f64 = 0.2;

/// The velocity is that over at least so long (s), twice what stamps are off by.
const WINDOW_S: f64 = 0.2;

/// Over a jump within this (s) the vehicle goes on as before.
const BRIDGED_S: f64 = 0.2;

/// Odometry that jumps again before so long (s) is not continued: it is broken.
const SOUND_S: f64 = 1.0;

/// Where odometry paused for longer (s) and the vehicle is elsewhere since ([`FAR_M`]), nobody knows which way it took: a
/// car may have gone round a block. Messages may be as rare as that, or every fifth one be there at 1 Hz.
pub(super) const LONGEST_PAUSE_S: f64 = 5.0;

/// A pose within this of zero (m, rad), far from where the vehicle was going, is a start.
const START_M: f64 = 0.1;
const START_RAD: f64 = 0.02;
const FAR_M: f64 = 1.0;

/// What no vehicle exceeds. A step of the odometry that does is no driven path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct MotionLimits {
    /// Faster than any vehicle on a road (m/s): 216 km/h.
    #[schemars(extend("exclusiveMinimum" = 0, "maximum" = 1000))]
    pub max_speed_mps: f64,
    /// More than brakes and tyres hold, in any direction (m/s²): 1 g.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_acceleration_mps2: f64,
    /// Faster than any vehicle turns (rad/s). A car on the tightest circle that its tyres hold (5 m, at 1 g) turns with
    /// 1.4 rad/s; small robots turn on the spot with 3 rad/s.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_yaw_rate_radps: f64,
}

impl Default for MotionLimits {
    fn default() -> Self {
        Self {
            max_speed_mps: 60.0,
            max_acceleration_mps2: 10.0,
            max_yaw_rate_radps: std::f64::consts::PI,
        }
    }
}

/// A message that goes on from those before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::metric_map) struct Continued {
    /// The vehicle in the frame that the odometry began in, whatever it jumped to since.
    pub(in crate::metric_map) pose: Pose,
    /// Whether nobody knows how the vehicle came here from the message before.
    pub(in crate::metric_map) anew: bool,
}

/// One session's odometry, made continuous.
#[derive(Debug, Clone)]
pub(in crate::metric_map) struct Continuity {
    limits: MotionLimits,
    /// Frame of the stretch's start from that of the messages.
    start_from_odom: Pose,
    /// The latest messages, in the frame of the stretch's start: the first is the latest one that is a window older
    /// than the last, or the first since a jump.
    recent: VecDeque<(i64, Pose)>,
    /// Stamp of the first message since a jump.
    sound_since: i64,
    losses: DriveLosses,
}

impl Continuity {
    pub(in crate::metric_map) fn new(limits: MotionLimits) -> Self {
        Self {
            limits,
            start_from_odom: Pose::identity(),
            recent: VecDeque::new(),
            sound_since: i64::MIN,
            losses: DriveLosses::default(),
        }
    }

    /// Messages left out so far, and jumps.
    pub(in crate::metric_map) fn losses(&self) -> DriveLosses {
        self.losses
    }

    /// Takes the next message; `None` where it is left out.
    pub(in crate::metric_map) fn push(
        &mut self,
        stamp: i64,
        odom_from_vehicle: &Pose,
    ) -> Option<Continued> {
        if !odom_from_vehicle.translation.iter().all(|x| x.is_finite()) {
            self.losses.not_finite += 1;
            return None;
        }
        let Some((last, _)) = self.recent.back() else {
            return Some(self.begin(stamp, *odom_from_vehicle));
        };
        if stamp <= *last {
            self.losses.out_of_order += 1;
            return None;
        }
        let pose = self.start_from_odom.compose(odom_from_vehicle);
        if self.goes_on(stamp, &pose, odom_from_vehicle) {
            return Some(self.went_on(stamp, pose));
        }
        let pauses = self.has_paused(stamp, &pose);
        self.losses.pauses += u64::from(pauses);
        self.losses.jumps += u64::from(!pauses);
        let Some(there) = self.bridged(stamp) else {
            self.start_from_odom = Pose::identity();
            return Some(self.begin(stamp, *odom_from_vehicle));
        };
        self.start_from_odom = there.compose(&odom_from_vehicle.inverse());
        self.recent.clear();
        self.sound_since = stamp;
        Some(self.went_on(stamp, there))
    }

    fn begin(&mut self, stamp: i64, pose: Pose) -> Continued {
        self.recent.clear();
        self.recent.push_back((stamp, pose));
        self.sound_since = stamp;
        Continued { pose, anew: true }
    }

    fn went_on(&mut self, stamp: i64, pose: Pose) -> Continued {
        self.recent.push_back((stamp, pose));
        while self
            .recent
            .get(1)
            .is_some_and(|(older, _)| seconds(*older, stamp) >= WINDOW_S)
        {
            self.recent.pop_front();
        }
        Continued { pose, anew: false }
    }

    /// Whether a vehicle can have come to this pose since the last message.
    fn goes_on(&self, stamp: i64, pose: &Pose, odom_from_vehicle: &Pose) -> bool {
        let (Some((first, from)), Some((last, at))) = (self.recent.front(), self.recent.back())
        else {
            return true;
        };
        let step = pose.translation - at.translation;
        if self.has_paused(stamp, pose) {
            return false;
        }
        let (dt, limits) = (seconds(*last, stamp), &self.limits);
        let longest_m = limits.max_speed_mps * (dt + STAMP_ERROR_S) + SLACK_M;
        let most_rad = limits.max_yaw_rate_radps * (dt + STAMP_ERROR_S) + SLACK_RAD;
        if step.norm() > longest_m || at.rotation.angle_to(&pose.rotation) > most_rad {
            return false;
        }
        let window = seconds(*first, *last);
        if window < WINDOW_S {
            return true;
        }
        let velocity = (at.translation - from.translation) / window;
        let off_m = (step - velocity * dt).norm();
        let bent_m = 0.5 * limits.max_acceleration_mps2 * dt * (dt + window);
        let starts = odom_from_vehicle.translation.norm() < START_M
            && odom_from_vehicle.rotation.angle() < START_RAD;
        off_m <= bent_m + velocity.norm() * STAMP_ERROR_S + SLACK_M && !(starts && off_m > FAR_M)
    }

    /// Whether the vehicle went elsewhere while nothing was said for long.
    fn has_paused(&self, stamp: i64, pose: &Pose) -> bool {
        self.recent.back().is_some_and(|(last, at)| {
            let step_m = (pose.translation - at.translation).norm();
            seconds(*last, stamp) > LONGEST_PAUSE_S && step_m > FAR_M
        })
    }

    /// Where the last twist leads; `None` where that is not known well enough.
    fn bridged(&self, stamp: i64) -> Option<Pose> {
        let ((first, from), (last, at)) = (self.recent.front()?, self.recent.back()?);
        let (window, dt) = (seconds(*first, *last), seconds(*last, stamp));
        let known = window >= WINDOW_S && seconds(self.sound_since, *last) >= SOUND_S;
        let twist = se3::minus(at, from);
        (known && dt <= BRIDGED_S).then(|| se3::plus(at, &(twist * (dt / window))))
    }
}

fn seconds(from: i64, to: i64) -> f64 {
    to.saturating_sub(from) as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where messages `(s, x, y, yaw)` are continued to, and whether anew.
    fn continued(
        messages: impl IntoIterator<Item = (f64, Pose)>,
    ) -> (Vec<(Pose, bool)>, DriveLosses) {
        let mut continuity = Continuity::new(MotionLimits::default());
        let pushed = messages.into_iter().filter_map(|(second, pose)| {
            let continued = continuity.push((second * 1e9) as i64, &pose)?;
            Some((continued.pose, continued.anew))
        });
        (pushed.collect(), continuity.losses())
    }

    /// Driven on a circle of 20 m.
    fn circle(path_m: f64) -> Pose {
        let yaw = path_m / 20.0;
        Pose::from_yaw(20.0 * yaw.sin(), 20.0 * (1.0 - yaw.cos()), yaw)
    }

    /// At `rate_hz`, `speed_mps` on a circle, with what `odometry` makes of message and pose.
    fn drive(
        rate_hz: f64,
        speed_mps: f64,
        odometry: impl Fn(f64, Pose) -> Pose,
    ) -> (Vec<(Pose, bool)>, DriveLosses) {
        let messages = (0..(20.0 * rate_hz) as usize).map(|step| {
            let second = step as f64 / rate_hz;
            (second, odometry(second, circle(speed_mps * second)))
        });
        continued(messages)
    }

    fn breaks(found: &[(Pose, bool)]) -> usize {
        found[1..].iter().filter(|(_, anew)| *anew).count()
    }

    #[test]
    fn cars_at_any_rate_go_on() {
        for (rate_hz, speed_mps) in [(0.5, 15.0), (1.0, 14.0), (10.0, 14.0), (50.0, 3.0)] {
            let (found, losses) = drive(rate_hz, speed_mps, |_, pose| pose);
            assert_eq!((breaks(&found), losses.jumps), (0, 0), "{rate_hz} Hz");
        }
        // A motorway at 1 Hz.
        let straight = (0..9).map(|second| {
            let second = f64::from(second);
            (second, Pose::from_yaw(33.0 * second, 0.0, 0.0))
        });
        assert_eq!(continued(straight).1.jumps, 0);
    }

    #[test]
    fn braking_starting_and_late_stamps_are_no_jumps() {
        let late = |step: usize| if step % 7 == 3 { 0.09 } else { 0.0 };
        let path = |second: f64| match second {
            ..4.0 => 15.0 * second,
            4.0..5.5 => 60.0 + 15.0 * (second - 4.0) - 5.0 * (second - 4.0).powi(2),
            _ => 71.25,
        };
        let messages = (0..500).map(|step| {
            let second = step as f64 * 0.02;
            (second + 0.001 * late(step), circle(path(second)))
        });
        assert_eq!(continued(messages).1.jumps, 0);
    }

    #[test]
    fn over_a_reset_between_close_messages_the_vehicle_goes_on() {
        let reset = circle(5.0 * 10.0);
        let (found, losses) = drive(50.0, 5.0, |second, pose| {
            if second < 10.0 {
                pose
            } else {
                reset.inverse().compose(&pose)
            }
        });
        assert_eq!((breaks(&found), losses.jumps), (0, 1));
        for (step, (pose, _)) in found.iter().enumerate() {
            let truth = circle(5.0 * step as f64 / 50.0);
            let off = pose.inverse().compose(&truth);
            assert!(off.translation.norm() < 0.01 && off.rotation.angle() < 0.001);
        }
    }

    #[test]
    fn over_a_reset_at_a_hertz_a_stretch_begins() {
        for start in [Pose::identity(), Pose::from_yaw(-40.0, 0.0, 2.0)] {
            let reset = circle(5.0 * 10.0);
            let (found, losses) = drive(1.0, 5.0, |second, pose| {
                if second < 10.0 {
                    pose
                } else {
                    start.compose(&reset.inverse()).compose(&pose)
                }
            });
            assert_eq!((breaks(&found), losses.jumps), (1, 1));
            assert!(found[10].1);
            assert!((found[10].0.translation - start.translation).norm() < 1e-9);
        }
    }

    #[test]
    fn odometry_that_jumps_and_jumps_is_broken() {
        let (found, losses) = drive(50.0, 5.0, |second, pose| {
            let aside = if (second * 2.0) as i64 % 2 == 0 {
                0.0
            } else {
                30.0
            };
            Pose::from_yaw(aside, 0.0, 0.0).compose(&pose)
        });
        assert!(losses.jumps == 39 && breaks(&found) >= 38, "{losses:?}");
    }

    #[test]
    fn whoever_is_elsewhere_after_a_long_pause_came_by_an_unknown_way() {
        let at = |x: f64| Pose::from_yaw(x, 0.0, 0.0);
        let (found, losses) = continued([(0.0, at(0.0)), (4.9, at(60.0)), (64.0, at(60.2))]);
        assert_eq!((breaks(&found), losses.pauses), (0, 0));
        let (found, losses) = continued([(0.0, at(0.0)), (1800.0, at(50_000.0))]);
        assert_eq!((breaks(&found), losses.pauses, losses.jumps), (1, 1, 0));
    }

    #[test]
    fn what_is_left_out() {
        let at = |x: f64| Pose::from_yaw(x, 0.0, 0.0);
        let (found, losses) = continued([
            (0.0, at(0.0)),
            (1.0, at(f64::NAN)),
            (0.0, at(0.0)),
            (1.0, at(1.0)),
        ]);
        assert_eq!(found.len(), 2);
        assert_eq!((losses.not_finite, losses.out_of_order), (1, 1));
    }
}
