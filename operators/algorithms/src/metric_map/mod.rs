//! From features of images to poses and landmarks, and back to a pose in them.
//!
//! | module | what it knows |
//! |---|---|
//! | [`association`] | which features of which keyframes show the same landmark |
//! | [`body`] | which pixels show the vehicle itself |
//! | [`bundle_adjustment`] | poses and landmarks from all observations at once |
//! | [`drive`] | keyframes at equal steps of driven path |
//! | [`features`] | key points with binary descriptors |
//! | [`georeference`] | where a map lies on earth, from GNSS fixes |
//! | [`inertial`] | roll and pitch of odometry from an IMU |
//! | [`localisation`] | a drive's poses in a map it did not make |
//! | [`mapping`] | association, triangulation and adjustment in turns, until a map is accurate |
//! | [`matching`] | descriptors to descriptors |
//! | [`odometry`] | how far odometry is believed |
//! | [`places`] | a binary vocabulary, and keyframes that look alike |
//! | [`pose_graph`] | odometry and loops relaxed into consistent poses |
//! | [`tracking`] | features followed through a camera's keyframes |

pub mod association;
pub mod body;
pub mod bundle_adjustment;
pub mod drive;
pub mod features;
pub mod georeference;
pub mod inertial;
pub mod localisation;
pub mod mapping;
pub mod matching;
pub mod odometry;
pub mod places;
pub mod pose_graph;
pub mod tracking;
mod visibility;
