//! Keyframes by driven path, not by time.
//!
//! ```text
//! odometry ──► Continuity ──► KeyframeSelector ──► due points ──┐
//!                  │                                          ├──► Keyframer ──► keyframes
//!                  └──► poses of ──► FrameSets ───────────────┘
//! frames ─────────────────────────┘
//! ```
//!
//! A map wants a picture every so many metres: a car that waits adds nothing, a car that reverses
//! does. Paper 1 (IV-B) takes one frame set every 0.2 m of wheel odometry. Three things make the
//! difference between that sentence and a map:
//!
//! * **Between messages.** The path is interpolated, so a keyframe is due where the path length is
//!   reached *exactly*, with the stamp and pose of that instant, however coarse the odometry is.
//! * **Standing still.** Odometry that trembles by a millimetre at 50 Hz walks kilometres a day.
//!   Path is therefore counted in chords: it grows only when the vehicle is more than
//!   `deadband_m` away from where it was counted last, and then by the whole straight distance.
//!   Tremble inside the dead-band adds nothing, real motion loses nothing but the sagitta of a
//!   chord (a 0.05 m chord on a 5 m bend: a part in 240 000).
//! * **Waiting, then leaving.** Inside a chord the stamp is that of the *last* time the distance
//!   was passed on the way out, so a minute of standing is not smeared into the first metre.
//!
//! Reversing is driven path like any other. A step that no vehicle can make is not: the odometry was
//! set anew. It is continued, or a new stretch starts there with a keyframe of its own ([`MotionLimits`]). A new one
//! starts, too, where the vehicle is elsewhere after a long pause of the odometry.
//!
//! Where there are images, a keyframe is the first frame set at or after the due point. Of cameras with several rates, a
//! set without the slower ones leaves it to the next with them, as long as no other due point comes before that.

pub(super) mod continuity;
mod frame_sets;
mod keyframer;
mod rates;
mod selector;
mod speed;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use continuity::MotionLimits;
pub use frame_sets::{Exposure, borne_ns};
pub use keyframer::{Keyframe, Keyframer};
pub use speed::{Speed, speeds};

/// How keyframes are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct KeyframeParams {
    /// Driven path between keyframes (m). Paper 1's value.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub baseline_m: f64,
    /// Motion counts only when it adds up to more than this (m), at most `baseline_m`, so that trembling odometry does
    /// not drive while the vehicle stands. A tenth of the baseline: larger than the noise of wheel ticks (5 mm), small
    /// enough to lose nothing on bends.
    #[schemars(range(min = 0.0))]
    pub deadband_m: f64,
    /// What tells driven path from odometry that was set anew.
    #[serde(flatten)]
    pub limits: MotionLimits,
    /// Spread of the stamps of one frame set (s), and how far from its stamp frames of faster cameras may be. Half the
    /// period of paper 1's cameras (12.5 Hz), so that a frame is always nearer to its own set than to the next one.
    #[schemars(range(min = 0.0, max = 1e9))]
    pub max_gap_s: f64,
    /// A frame set that comes later than this after a due point (s) does not serve it. Longer than the pause of any
    /// camera that works, short enough to leave no hole in the trajectory where one does not.
    #[schemars(range(min = 0.0, max = 1e9))]
    pub max_wait_s: f64,
}

impl Default for KeyframeParams {
    fn default() -> Self {
        Self {
            baseline_m: 0.2,
            deadband_m: 0.02,
            limits: MotionLimits::default(),
            max_gap_s: 0.04,
            max_wait_s: 1.0,
        }
    }
}

/// Lengths that do not go together.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "expected deadband_m <= baseline_m, found {deadband_m} and {baseline_m}",
    deadband_m = .found.deadband_m, baseline_m = .found.baseline_m
)]
pub struct KeyframeParamsError {
    /// The parameters given.
    pub found: KeyframeParams,
}

impl KeyframeParams {
    /// Whether the parameters go together.
    ///
    /// # Errors
    /// [`KeyframeParamsError`] when the dead-band is longer than what it is part of.
    pub fn check(&self) -> Result<(), KeyframeParamsError> {
        if self.deadband_m <= self.baseline_m {
            Ok(())
        } else {
            Err(KeyframeParamsError { found: *self })
        }
    }
}

/// What was not used, and why.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DriveLosses {
    /// Messages whose stamp was not later than the one before.
    pub out_of_order: u64,
    /// Messages with a position that is not a number.
    pub not_finite: u64,
    /// Steps that no vehicle can make.
    pub jumps: u64,
    /// Long pauses after which the vehicle was elsewhere.
    pub pauses: u64,
    /// Frames of a camera that has another one with their stamp.
    pub repeated_frames: u64,
    /// Frames long before the first message.
    pub early_frames: Outside,
    /// Frames long after the last one.
    pub late_frames: Outside,
}

/// Frames outside of the time that odometry is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outside {
    /// How many.
    pub frames: u64,
    /// How far outside the farthest is, ns.
    pub farthest_ns: i64,
}

fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}
