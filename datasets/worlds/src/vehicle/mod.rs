//! The vehicle: where it is, and what its wheels make of that.

mod ground;
mod odometry;
mod path;
mod trajectory;

pub use ground::Ground;
pub use odometry::{OdometrySample, Wheels};
pub use path::{Path, PathPoint};
pub use trajectory::Trajectory;
