//! The plane that vehicles and things stand in.

use evermap_algorithms::geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;

/// A position, metres, and a heading, radians.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pose2 {
    /// East, metres.
    pub x: f64,
    /// North, metres.
    pub y: f64,
    /// Heading from x towards y, radians.
    pub yaw: f64,
}

impl Pose2 {
    /// At a position, with a heading.
    pub fn new([x, y]: [f64; 2], yaw: f64) -> Self {
        Self { x, y, yaw }
    }

    /// Its position.
    pub fn at(&self) -> [f64; 2] {
        [self.x, self.y]
    }

    /// The same place, with the heading turned by `angle` to the left, radians.
    pub fn turned(&self, angle: f64) -> Self {
        Self::new(self.at(), self.yaw + angle)
    }

    /// The point that is so far ahead and to the left of here, metres.
    pub fn point(&self, [ahead, left]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        [
            self.x + ahead * cos - left * sin,
            self.y + ahead * sin + left * cos,
        ]
    }

    /// How far ahead and to the left of here a point is, metres.
    pub fn own(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        let (dx, dy) = (x - self.x, y - self.y);
        [dx * cos + dy * sin, dy * cos - dx * sin]
    }

    /// Upright in space, at a height, metres.
    pub fn upright(&self, z: f64) -> Pose {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw);
        Pose::new(Vector3::new(self.x, self.y, z), turned)
    }
}

/// The distance between two points, metres.
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

/// The point a share of the way from one to another.
pub fn between(a: [f64; 2], b: [f64; 2], share: f64) -> [f64; 2] {
    [0, 1].map(|axis| a[axis] + share * (b[axis] - a[axis]))
}

/// The direction from one point to another, radians.
pub fn heading(from: [f64; 2], to: [f64; 2]) -> f64 {
    (to[1] - from[1]).atan2(to[0] - from[0])
}
