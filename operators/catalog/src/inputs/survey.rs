//! All drives of a site that have poses in its map, in one numbering.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::association::{DescriptorSource, FeatureRef, Scene};
use evermap_algorithms::metric_map::features::{
    DESCRIPTOR_BYTES, Descriptor, ImageFeatures, KeyframeFeatures,
};
use evermap_contract::{Emit, Fault, FetchedRows, Sides};
use evermap_schemas::layers::{
    AdjustedPose, Features, ImageSize, Keyframe, Observation, VehiclePose,
};
use evermap_schemas::{Bytes, Stamp, record};

use super::drive::{
    FeaturedDrive, FeaturedImage, StoredRows, descriptors, image_features, stored_drives,
};
use super::rig::VehicleFrame;

record! {
    /// What the features of an image look like, and nothing else of a row of features.
    pub struct ImageDescriptors {
        /// Binary descriptors, 64 bytes each.
        descriptors: Bytes,
    }
}

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

/// Drives that the map does not have yet. What their cameras saw are rows of the port `features`, which is fetched.
#[derive(Default)]
pub(crate) struct NewDrives {
    /// Where their keyframes are, about; keyframes without a pose are left out.
    pub(crate) poses: Vec<VehiclePose>,
    /// Their keyframes.
    pub(crate) keyframes: Vec<Keyframe>,
}

/// What the features of an image look like.
#[derive(Default)]
enum Looks {
    /// There are none.
    #[default]
    None,
    /// The row of the port `features` that says it.
    Stored(usize),
    /// By feature.
    Held(Vec<Descriptor>),
}

/// Keyframes with poses, images and features of a site. Each stretch of unbroken odometry is a session of the scene. What
/// features look like is fetched when it is asked for.
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
    /// By image.
    looks: Vec<Looks>,
    /// The rows of the port `features`.
    stored: FetchedRows<ImageDescriptors>,
}

impl Survey {
    /// Of the keyframes that hold the map up, with the features that show its landmarks, and of new drives with all of
    /// theirs, which the port `features` has; the rigs are those of the ports `calibration` and `transforms`. What cannot be
    /// used is counted.
    ///
    /// # Errors
    /// As [`Sides::rows`], and when features cannot be fetched.
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
        keyframes.extend(known.iter().map(keyframe));
        let mut named: Vec<(usize, FeaturedImage)> = sides
            .rows::<FeaturedImage>("features")?
            .into_iter()
            .enumerate()
            .collect();
        let images = Images::new(named.len(), known, sides)?;
        named.retain(|(_, image)| wanted(&image.session));
        named.extend(images.known());
        let mut survey = Self {
            scene: Scene::default(),
            poses: Vec::new(),
            keyframes: Vec::new(),
            numbers: BTreeMap::new(),
            cameras: BTreeMap::new(),
            kept: BTreeMap::new(),
            looks: Vec::new(),
            stored: sides.fetched("features")?,
        };
        for (session, drive) in stored_drives(keyframes, named, sides, vehicle, emit)? {
            if let Some(poses) = by_session.remove(&session) {
                survey.add(session, drive, &poses, &images)?;
            }
        }
        survey.number_features(known);
        Ok(survey)
    }

    fn add(
        &mut self,
        session: String,
        drive: FeaturedDrive<StoredRows>,
        poses: &BTreeMap<Stamp, Pose>,
        images: &Images<'_>,
    ) -> Result<(), Fault> {
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
        let looks = &mut self.looks;
        for (_, kept) in stretches {
            let seen = kept.into_iter().map(|(odom_from_vehicle, numbers)| {
                let features = images.keyframe(&numbers, looks);
                features.map(|features| (odom_from_vehicle, features))
            });
            self.scene.add_session(&drive.rig, seen)?;
        }
        Ok(())
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

impl DescriptorSource<Fault> for Survey {
    fn descriptors(&self, image: u32) -> Result<Cow<'_, [Descriptor]>, Fault> {
        match self.looks.get(image as usize) {
            Some(Looks::Stored(row)) => {
                let row = self.stored.row(*row)?;
                Ok(Cow::Owned(descriptors(&row.descriptors).collect()))
            }
            Some(Looks::Held(looks)) => Ok(Cow::Borrowed(looks.as_slice())),
            Some(Looks::None) | None => Ok(Cow::default()),
        }
    }
}

/// What images show, by number: first those of the port `features`, by row, then those of keyframes that hold the map up.
struct Images<'a> {
    stored: FetchedRows<Features>,
    /// The number of the first one that is not stored.
    first_known: usize,
    known: Vec<(&'a AdjustedPose, &'a ImageSize)>,
}

impl<'a> Images<'a> {
    fn new(rows: usize, known: &'a [AdjustedPose], sides: &Sides) -> Result<Self, Fault> {
        let of_row = |row: &'a AdjustedPose| row.images.iter().map(move |size| (row, size));
        Ok(Self {
            stored: sides.fetched("features")?,
            first_known: rows,
            known: known.iter().flat_map(of_row).collect(),
        })
    }

    /// Those that are not stored.
    fn known(&self) -> impl Iterator<Item = (usize, FeaturedImage)> {
        let image = |(row, size): &(&AdjustedPose, &ImageSize)| FeaturedImage {
            session: row.session.clone(),
            stamp: row.stamp,
            camera: size.camera.clone(),
            width: size.width,
            height: size.height,
        };
        (self.first_known..).zip(self.known.iter().map(image))
    }

    /// What a keyframe's images show; notes what it looks like behind that of the images before.
    fn keyframe(
        &self,
        numbers: &[Option<usize>],
        looks: &mut Vec<Looks>,
    ) -> Result<KeyframeFeatures, Fault> {
        let mut images = Vec::with_capacity(numbers.len());
        for number in numbers {
            let (features, look) = match number {
                Some(number) => self.image(*number)?,
                None => Default::default(),
            };
            images.push(features);
            looks.push(look);
        }
        Ok(KeyframeFeatures { images })
    }

    fn image(&self, number: usize) -> Result<(ImageFeatures, Looks), Fault> {
        let Some(known) = number.checked_sub(self.first_known) else {
            let features = image_features(&self.stored.row(number)?);
            return Ok((features, Looks::Stored(number)));
        };
        let (row, size) = self.known[known];
        let image = image_features(&seen_features(row, size));
        let looks = image.features.iter().map(|feature| feature.descriptor);
        let looks = Looks::Held(looks.collect());
        Ok((image, looks))
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

/// The features that a keyframe's observations show in one of its images.
fn seen_features(row: &AdjustedPose, size: &ImageSize) -> Features {
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
}
