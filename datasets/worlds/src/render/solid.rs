//! Convex solids: what stands in the hall is made of them.

use super::lens::Window;
use crate::plane::Pose2;
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::Vector3;
use std::f64::consts::PI;

/// One side of a solid: the points `p` with `normal · p <= offset` are inside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Outward unit normal, map frame.
    pub normal: [f32; 3],
    /// Distance of the plane from the origin along the normal, metres.
    pub offset: f32,
    /// Which face of the scene is painted on it.
    pub face: u16,
}

/// A convex solid in the map frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    /// Its sides.
    pub planes: Vec<Plane>,
    /// The middle, seen from above, of an upright box that contains it, and the direction of the box's x axis.
    middle: Pose2,
    /// Half the box's length and width, metres.
    half: [f64; 2],
    /// Its lowest and highest point, metres.
    height: [f64; 2],
}

/// A side in the solid's own frame, before it stands somewhere.
pub type Side = (Vector3<f64>, f64, u16);

impl Solid {
    /// A solid from its sides in its own frame, and a box (`low`, `high`, metres) around it.
    pub fn new(stand: &Pose, sides: &[Side], low: Vector3<f64>, high: Vector3<f64>) -> Self {
        let planes = sides
            .iter()
            .map(|(normal, offset, face)| {
                let turned = stand.rotation * normal.normalize();
                let moved = offset / normal.norm() + turned.dot(&stand.translation);
                Plane {
                    normal: [turned.x as f32, turned.y as f32, turned.z as f32],
                    offset: moved as f32,
                    face: *face,
                }
            })
            .collect();
        let frame = Pose2::new([0.0; 2], stand.yaw());
        let (mut least, mut most) = ([f64::MAX; 3], [f64::MIN; 3]);
        for bits in 0..8_usize {
            let corner = Vector3::from_fn(|axis, _| [low, high][bits >> axis & 1][axis]);
            let corner = stand.transform(&corner);
            let [ahead, left] = frame.own([corner.x, corner.y]);
            for (axis, part) in [ahead, left, corner.z].into_iter().enumerate() {
                least[axis] = least[axis].min(part);
                most[axis] = most[axis].max(part);
            }
        }
        let middle = frame.point([0, 1].map(|axis| 0.5 * (least[axis] + most[axis])));
        Self {
            planes,
            middle: Pose2::new(middle, frame.yaw),
            half: [0, 1].map(|axis| 0.5 * (most[axis] - least[axis])),
            height: [least[2], most[2]],
        }
    }

    /// A box; faces in the order of [`box_sides`].
    pub fn cuboid(stand: &Pose, low: [f64; 3], high: [f64; 3], faces: [u16; 6]) -> Self {
        let mut sides = box_sides(low, high);
        for (side, face) in sides.iter_mut().zip(faces) {
            side.2 = face;
        }
        Self::new(stand, &sides, low.into(), high.into())
    }
}

/// The sides of a box, with faces 0 to 5: +x, −x, +y, −y, +z, −z.
pub fn box_sides(low: [f64; 3], high: [f64; 3]) -> [Side; 6] {
    [0, 1, 2, 3, 4, 5].map(|face: u16| {
        let axis = usize::from(face / 2);
        let (sign, offset) = if face.is_multiple_of(2) {
            (1.0, high[axis])
        } else {
            (-1.0, -low[axis])
        };
        (sign * Vector3::ith(axis, 1.0), offset, face)
    })
}

impl Solid {
    /// From `eye` (map frame, metres): a window that contains the solid, and a distance (m) that it cannot be nearer
    /// than.
    pub fn extent(&self, eye: [f32; 3]) -> (Window, f32) {
        let [x, y, z] = eye.map(f64::from);
        let [ahead, left] = self.middle.own([x, y]);
        let [a, b] = self.half;
        let outside = |along: f64, half: f64| (along.abs() - half).max(0.0);
        let near = outside(ahead, a).hypot(outside(left, b));
        let far = (ahead.abs() + a).hypot(left.abs() + b);
        let (below, above) = (self.height[0] - z, self.height[1] - z);
        let low = below.atan2(if below > 0.0 { far } else { near });
        let high = above.atan2(if above > 0.0 { near } else { far });
        let vertical = below.max(-above).max(0.0);
        // Azimuths of the corners, from that of the middle.
        let corners = [[a, b], [a, -b], [-a, b], [-a, -b]].map(|[a, b]| {
            let (dx, dy) = (a - ahead, b - left);
            (left * dx - ahead * dy).atan2(-ahead * dx - left * dy)
        });
        let (least, most) = corners
            .into_iter()
            .fold((0.0_f64, 0.0_f64), |(least, most), angle| {
                (least.min(angle), most.max(angle))
            });
        let azimuth = (-left).atan2(-ahead) + self.middle.yaw + 0.5 * (least + most);
        let half_azimuth = if near < 1e-3 {
            PI
        } else {
            0.5 * (most - least)
        };
        let window = Window {
            azimuth: azimuth as f32,
            half_azimuth: half_azimuth as f32,
            elevation: [low as f32, high as f32],
        };
        (window, near.hypot(vertical) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_point_of_a_box_lies_in_its_extent(
            place in prop::array::uniform3(-5.0..5.0f64),
            turn in prop::array::uniform3(-2.0..2.0f64),
            size in prop::array::uniform3(0.1..3.0f64),
            at in prop::array::uniform3(0.0..1.0f64),
            eye in prop::array::uniform3(-6.0..6.0f32),
        ) {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
            let stand = Pose::new(Vector3::from(place), turn);
            let size = Vector3::from(size);
            let solid = Solid::cuboid(&stand, (-size).into(), size.into(), [0; 6]);
            let own = Vector3::from_fn(|k, _| size[k] * (2.0 * at[k] - 1.0));
            let point = stand.transform(&own);
            let p = [point.x as f32, point.y as f32, point.z as f32];
            for plane in &solid.planes {
                let n = plane.normal;
                let side = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - plane.offset;
                prop_assert!(side < 1e-4);
            }
            let d = [p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]];
            let (extent, near) = solid.extent(eye);
            let level = d[0].hypot(d[1]);
            prop_assert!(level.hypot(d[2]) > near - 1e-4);
            let elevation = d[2].atan2(level);
            prop_assert!(elevation > extent.elevation[0] - 1e-3);
            prop_assert!(elevation < extent.elevation[1] + 1e-3);
            let turn = (d[1].atan2(d[0]) - extent.azimuth).rem_euclid(std::f32::consts::TAU);
            let turn = turn.min(std::f32::consts::TAU - turn);
            prop_assert!(turn < extent.half_azimuth + 1e-3);
        }
    }
}
