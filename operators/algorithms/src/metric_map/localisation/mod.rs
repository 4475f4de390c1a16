//! A drive's poses in a map it did not make.
//!
//! Paper 1, section IV-C: a guess of the pose from the last one and the wheels; the landmarks in
//! its neighbourhood, projected into all cameras; features claimed by image distance and descriptor
//! distance together; non-linear least squares on the pose; and again from the better pose.
//!
//! What the paper leaves open is how to know that an answer is right. Here:
//!
//! * **One keyframe** ([`fix`](Localiser::fix)). The search radius is what the guess's covariance
//!   says. The pose found is then *verified*: features are claimed once more with a radius several
//!   times the measurement noise. At the true pose the claims cluster at the centre; at a wrong one
//!   they fill the disc evenly. The share at the centre is therefore a test that does not depend
//!   on how many landmarks there are.
//! * **Along the drive** ([`Localiser::localise`]). A pose is published when it belongs to a run of
//!   fixes that agree with each other by odometry. A start, a gap too long for odometry, or a
//!   kidnapping is bridged by recognising the place, and such a pose counts only when the keyframes
//!   beside it confirm it and no second place explains them as well.
//! * **This place, or one like it** (`evidence`). A run of fixes that agree may still be of another car park that was
//!   built from the same drawing. It counts when, along the run, more of what is recognised in the whole map lies where
//!   it is seen than elsewhere.
//! * **Both ways.** The whole drive is there, so what lies before a confirmed pose is localised
//!   backwards from it.
//!
//! Poses and covariances: `map_from_vehicle`; a small change is a translation along the map's axes
//! followed by a rotation about them, `t + δt`, `exp(δθ) R`, in this order in every 6-vector.

mod association;
mod drive;
mod evidence;
mod fix;
mod map;
mod motion;
mod params;
mod recovery;
mod refinement;
mod view;

#[cfg(test)]
mod tests;

pub use drive::{DriveKeyframe, KeyframeLocalisation, Recognise, State};
pub use fix::{Doubt, Fix, LandmarkMatch, Localiser};
pub use map::{LandmarkMap, MapLandmark};
pub use motion::Guess;
pub use params::{LocalisationParams, NarrowVerification};
pub use recovery::Places;
