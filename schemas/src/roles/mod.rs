//! What a log holds, whatever its messages are called: the *sources* of every plan.
//!
//! A [`Role`] is a part that a log's messages play, and the table of its rows. Each has a file of its own: the row, the
//! message types that it is inferred from, how a message becomes rows. Keys of session manifests, tables, names that
//! plans may use and the reference all follow from [`ALL`]; a new role is a file here and a line in that list.
//!
//! ```text
//!   types of a log's topics ──► Role::infer ──► topics ──► Message (decoded members) ──► FromMessage ──► rows
//! ```
//!
//! Files, and how bytes become members, are the business of whoever reads logs.

mod cameras;
mod content;
mod delays;
pub mod frame_names;
mod message;
mod mounts;
mod raw_format;
pub mod robots;
mod role;
mod stamps;
mod stereo;
mod still;

pub use cameras::CameraNames;
pub use delays::{DELAYS, Delay};
pub use message::{FARTHEST_M, Fields, FoundImage, FromMessage, Message, ReadRows};
pub use mounts::Mount;
pub use raw_format::{BIG_ENDIAN, RawFormat, SampleBits};
pub use role::{Choice, Messages, Metadata, Role, Source, Topic, UNTYPED, every, in_words};
pub use stamps::ZeroStamp;
pub use stereo::{CAMERA_FRAMES, CAMERAS, CalibratedCamera, CalibratedFrame, CameraMount};
pub use still::{SentTransform, StillFrames};

macro_rules! roles {
    ($($file:ident),+ $(,)?) => {
        $(pub mod $file;)+

        /// Every role there is.
        pub const ALL: &[Role] = &[$($file::ROLE),+];
    };
}

// Sorted; a test compares the list with the tables' names.
roles! {
    annotations,
    calibration,
    depth_frames,
    frames,
    gnss_fixes,
    image_annotations,
    imu,
    label_classes,
    label_frames,
    odometry,
    transforms,
}

pub use annotations::{Anchor, Annotation};
pub use calibration::Calibration;
pub use frames::{Frame, IMAGE_MEMBER};
pub use gnss_fixes::GnssFix;
pub use image_annotations::ImageAnnotation;
pub use imu::ImuMeasurement;
pub use label_classes::LabelClass;
pub use odometry::OdometryPose;
pub use robots::{Motion, Namespaces, OdometryOf, Robots, Stray};
pub use transforms::Transform;

#[cfg(test)]
mod tests;
