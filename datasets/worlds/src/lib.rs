//! Simulated worlds with exact truth, written as MCAP, so that a machine without any recordings
//! has something to map.
//!
//! [`car_park`] draws an underground car park, drives through it several times, and writes what
//! four fisheye cameras and the wheels report. [`street`] builds a street with houses, trees, signs
//! and cars, and visits it with a panorama camera; [`street_labels`] gives only the label panoramas,
//! without files. All of it follows from a seed: the same parameters give the same bytes on any
//! number of threads.
//!
//! ```text
//! car_park ─┐ scene, course, sensors, truth ┌─ render    what each pixel of a camera sees
//!           ├───────────────────────────────┼─ vehicle   motion and odometry
//! street ───┘                               └─ record    logs (MCAP) and truth
//! ```
//! Nothing here knows how maps are made; it only shares camera models, poses and boxes with the rest.

mod car_park;
mod error;
mod plane;
mod random;
mod record;
mod render;
mod street;
mod vehicle;

pub use car_park::{CarPark, car_park};
pub use error::WorldError;
pub use evermap_recording::RecordingError;
pub use record::{Progress, SessionSummary, Stopped, Summary};
pub use street::{
    LabelKind, LabelView, STREET_CLASSES, Street, StreetLabels, street, street_labels,
};
