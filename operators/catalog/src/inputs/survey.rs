//! All drives of a site that have poses in its map, in one numbering.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::association::{FeatureRef, Scene};
use evermap_algorithms::metric_map::features::DESCRIPTOR_BYTES;
use evermap_contract::{Emit, Fault, Sides};
use evermap_schemas::layers::{
    AdjustedPose, Features, ImageSize, Keyframe, Observation, VehiclePose,
};
use evermap_schemas::{Bytes, Stamp};

use super::drive::{Drive, drives};
use super::rig::VehicleFrame;

/// A keyframe by its session and instant.
pub(crate) type KeyframeName = (String, Stamp);

/// A keyframe of the survey.
pub(crate) struct SurveyKeyframe {
    /// Its session.
    pub(crate) session: String,
    /// Its number within the session.
    pub(crate) number: u32,
    /// The stretch of unbroken odometry that it belongs to.
    pub(crate) stretch: u32,
    /// Its instant.
    pub(crate) stamp: Stamp,
}

/// Drives that the map does not have yet.
#[derive(Default)]
pub(crate) struct NewDrives {
    /// Where their keyframes are, about; keyframes without a pose are left out.
    pub(crate) poses: Vec<VehiclePose>,
    /// Their keyframes.
    pub(crate) keyframes: Vec<Keyframe>,
    /// What their cameras saw.
    pub(crate) features: Vec<Features>,
}

/// Keyframes with poses, images and features of a site. Each stretch of unbroken odometry is a session of the scene.
#[derive(Default)]
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
    /// By image: the numbers of its features, where it does not have all of them.
    kept: BTreeMap<u32, Vec<u32>>,
}

impl Survey {
    /// Of the keyframes that hold the map up, with the features that show its landmarks, and of new drives with all of
    /// theirs; the rigs are those of the ports `calibration` and `transforms`. What cannot be used is counted.
    ///
    /// # Errors
    /// As [`Sides::rows`].
    pub(crate) fn new(
        known: &[AdjustedPose],
        new: NewDrives,
        sides: &Sides,
        vehicle: &VehicleFrame,
        emit: &mut Emit<'_>,
    ) -> Result<Self, Fault> {
        let NewDrives {
            poses,
            mut keyframes,
            mut features,
        } = new;
        let sessions: BTreeSet<&str> = known.iter().map(|row| row.session.as_str()).collect();
        let is_new = |session: &str| !sessions.contains(session);
        let poses = poses.iter().filter(|row| is_new(&row.session));
        let poses = poses.map(|row| (&row.session, row.stamp, &row.map_from_vehicle));
        let known_poses = known.iter();
        let known_poses = known_poses.map(|row| (&row.session, row.stamp, &row.map_from_vehicle));
        let mut by_session: BTreeMap<String, BTreeMap<Stamp, Pose>> = BTreeMap::new();
        for (session, stamp, pose) in poses.chain(known_poses) {
            match Pose::from_array(pose.to_array()) {
                Ok(pose) => {
                    let of_session = by_session.entry(session.clone()).or_default();
                    of_session.insert(stamp, pose);
                }
                Err(_) => emit.skip("pose is not a rigid transform", 1),
            }
        }
        let wanted = |session: &str| is_new(session) && by_session.contains_key(session);
        keyframes.retain(|row| wanted(&row.session));
        features.retain(|row| wanted(&row.session));
        keyframes.extend(known.iter().map(keyframe));
        features.extend(known.iter().flat_map(seen_features));
        let mut survey = Self::default();
        for (session, drive) in drives(keyframes, features, sides, vehicle, emit)? {
            if let Some(poses) = by_session.remove(&session) {
                survey.add(session, drive, &poses);
            }
        }
        survey.number_features(known);
        Ok(survey)
    }

    fn add(&mut self, session: String, drive: Drive, poses: &BTreeMap<Stamp, Pose>) {
        let mut stretches: Vec<(u32, Vec<_>)> = Vec::new();
        let numbers = self.numbers.entry(session.clone()).or_default();
        for keyframe in drive.keyframes {
            let Some(pose) = poses.get(&keyframe.stamp) else {
                continue;
            };
            numbers.insert(keyframe.number, self.keyframes.len());
            self.poses.push(*pose);
            self.keyframes.push(SurveyKeyframe {
                session: session.clone(),
                number: keyframe.number,
                stretch: keyframe.stretch,
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

    fn number_features(&mut self, known: &[AdjustedPose]) {
        for row in known {
            let Some(keyframe) = self.keyframe(&row.session, row.keyframe) else {
                continue;
            };
            for ImageSize { camera, .. } in &row.images {
                if let Some(image) = self.image(keyframe, camera) {
                    let seen = observed(row, camera).map(|(seen, _)| seen.feature);
                    self.kept.insert(image, seen.collect());
                }
            }
        }
    }

    /// The indices of the keyframes that are named, ascending.
    pub(crate) fn among(&self, names: &BTreeSet<KeyframeName>) -> Vec<usize> {
        let keyframes = self.keyframes.iter().enumerate();
        let named = keyframes
            .filter(|(_, keyframe)| names.contains(&(keyframe.session.clone(), keyframe.stamp)));
        named.map(|(at, _)| at).collect()
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

    fn image(&self, keyframe: usize, camera: &str) -> Option<u32> {
        let cameras = self.cameras.get(&self.keyframes[keyframe].session)?;
        Some(self.scene.keyframes[keyframe].images.start + cameras.get(camera)?)
    }

    /// A feature of a keyframe's image by a camera, by its number in the image.
    pub(crate) fn feature(&self, keyframe: usize, camera: &str, number: u32) -> Option<FeatureRef> {
        let image = self.image(keyframe, camera)?;
        let feature = match self.kept.get(&image) {
            Some(kept) => kept.binary_search(&number).ok()? as u32,
            None => number,
        };
        let feature = FeatureRef { image, feature };
        self.scene.has(feature).then_some(feature)
    }

    /// A feature's number in its image.
    pub(crate) fn number(&self, feature: FeatureRef) -> u32 {
        let kept = self.kept.get(&feature.image);
        let number = kept.and_then(|kept| kept.get(feature.feature as usize));
        number.copied().unwrap_or(feature.feature)
    }
}

/// A keyframe as far as the map keeps it.
fn keyframe(row: &AdjustedPose) -> Keyframe {
    Keyframe {
        site: row.site.clone(),
        session: row.session.clone(),
        stamp: row.stamp,
        keyframe: row.keyframe,
        distance_m: 0.0,
        stretch: row.stretch,
        odom_from_vehicle: row.odom_from_vehicle.clone(),
        images: Vec::new(),
    }
}

/// The observations of a camera with their descriptors, by rising number of the feature.
fn observed<'a>(
    row: &'a AdjustedPose,
    camera: &'a str,
) -> impl Iterator<Item = (&'a Observation, &'a [u8])> {
    let descriptors = row.descriptors.0.chunks_exact(DESCRIPTOR_BYTES);
    let all = row.observations.iter().zip(descriptors);
    let mut next = 0;
    all.filter(move |(seen, _)| {
        let wanted = seen.camera == camera && seen.feature >= next;
        if wanted {
            next = seen.feature.saturating_add(1);
        }
        wanted
    })
}

/// The features that a keyframe's observations show, by camera.
fn seen_features(row: &AdjustedPose) -> impl Iterator<Item = Features> {
    row.images.iter().map(|size| {
        let mut features = Features {
            site: row.site.clone(),
            session: row.session.clone(),
            stamp: row.stamp,
            keyframe: row.keyframe,
            camera: size.camera.clone(),
            width: size.width,
            height: size.height,
            u: Vec::new(),
            v: Vec::new(),
            size_px: Vec::new(),
            descriptors: Bytes::default(),
        };
        for (seen, descriptor) in observed(row, &size.camera) {
            features.u.push(seen.u);
            features.v.push(seen.v);
            features.size_px.push(seen.size_px);
            features.descriptors.0.extend(descriptor);
        }
        features
    })
}
