//! Frames outside of the time that poses are of, in words.

use evermap_contract::Reason;

/// Why a frame has no pose that is so many nanoseconds before the first one; `poses` says whose they are, such as
/// `odometry`.
pub(crate) fn early(before_ns: i64, poses: &str) -> Reason {
    format!("frame that is {} before {poses} begins", roughly(before_ns)).into()
}

/// As [`early`], after the last one.
pub(crate) fn late(after_ns: i64, poses: &str) -> Reason {
    format!("frame that is {} after {poses} ends", roughly(after_ns)).into()
}

/// How far outside a frame is, in a word: numbers would make a reason of every session. What is short of an hour or a day
/// is one: cameras and odometry that are an hour apart are so to some seconds.
fn roughly(outside_ns: i64) -> &'static str {
    match outside_ns / 1_000_000_000 {
        ..60 => "seconds",
        60..3_000 => "minutes",
        3_000..72_000 => "hours",
        _ => "days",
    }
}
