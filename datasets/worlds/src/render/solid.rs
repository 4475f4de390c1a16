//! Convex solids: what stands in the hall is made of them.

use evermap_algorithms::geometry::pose::Pose;
use nalgebra::Vector3;

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
    /// Corners of a convex outline that contains it, seen from above, anticlockwise, metres.
    pub outline: [[f32; 2]; 4],
    /// Lowest and highest point, metres.
    pub height: [f32; 2],
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
        let corners: Vec<Vector3<f64>> = (0..8_usize)
            .map(|bits| {
                let ends = [low, high];
                let corner = Vector3::from_fn(|axis, _| ends[bits >> axis & 1][axis]);
                stand.transform(&corner)
            })
            .collect();
        let (outline, height) = surround(stand, &corners);
        Self {
            planes,
            outline,
            height,
        }
    }

    /// A box; faces in the order +x, −x, +y, −y, +z, −z.
    pub fn cuboid(stand: &Pose, low: Vector3<f64>, high: Vector3<f64>, faces: [u16; 6]) -> Self {
        let sides: Vec<Side> = (0..6)
            .map(|k| {
                let (axis, sign) = (k / 2, if k % 2 == 0 { 1.0 } else { -1.0 });
                let mut normal = Vector3::zeros();
                normal[axis] = sign;
                let offset = if k % 2 == 0 { high[axis] } else { -low[axis] };
                (normal, offset, faces[k])
            })
            .collect();
        Self::new(stand, &sides, low, high)
    }
}

/// A rectangle in the direction of the stand's heading around the corners, and their heights.
fn surround(stand: &Pose, corners: &[Vector3<f64>]) -> ([[f32; 2]; 4], [f32; 2]) {
    let forward = stand.rotation * Vector3::x();
    let yaw = forward.y.atan2(forward.x);
    let (sin, cos) = yaw.sin_cos();
    let mut low = [f64::MAX; 3];
    let mut high = [f64::MIN; 3];
    for p in corners {
        let own = [cos * p.x + sin * p.y, cos * p.y - sin * p.x, p.z];
        for axis in 0..3 {
            low[axis] = low[axis].min(own[axis]);
            high[axis] = high[axis].max(own[axis]);
        }
    }
    let corner = |a: f64, b: f64| [(cos * a - sin * b) as f32, (sin * a + cos * b) as f32];
    let outline = [
        corner(low[0], low[1]),
        corner(high[0], low[1]),
        corner(high[0], high[1]),
        corner(low[0], high[1]),
    ];
    (outline, [low[2] as f32, high[2] as f32])
}

/// How a solid may appear from a place: an interval of azimuth and of elevation that contains
/// it, and a distance it cannot be nearer than.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Middle of the azimuth interval, radians.
    pub azimuth: f32,
    /// Half the azimuth interval, radians; π is everywhere.
    pub half_azimuth: f32,
    /// Lowest and highest elevation above the horizon, radians.
    pub elevation: [f32; 2],
    /// No point is nearer than this, metres.
    pub near: f32,
}

impl Solid {
    /// How the solid appears from `eye` (map frame, metres).
    pub fn extent(&self, eye: [f32; 3]) -> Extent {
        let (near, far) = self.distances(eye);
        let (azimuth, half_azimuth) = if near < 1e-3 {
            (0.0, std::f32::consts::PI)
        } else {
            self.azimuths(eye)
        };
        let (below, above) = (self.height[0] - eye[2], self.height[1] - eye[2]);
        let low = below.atan2(if below > 0.0 { far } else { near });
        let high = above.atan2(if above > 0.0 { near } else { far });
        let vertical = below.max(-above).max(0.0);
        Extent {
            azimuth,
            half_azimuth,
            elevation: [low, high],
            near: near.hypot(vertical),
        }
    }

    /// Smallest and largest horizontal distance of the outline.
    fn distances(&self, eye: [f32; 3]) -> (f32, f32) {
        let (mut near, mut far) = (f32::MAX, 0.0_f32);
        let mut inside = true;
        for k in 0..4 {
            let (a, b) = (self.outline[k], self.outline[(k + 1) % 4]);
            let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
            let (px, py) = (eye[0] - a[0], eye[1] - a[1]);
            inside &= ex * py - ey * px >= 0.0;
            let along = (px * ex + py * ey) / (ex * ex + ey * ey).max(1e-12);
            let f = along.clamp(0.0, 1.0);
            near = near.min((px - f * ex).hypot(py - f * ey));
            far = far.max(px.hypot(py));
        }
        (if inside { 0.0 } else { near }, far)
    }

    fn azimuths(&self, eye: [f32; 3]) -> (f32, f32) {
        let middle = [0, 1].map(|axis| {
            0.25 * self.outline.iter().map(|corner| corner[axis]).sum::<f32>() - eye[axis]
        });
        let (mut low, mut high) = (0.0_f32, 0.0_f32);
        for corner in &self.outline {
            let (dx, dy) = (corner[0] - eye[0], corner[1] - eye[1]);
            let (dot, cross) = (
                middle[0] * dx + middle[1] * dy,
                middle[0] * dy - middle[1] * dx,
            );
            let angle = cross.atan2(dot);
            low = low.min(angle);
            high = high.max(angle);
        }
        let azimuth = middle[1].atan2(middle[0]) + 0.5 * (low + high);
        (azimuth, 0.5 * (high - low))
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
            let solid = Solid::cuboid(&stand, -size, size, [0; 6]);
            let own = Vector3::from_fn(|k, _| size[k] * (2.0 * at[k] - 1.0));
            let point = stand.transform(&own);
            let p = [point.x as f32, point.y as f32, point.z as f32];
            for plane in &solid.planes {
                let n = plane.normal;
                let side = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - plane.offset;
                prop_assert!(side < 1e-4);
            }
            let d = [p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]];
            let extent = solid.extent(eye);
            let level = d[0].hypot(d[1]);
            prop_assert!(level.hypot(d[2]) > extent.near - 1e-4);
            let elevation = d[2].atan2(level);
            prop_assert!(elevation > extent.elevation[0] - 1e-3);
            prop_assert!(elevation < extent.elevation[1] + 1e-3);
            let turn = (d[1].atan2(d[0]) - extent.azimuth).rem_euclid(std::f32::consts::TAU);
            let turn = turn.min(std::f32::consts::TAU - turn);
            prop_assert!(turn < extent.half_azimuth + 1e-3);
        }
    }
}
