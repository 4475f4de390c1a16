//! A chequered floor, seen through lenses: input with a known answer.

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_schemas::roles::{Calibration, Transform};
use evermap_schemas::{Bytes, Stamp, record};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

record! {
    /// A posed image as a kernel sees it.
    #[layer("posed_images", key(site, session, stamp, camera))]
    pub struct Image {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Exposure.
        stamp: Stamp,
        /// Camera.
        camera: String,
        /// The vehicle.
        map_from_vehicle: evermap_schemas::Pose,
        /// Encoded.
        image: Option<Bytes>,
    }
}

/// Squares of half a metre.
pub fn grey(x: f64, y: f64) -> f64 {
    let odd = ((x / 0.5).floor() + (y / 0.5).floor()).rem_euclid(2.0) >= 1.0;
    if odd { 200.0 } else { 60.0 }
}

/// One camera on the vehicle.
pub struct Mounted {
    pub calibration: Calibration,
    pub vehicle_from_camera: Pose,
}

impl Mounted {
    /// Looks towards `yaw`, `down` below the horizon (rad), from one metre above the ground.
    pub fn new(name: &str, model: &str, focal: f64, yaw: f64, down: f64) -> Self {
        let level = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw)
            * Rotation3::from_matrix_unchecked(level)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), -down);
        let calibration = Calibration {
            site: "s".into(),
            session: "a".into(),
            stamp: Stamp(0),
            camera: name.into(),
            width: 400,
            height: 300,
            model: model.into(),
            intrinsics: vec![focal, 0.0, 199.7, 0.0, focal, 149.2, 0.0, 0.0, 1.0],
            distortion: vec![],
            mount: None,
        };
        Self {
            calibration,
            vehicle_from_camera: Pose::new(
                Vector3::new(0.5 * yaw.cos(), 0.5 * yaw.sin(), 1.0),
                UnitQuaternion::from_rotation_matrix(&turned),
            ),
        }
    }

    pub fn camera(&self) -> Camera {
        let Calibration {
            model,
            width,
            height,
            intrinsics,
            distortion,
            ..
        } = &self.calibration;
        Camera::from_calibration(model, *width, *height, intrinsics, distortion).unwrap()
    }

    /// Mounted by way of a bracket, so that the chain has two links.
    pub fn transforms(&self) -> Vec<Transform> {
        let name = &self.calibration.camera;
        let bracket = Pose::from_yaw(0.1, -0.2, 0.3);
        let links = [
            ("base_link".to_owned(), format!("{name}_bracket"), bracket),
            (
                format!("{name}_bracket"),
                name.clone(),
                bracket.inverse().compose(&self.vehicle_from_camera),
            ),
        ];
        links
            .map(|(parent, child, pose)| Transform {
                site: "s".into(),
                session: "a".into(),
                stamp: Stamp(0),
                parent,
                child,
                parent_from_child: evermap_schemas::Pose::from_array(pose.to_array()),
                fixed: true,
            })
            .into()
    }

    /// The floor as this camera sees it: a PGM, the mean of 3 × 3 rays per pixel.
    pub fn pgm(&self, map_from_vehicle: &Pose) -> Vec<u8> {
        let camera = self.camera();
        let map_from_camera = map_from_vehicle.compose(&self.vehicle_from_camera);
        let eye = map_from_camera.translation;
        let ray = |u: f64, v: f64| {
            let down = camera
                .unproject([u, v])
                .map(|ray| map_from_camera.rotate(&ray));
            down.filter(|ray| ray.z < -0.01).map_or(0.0, |ray| {
                let point = eye - ray * (eye.z / ray.z);
                grey(point.x, point.y)
            })
        };
        let third = 1.0 / 3.0;
        let pixel = |u: u32, v: u32| {
            let around = [-third, 0.0, third];
            let rays = around
                .iter()
                .flat_map(|dv| around.iter().map(move |du| (*du, *dv)));
            let sum: f64 = rays
                .map(|(du, dv)| ray(f64::from(u) + du, f64::from(v) + dv))
                .sum();
            (sum / 9.0).round() as u8
        };
        let pixels = (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| (u, v)));
        let mut bytes = format!("P5\n{} {}\n255\n", camera.width, camera.height).into_bytes();
        bytes.extend(pixels.map(|(u, v)| pixel(u, v)));
        bytes
    }

    pub fn image(&self, stamp: i64, map_from_vehicle: &Pose) -> Image {
        Image {
            site: "s".into(),
            session: "a".into(),
            stamp: Stamp(stamp),
            camera: self.calibration.camera.clone(),
            map_from_vehicle: evermap_schemas::Pose::from_array(map_from_vehicle.to_array()),
            image: Some(Bytes(self.pgm(map_from_vehicle))),
        }
    }
}
