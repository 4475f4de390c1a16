//! The four cameras: Kannala–Brandt fisheyes, each a little different, fixed to the vehicle.

use super::CarPark;
use crate::random::{normal, stream};
use crate::record::CameraTopics;
use crate::render::{Lens, looking};
use evermap_algorithms::geometry::camera::{Camera, KannalaBrandt, Model};
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use rand::Rng;
use std::f64::consts::{FRAC_PI_2, PI};

/// The image circle ends this far from the axis, radians.
pub const CIRCLE_RAD: f64 = 95.0 * PI / 180.0;

/// One camera of the rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigCamera {
    /// `front`, `left`, `rear` or `right`.
    pub name: &'static str,
    /// The true lens; pixel (0, 0) is the centre of the top-left pixel.
    pub optics: KannalaBrandt,
    /// The lens, and the image's size.
    pub camera: Camera,
    /// Where it sits (optical frame: z forward, x right, y down), and what is published of its lens.
    pub topics: CameraTopics,
}

impl RigCamera {
    /// Its rays, tile by tile.
    pub fn lens(&self) -> Lens {
        let place = &self.topics.vehicle_from_camera;
        Lens::new(&self.camera, place, self.optics.focal(), CIRCLE_RAD)
    }
}

/// The cameras' names.
pub const CAMERAS: [&str; 4] = ["front", "left", "rear", "right"];

/// Name, position (m), direction of view (rad, anticlockwise), tilt below the horizon (rad).
const MOUNTS: [(&str, [f64; 3], f64, f64); 4] = [
    (CAMERAS[0], [3.62, 0.0, 0.68], 0.0, 0.30),
    (CAMERAS[1], [1.95, 0.98, 1.05], FRAC_PI_2, 0.55),
    (CAMERAS[2], [-0.98, 0.04, 0.92], PI, 0.38),
    (CAMERAS[3], [1.95, -0.98, 1.05], -FRAC_PI_2, 0.55),
];

/// The rig of a world. Sessions share it.
pub fn rig(world: &CarPark) -> Vec<RigCamera> {
    let mut cameras = Vec::with_capacity(MOUNTS.len());
    for (index, (name, place, yaw, tilt)) in MOUNTS.into_iter().enumerate() {
        let mut rng = stream(world.seed, "rig", index as u64);
        let mut draw = |sigma: f64| sigma * normal(&mut rng).clamp(-2.0, 2.0);
        let k = [
            -0.012 + draw(0.003),
            0.003 + draw(0.001),
            -0.0012 + draw(0.0003),
            0.0002 + draw(0.00005),
        ];
        let width = f64::from(world.width_px);
        let edge = FRAC_PI_2 * lens_factor(&k, FRAC_PI_2);
        let focal = 0.5 * width / edge * (1.0 + draw(0.002));
        let focal = [focal, focal * (1.0 + draw(0.0006))];
        let centre = [
            0.5 * (width - 1.0) + width * draw(0.002),
            0.5 * (f64::from(world.height_px) - 1.0) + width * draw(0.002),
        ];
        let nudge = Vector3::new(draw(0.008), draw(0.008), draw(0.008));
        let rotation = looking(yaw, tilt) * UnitQuaternion::from_scaled_axis(nudge);
        let shift = Vector3::new(draw(0.008), draw(0.008), draw(0.008));
        let optics = KannalaBrandt::new(focal, centre, k);
        let size = [world.width_px, world.height_px];
        let camera = Camera::new(Model::KannalaBrandt(optics), size[0], size[1]);
        cameras.push(RigCamera {
            name,
            optics,
            camera: camera.with_max_angle(CIRCLE_RAD),
            topics: CameraTopics {
                namespace: format!("/camera/{name}"),
                frame_id: format!("{name}_optical_frame"),
                vehicle_from_camera: Pose::new(Vector3::from(place) + shift, rotation),
                size,
                model: "equidistant",
                distortion: k.to_vec(),
                focal,
                centre: off(world, index, centre),
            },
        });
    }
    cameras
}

/// A principal point as a calibration that is off gives it.
fn off(world: &CarPark, index: usize, [cx, cy]: [f64; 2]) -> [f64; 2] {
    let mut rng = stream(world.seed, "calibration", index as u64);
    let (sin, cos) = rng.random_range(0.0..2.0 * PI).sin_cos();
    let error = world.calibration_error_px;
    [cx + error * cos, cy + error * sin]
}

/// θd / θ of the lens.
fn lens_factor(k: &[f64; 4], theta: f64) -> f64 {
    let t2 = theta * theta;
    1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn each_camera_looks_its_way_and_sees_180_degrees() {
        let rig = rig(&CarPark::default());
        let ways = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]];
        for (camera, way) in rig.iter().zip(ways) {
            let axis = camera.topics.vehicle_from_camera.rotate(&Vector3::z());
            assert!(axis.x * way[0] + axis.y * way[1] > 0.8, "{}", camera.name);
            assert!(axis.z < -0.2);
            let [u0, _] = camera.camera.project(&-Vector3::x()).unwrap();
            let [u1, _] = camera.camera.project(&Vector3::x()).unwrap();
            assert!((u1 - u0 - 1280.0).abs() < 16.0, "{}", u1 - u0);
        }
        assert_ne!(rig[0].optics, rig[1].optics);
    }
}
