//! Places that were seen before: a vocabulary of binary descriptors, an index of what shows which words, and loop
//! closures that geometry confirms.
//!
//! A keyframe is one document of all its cameras' features, as a rig that sees all around recognises a place from
//! whichever side it comes. [`Vocabulary`] and [`PlaceIndex`] know nothing of keyframes, so that groups of landmarks
//! can be searched as well.

mod drive;
mod index;
mod local_points;
mod loops;
mod surface;
#[cfg(test)]
mod tests;
mod verification;
mod vocabulary;

pub use drive::{Drive, DriveKeyframe, DriveTrack, FeatureSource};
pub use index::{Hit, PlaceIndex};
pub use loops::{Loop, LoopOptions, loops};
pub use surface::{SurfaceOptions, SurfacePoint, surface_points};
pub use vocabulary::{Bag, Vocabulary, VocabularyOptions};
