//! Rigid motions, lenses, and cameras fixed to a vehicle.
//!
//! | module | what it knows |
//! |---|---|
//! | [`camera`] | lens models: rays from pixels and pixels from rays |
//! | [`geodesy`] | places on earth, and planes that touch it |
//! | [`lie`] | rotations and rigid motions with their Jacobians |
//! | [`pose`] | rigid transforms, checked at the door |
//! | [`resection`] | a rig's pose from points and rays, with outliers |
//! | [`rig`] | cameras fixed to one vehicle |
//! | [`trajectory`] | poses at instants |

pub mod camera;
pub mod geodesy;
pub mod lie;
pub mod pose;
pub mod resection;
pub mod rig;
pub mod trajectory;
