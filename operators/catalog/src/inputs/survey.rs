//! All drives of a site that have poses in its map, in one numbering.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::association::{FeatureRef, Scene};
use evermap_contract::{Emit, Fault, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{AdjustedPose, Features, Keyframe};

use super::drive::{Drive, drives};
use super::rig::VehicleFrame;

/// A keyframe of the survey.
pub(crate) struct SurveyKeyframe {
    /// Its session.
    pub(crate) session: String,
    /// Its number within the session.
    pub(crate) number: u32,
    /// Its instant.
    pub(crate) stamp: Stamp,
}

/// Keyframes with poses, images and features of a site. Each stretch of unbroken odometry is a session of the scene.
pub(crate) struct Survey {
    /// What was seen.
    pub(crate) scene: Scene,
    /// `map_from_vehicle` of the scene's keyframes.
    pub(crate) poses: Vec<Pose>,
    /// The scene's keyframes.
    pub(crate) keyframes: Vec<SurveyKeyframe>,
    /// By session and number.
    numbers: BTreeMap<String, BTreeMap<u32, usize>>,
    /// By session and name of the camera: its place in a keyframe's images.
    cameras: BTreeMap<String, BTreeMap<String, u32>>,
}

impl Survey {
    /// From the poses of keyframes (session, number, `[x, y, z, qx, qy, qz, qw]`), rows of keyframes, and the ports
    /// `features`, `calibration` and `transforms`. What cannot be used is counted.
    ///
    /// # Errors
    /// As [`Sides::rows`].
    pub(crate) fn new<'a>(
        poses: impl IntoIterator<Item = (&'a str, u32, [f64; 7])>,
        mut keyframes: Vec<Keyframe>,
        sides: &Sides,
        vehicle: &VehicleFrame,
        emit: &mut Emit<'_>,
    ) -> Result<Self, Fault> {
        let mut by_session: BTreeMap<&str, BTreeMap<u32, Pose>> = BTreeMap::new();
        for (session, number, pose) in poses {
            match Pose::from_array(pose) {
                Ok(pose) => {
                    by_session.entry(session).or_default().insert(number, pose);
                }
                Err(_) => emit.skip("pose is no rigid transform", 1),
            }
        }
        keyframes.retain(|row| by_session.contains_key(row.session.as_str()));
        let mut features = sides.rows::<Features>("features")?;
        features.retain(|row| by_session.contains_key(row.session.as_str()));
        let mut survey = Self {
            scene: Scene::default(),
            poses: Vec::new(),
            keyframes: Vec::new(),
            numbers: BTreeMap::new(),
            cameras: BTreeMap::new(),
        };
        for (session, drive) in drives(keyframes, features, sides, vehicle, emit)? {
            if let Some(poses) = by_session.remove(session.as_str()) {
                survey.add(session, drive, &poses);
            }
        }
        Ok(survey)
    }

    fn add(&mut self, session: String, drive: Drive, poses: &BTreeMap<u32, Pose>) {
        let mut stretches: Vec<(u32, Vec<_>)> = Vec::new();
        let numbers = self.numbers.entry(session.clone()).or_default();
        for keyframe in drive.keyframes {
            let Some(pose) = poses.get(&keyframe.number) else {
                continue;
            };
            numbers.insert(keyframe.number, self.keyframes.len());
            self.poses.push(*pose);
            self.keyframes.push(SurveyKeyframe {
                session: session.clone(),
                number: keyframe.number,
                stamp: keyframe.stamp,
            });
            let kept = (keyframe.odom_from_vehicle, keyframe.features);
            match stretches.last_mut() {
                Some((stretch, all)) if *stretch == keyframe.stretch => all.push(kept),
                _ => stretches.push((keyframe.stretch, vec![kept])),
            }
        }
        let cameras = drive.rig.cameras.iter().zip(0_u32..);
        let cameras = cameras.map(|(camera, at)| (camera.name.clone(), at));
        self.cameras.insert(session, cameras.collect());
        for (_, kept) in stretches {
            self.scene.add_session(&drive.rig, kept);
        }
    }

    /// The index of a keyframe.
    pub(crate) fn keyframe(&self, session: &str, number: u32) -> Option<usize> {
        self.numbers.get(session)?.get(&number).copied()
    }

    /// The features that adjusted poses' landmarks show, by number.
    pub(crate) fn landmarks(&self, poses: &[AdjustedPose]) -> BTreeMap<u32, Vec<FeatureRef>> {
        let mut landmarks: BTreeMap<u32, Vec<FeatureRef>> = BTreeMap::new();
        for row in poses {
            let keyframe = self.keyframe(&row.session, row.keyframe);
            for seen in &row.observations {
                let of = |keyframe| self.feature(keyframe, &seen.camera, seen.feature);
                let features = landmarks.entry(seen.landmark).or_default();
                features.extend(keyframe.and_then(of));
            }
        }
        landmarks
    }

    /// A feature of a keyframe's image by a camera.
    pub(crate) fn feature(
        &self,
        keyframe: usize,
        camera: &str,
        feature: u32,
    ) -> Option<FeatureRef> {
        let at = self
            .cameras
            .get(&self.keyframes[keyframe].session)?
            .get(camera)?;
        let image = self.scene.keyframes[keyframe].images.start + at;
        let feature = FeatureRef { image, feature };
        self.scene.has(feature).then_some(feature)
    }
}
