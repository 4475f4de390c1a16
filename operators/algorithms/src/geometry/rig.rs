//! Cameras fixed to one vehicle.

use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;

/// A camera on the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct RigCamera {
    /// Its name: the optical frame's.
    pub name: String,
    /// Its lens, for images of the size that features are measured in.
    pub camera: Camera,
    /// Where it is mounted: optical frame (z forward, x right, y down) to vehicle (x forward, y left, z up).
    pub vehicle_from_camera: Pose,
}

/// The cameras of one session, ordered by name. Elsewhere a camera is named by its index in here.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rig {
    /// The cameras.
    pub cameras: Vec<RigCamera>,
}

impl Rig {
    /// The index of a camera.
    pub fn index(&self, name: &str) -> Option<usize> {
        self.cameras.iter().position(|camera| camera.name == name)
    }
}
