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
//! layout ── route ── drive ─┬─ odometry ────────────┐
//!    │                      ├─ walkers ─┐           ├─ session ── recording (MCAP)
//!    ├─ floor, walls, cars ─┴─ scene ───┴─ render ──┘
//!    └─ truth
//! ```
//! Nothing here knows how maps are made; it only shares camera models and poses with the rest.

mod canvas;
mod cars;
mod cast;
mod cdr;
mod drive;
mod error;
mod floor;
mod folder;
mod glyphs;
mod ground;
mod layout;
mod lens;
mod lighting;
mod look;
mod messages;
mod odometry;
mod params;
mod picture;
mod random;
mod recording;
mod render;
mod rig;
mod route;
mod scene;
mod session;
mod solid;
mod street;
#[cfg(test)]
mod tests;
mod texture;
mod truth;
mod walkers;
mod walls;

pub use error::WorldError;
pub use odometry::WheelErrors;
pub use params::CarPark;
pub use session::{Progress, SessionSummary, Summary, car_park};
pub use street::{
    LabelKind, LabelView, STREET_CLASSES, STREET_COLOURS, Street, StreetLabels, street,
    street_labels,
};
