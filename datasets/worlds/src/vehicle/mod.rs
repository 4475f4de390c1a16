//! The vehicle: where it is, and what its wheels and its receiver make of that.

mod ground;
mod imu;
mod odometry;
mod path;
mod receiver;
mod trajectory;

pub use ground::Ground;
pub use imu::{Imu, SENSOR};
pub use odometry::{OdometrySample, Wheels};
pub use path::{Path, PathPoint};
pub use receiver::{ANTENNA, PLACE, Receiver};
pub use trajectory::Trajectory;
