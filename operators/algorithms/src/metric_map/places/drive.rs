//! Drives as the search for loops sees them.

use std::borrow::Cow;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::geometry::rig::{Rig, RigCamera};
use crate::metric_map::features::{Blur, KeyframeFeatures};

/// One session. `E` is why what its cameras saw may be out of reach.
pub struct Drive<'a, E> {
    /// Its cameras.
    pub rig: &'a Rig,
    /// Its keyframes, by stamp.
    pub keyframes: Vec<DriveKeyframe>,
    /// What its cameras saw from them.
    pub seen: &'a dyn FeatureSource<E>,
    /// What its cameras followed.
    pub tracks: Vec<DriveTrack>,
}

/// One keyframe of a drive.
#[derive(Debug, Clone)]
pub struct DriveKeyframe {
    /// Nanoseconds since the epoch.
    pub stamp: i64,
    /// The vehicle in the drifting odometry frame.
    pub odom_from_vehicle: Pose,
}

/// What the cameras of a drive saw: all in memory, or fetched when it is looked at. That may be several times.
pub trait FeatureSource<E>: Sync {
    /// The features of the keyframe of this index, in the rig's order.
    ///
    /// # Errors
    /// When they cannot be fetched.
    fn features(&self, keyframe: usize) -> Result<Cow<'_, KeyframeFeatures>, E>;
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

/// What is seen from one keyframe.
pub(super) struct KeyframeView<'a> {
    cameras: &'a [RigCamera],
    pub(super) features: Cow<'a, KeyframeFeatures>,
    /// By camera.
    blurs: Vec<Blur>,
    sigma_px: f64,
}

impl KeyframeView<'_> {
    /// Where a feature is seen; none where there is no such feature, or the lens has no ray.
    pub(super) fn bearing(&self, camera: usize, feature: usize) -> Option<Bearing> {
        let feature = self.features.images.get(camera)?.features.get(feature)?;
        let sigma_px = self.sigma_px * self.blurs.get(camera)?.of(feature.size_px);
        bearing(&self.cameras.get(camera)?.camera, feature.pixel, sigma_px)
    }
}

/// A point of a track: its keyframe, the track, and its place in the track.
type TrackPointRef = (u32, u32, u32);

/// What is worked out once for each drive.
pub(super) struct Surveyed<'a, E> {
    pub(super) drive: &'a Drive<'a, E>,
    /// `vehicle_from_camera`, in the rig's order.
    pub(super) mounts: Vec<Pose>,
    /// Driven path at each keyframe, metres.
    pub(super) path_m: Vec<f64>,
    sigma_px: f64,
}

impl<'a, E> Surveyed<'a, E> {
    pub(super) fn new(drive: &'a Drive<'a, E>, sigma_px: f64) -> Self {
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
            sigma_px,
        }
    }

    pub(super) fn view(&self, keyframe: usize) -> Result<KeyframeView<'a>, E> {
        let features = self.drive.seen.features(keyframe)?;
        Ok(KeyframeView {
            cameras: &self.drive.rig.cameras,
            blurs: features.images.iter().map(Blur::of_image).collect(),
            features,
            sigma_px: self.sigma_px,
        })
    }

    /// `a_from_b` of the vehicle at two keyframes, by odometry.
    pub(super) fn between(&self, a: usize, b: usize) -> Pose {
        let [a, b] = [a, b].map(|keyframe| &self.drive.keyframes[keyframe].odom_from_vehicle);
        a.inverse().compose(b)
    }
}

impl<E: Send> Surveyed<'_, E> {
    /// Where the features of the drive's tracks are seen, by track and point. Each keyframe is looked at once.
    pub(super) fn bearings(&self) -> Result<Vec<Vec<Option<Bearing>>>, E> {
        let tracks = &self.drive.tracks;
        let points = tracks.iter().map(|track| &track.points);
        let mut sightings: Vec<TrackPointRef> = (0..)
            .zip(points)
            .flat_map(|(track, points)| {
                let points = points.iter().zip(0..);
                points.map(move |((keyframe, _), at)| (*keyframe, track, at))
            })
            .collect();
        sightings.sort_unstable();
        let by_keyframe: Vec<&[TrackPointRef]> = sightings.chunk_by(|a, b| a.0 == b.0).collect();
        let found: Vec<Vec<Option<Bearing>>> = by_keyframe
            .par_iter()
            .map(|sightings| self.bearings_of(sightings))
            .collect::<Result<_, E>>()?;
        let mut bearings: Vec<Vec<Option<Bearing>>> = tracks
            .iter()
            .map(|track| vec![None; track.points.len()])
            .collect();
        let found = found.into_iter().flatten();
        for ((_, track, at), bearing) in sightings.iter().zip(found) {
            bearings[*track as usize][*at as usize] = bearing;
        }
        Ok(bearings)
    }

    /// Of the sightings from one keyframe; there are none from keyframes that the drive does not have.
    fn bearings_of(&self, sightings: &[TrackPointRef]) -> Result<Vec<Option<Bearing>>, E> {
        let keyframe = sightings[0].0 as usize;
        if keyframe >= self.drive.keyframes.len() {
            return Ok(vec![None; sightings.len()]);
        }
        let view = self.view(keyframe)?;
        let bearing = |(_, track, at): &TrackPointRef| {
            let track = &self.drive.tracks[*track as usize];
            view.bearing(track.camera, track.points[*at as usize].1 as usize)
        };
        Ok(sightings.iter().map(bearing).collect())
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
