//! Simulated drives with exact truth.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod blind;
mod jacobians;
mod regions;
mod solving;

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{UnitQuaternion, Vector3, Vector6};

use super::*;
use crate::geometry::camera::tests::wide_fisheye;
use crate::geometry::lie::se3;
use crate::geometry::rig::RigCamera;
use crate::solving::random::SplitMix64;

/// Random numbers that follow from a seed, and not from the next seed's.
pub(super) fn noise(seed: u64) -> SplitMix64 {
    SplitMix64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
}

/// Four fisheyes that look ahead, left, back and right.
pub(super) fn four_fisheyes() -> Rig {
    // z forward, x right, y down in a vehicle with x forward, y left, z up.
    let ahead = UnitQuaternion::from_euler_angles(-FRAC_PI_2, 0.0, -FRAC_PI_2);
    let mounts = [
        ("a_front", [3.7, 0.0, 0.7], 0.0),
        ("b_left", [2.0, 0.9, 1.0], FRAC_PI_2),
        ("c_rear", [-0.8, 0.0, 0.9], PI),
        ("d_right", [2.0, -0.9, 1.0], -FRAC_PI_2),
    ];
    let cameras = mounts.map(|(name, position, yaw)| RigCamera {
        name: name.to_owned(),
        camera: wide_fisheye(),
        vehicle_from_camera: Pose::new(
            Vector3::from(position),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * ahead,
        ),
    });
    Rig {
        cameras: cameras.into(),
    }
}

/// A drive around a room with points on the walls and the floor, and everything exact.
pub(super) struct Drive {
    pub(super) truth: Problem,
    pub(super) noise: SplitMix64,
}

impl Drive {
    /// `steps` keyframes on a closed round of radius 8 m over a slightly inclined floor.
    pub(super) fn new(steps: usize, landmarks: usize, seed: u64) -> Self {
        let mut noise = noise(seed);
        let poses = (0..steps).map(|step| {
            let angle = 2.0 * PI * step as f64 / steps as f64;
            let flat = Pose::from_yaw(8.0 * angle.cos(), 8.0 * angle.sin(), angle + FRAC_PI_2);
            let sway = Vector6::new(0.0, 0.0, 0.05 * angle.sin(), 0.01, 0.015 * angle.cos(), 0.0);
            Keyframe {
                session: 0,
                map_from_vehicle: se3::plus(&flat, &sway),
                fixed: step == 0,
            }
        });
        let mut truth = Problem {
            rigs: vec![four_fisheyes()],
            sessions: vec![SessionState::new(0)],
            poses: poses.collect(),
            ..Problem::default()
        };
        for _ in 0..landmarks {
            let (angle, height) = (2.0 * PI * noise.unit(), 3.0 * noise.unit());
            let radius = if noise.unit() < 0.5 { 13.0 } else { 3.0 };
            let radius = radius + noise.normal();
            truth.landmarks.push(Vector3::new(
                radius * angle.cos(),
                radius * angle.sin(),
                height,
            ));
        }
        truth.observations = sightings(&truth);
        truth.odometry = (0..steps.saturating_sub(1))
            .map(|step| odometry(&truth, step))
            .collect();
        Self { truth, noise }
    }

    /// The truth with noisy pixels and a wrong start.
    pub(super) fn disturbed(&mut self, sigma_px: f64, start: f64) -> Problem {
        let mut problem = self.truth.clone();
        for seen in &mut problem.observations {
            seen.pixel = seen.pixel.map(|x| x + sigma_px * self.noise.normal());
        }
        for pose in problem.poses.iter_mut().filter(|pose| !pose.fixed) {
            let step = Vector6::from_fn(|axis, _| {
                self.noise.normal() * start * if axis < 3 { 1.0 } else { 0.1 }
            });
            pose.map_from_vehicle = se3::plus(&pose.map_from_vehicle, &step);
        }
        for landmark in &mut problem.landmarks {
            *landmark += Vector3::from_fn(|_, _| self.noise.normal() * 2.0 * start);
        }
        problem
    }

    /// Root mean square distance of the poses from the truth, metres.
    pub(super) fn error_m(&self, problem: &Problem) -> f64 {
        let pairs = self.truth.poses.iter().zip(&problem.poses);
        let sum: f64 = pairs
            .map(|(a, b)| {
                (a.map_from_vehicle.translation - b.map_from_vehicle.translation).norm_squared()
            })
            .sum();
        (sum / self.truth.poses.len() as f64).sqrt()
    }
}

/// Every landmark within 8 m that a camera sees.
fn sightings(truth: &Problem) -> Vec<Observation> {
    let mut observations = Vec::new();
    for (pose, keyframe) in truth.poses.iter().enumerate() {
        for (camera, mounted) in truth.rigs[0].cameras.iter().enumerate() {
            let map_from_camera = keyframe
                .map_from_vehicle
                .compose(&mounted.vehicle_from_camera);
            for (landmark, position) in truth.landmarks.iter().enumerate() {
                let point = map_from_camera.inverse().transform(position);
                let pixel = mounted.camera.project(&point);
                let Some(pixel) = pixel.filter(|pixel| mounted.camera.contains(*pixel)) else {
                    continue;
                };
                if point.norm() < 8.0 && point.z > -0.1 {
                    observations.push(Observation {
                        pose,
                        camera,
                        landmark,
                        pixel,
                        sigma_px: 0.5,
                    });
                }
            }
        }
    }
    observations
}

/// The exact motion from one keyframe to the next.
fn odometry(truth: &Problem, step: usize) -> Odometry {
    let (from, to) = (&truth.poses[step], &truth.poses[step + 1]);
    let motion = from
        .map_from_vehicle
        .inverse()
        .compose(&to.map_from_vehicle);
    Odometry {
        from: step,
        to: step + 1,
        length_m: motion.translation.norm(),
        from_from_to: motion,
        sigma: [0.01, 0.01, 0.05, 0.02, 0.02, 0.003],
    }
}

fn options() -> Options {
    let mut options = Options::default();
    options.least_squares.cost_tolerance = 1e-12;
    options
}
