//! Drives as the search for loops sees them.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::geometry::rig::Rig;
use crate::metric_map::features::{Blur, Feature, KeyframeFeatures};

/// One session.
#[derive(Debug, Clone)]
pub struct Drive<'a> {
    /// Its cameras.
    pub rig: &'a Rig,
    /// Its keyframes, by stamp.
    pub keyframes: Vec<DriveKeyframe<'a>>,
    /// What its cameras followed.
    pub tracks: Vec<DriveTrack>,
}

/// One keyframe of a drive.
#[derive(Debug, Clone)]
pub struct DriveKeyframe<'a> {
    /// Nanoseconds since the epoch.
    pub stamp: i64,
    /// The vehicle in the drifting odometry frame.
    pub odom_from_vehicle: Pose,
    /// What its cameras saw, in the rig's order.
    pub features: &'a KeyframeFeatures,
}

/// One point of the world, followed by one camera.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DriveTrack {
    /// The camera's index in the rig.
    pub camera: usize,
    /// Index of the keyframe in the drive and of the feature in its image, by keyframe.
    pub points: Vec<(u32, u32)>,
}

/// Where a feature is seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bearing {
    /// Unit vector, optical frame.
    pub(super) direction: Vector3<f32>,
    /// Standard deviation across it, radians.
    pub(super) sigma_rad: f32,
}

/// What is worked out once for each drive.
pub(super) struct Surveyed<'a> {
    pub(super) drive: &'a Drive<'a>,
    /// `vehicle_from_camera`, in the rig's order.
    pub(super) mounts: Vec<Pose>,
    /// Driven path at each keyframe, metres.
    pub(super) path_m: Vec<f64>,
    /// By keyframe, camera, feature; none where the lens has no ray.
    pub(super) bearings: Vec<Vec<Vec<Option<Bearing>>>>,
}

impl<'a> Surveyed<'a> {
    pub(super) fn new(drive: &'a Drive<'a>, sigma_px: f64) -> Self {
        let bearings = drive.keyframes.par_iter().map(|keyframe| {
            let images = drive.rig.cameras.iter().zip(&keyframe.features.images);
            let of_image = images.map(|(camera, image)| {
                let blur = Blur::of_image(image);
                let bearing = |feature: &Feature| {
                    let sigma_px = sigma_px * blur.of(feature.size_px);
                    bearing(&camera.camera, feature.pixel, sigma_px)
                };
                image.features.iter().map(bearing).collect()
            });
            of_image.collect()
        });
        let mut at = 0.0;
        let mut before: Option<&Pose> = None;
        let path_m = drive.keyframes.iter().map(|keyframe| {
            let pose = &keyframe.odom_from_vehicle;
            at += before.map_or(0.0, |before| (pose.translation - before.translation).norm());
            before = Some(pose);
            at
        });
        Self {
            drive,
            mounts: drive
                .rig
                .cameras
                .iter()
                .map(|camera| camera.vehicle_from_camera)
                .collect(),
            path_m: path_m.collect(),
            bearings: bearings.collect(),
        }
    }

    pub(super) fn bearing(
        &self,
        keyframe: usize,
        camera: usize,
        feature: usize,
    ) -> Option<Bearing> {
        *self.bearings.get(keyframe)?.get(camera)?.get(feature)?
    }

    /// `a_from_b` of the vehicle at two keyframes, by odometry.
    pub(super) fn between(&self, a: usize, b: usize) -> Pose {
        let [a, b] = [a, b].map(|keyframe| &self.drive.keyframes[keyframe].odom_from_vehicle);
        a.inverse().compose(b)
    }
}

/// A step of half a pixel to each side along both axes says how many radians a pixel is here.
fn bearing(camera: &Camera, [u, v]: [f64; 2], sigma_px: f64) -> Option<Bearing> {
    let ray = camera.unproject([u, v])?;
    let across = [[u + 0.5, v], [u, v + 0.5]].map(|pixel| {
        let beside = camera.unproject(pixel)?;
        Some(2.0 * (beside - ray).norm())
    });
    let pixel_rad = match across {
        [Some(x), Some(y)] => (x * y).sqrt(),
        [one, other] => one.or(other)?,
    };
    Some(Bearing {
        direction: ray.cast(),
        sigma_rad: (sigma_px * pixel_rad) as f32,
    })
}
