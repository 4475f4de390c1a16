//! A session as the metric map's algorithms want it: the rig, and its keyframes with their features.

use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::{Rig, RigCamera};
use evermap_algorithms::metric_map::features::{
    DESCRIPTOR_BYTES, Descriptor, Feature, ImageFeatures, KeyframeFeatures,
};
use evermap_algorithms::metric_map::places::{self, DriveTrack, FeatureSource};
use evermap_contract::{Emit, Fault, FetchedRows, Reason, Sides};
use evermap_schemas::layers::{Features, Keyframe, Track};
use evermap_schemas::roles::{Calibration, Transform};
use evermap_schemas::{Bytes, Stamp, record};

use super::rig::{self, VehicleFrame, frame};

record! {
    /// An image that has features, without them: what the catalogue of a row store has of a row.
    pub struct FeaturedImage {
        /// Session that was driven.
        session: String,
        /// Instant of the keyframe.
        stamp: Stamp ["ns"],
        /// Camera that took the image.
        camera: String,
        /// Width of the image.
        width: u32 ["px"],
        /// Height of the image.
        height: u32 ["px"],
    }
}

/// One keyframe of a drive.
pub(crate) struct FeaturedKeyframe<F = KeyframeFeatures> {
    /// Its instant.
    pub(crate) stamp: Stamp,
    /// Its number within the session.
    pub(crate) number: u32,
    /// The stretch of unbroken odometry that it lies in.
    pub(crate) stretch: u32,
    /// The vehicle in the drifting odometry frame of that stretch.
    pub(crate) odom_from_vehicle: Pose,
    /// What its cameras saw, in the rig's order; or where that is to be found.
    pub(crate) features: F,
}

/// One session.
#[derive(Default)]
pub(crate) struct FeaturedDrive<F = KeyframeFeatures> {
    /// Its cameras: those with features and a calibration.
    pub(crate) rig: Rig,
    /// Its keyframes, by stamp.
    pub(crate) keyframes: Vec<FeaturedKeyframe<F>>,
}

/// The numbers by which a keyframe's images are found, in the rig's order: rows of a row store, as a rule. None where a
/// camera gave no features.
pub(crate) type StoredRows = Vec<Option<usize>>;

/// The drives by session, from the rows of their keyframes and features and the ports `calibration` and `transforms`. A
/// keyframe without features is kept: odometry goes through it. Images whose camera cannot be used are counted.
///
/// # Errors
/// As [`Sides::rows`].
pub(crate) fn drives(
    keyframes: Vec<Keyframe>,
    features: Vec<Features>,
    sides: &Sides,
    vehicle: &VehicleFrame,
    emit: &mut Emit<'_>,
) -> Result<BTreeMap<String, FeaturedDrive>, Fault> {
    let mounted = rig::sessions(sides)?;
    let mut drives: BTreeMap<String, FeaturedDrive> = routes(keyframes);
    let mut features = by_session(features, |row| &row.session);
    for (session, drive) in &mut drives {
        let rows = features.remove(session).unwrap_or_default();
        let shots: Vec<Shot<'_>> = rows.iter().map(Shot::of).collect();
        let mut skip = |reason, images| emit.skip(reason, images);
        drive.rig = rig(mounted.get(session), &shots, vehicle, &mut skip);
        drive.fill(rows);
    }
    Ok(drives)
}

/// As [`drives`], of features that stay where they are: `images` have the numbers by which they are found there.
///
/// # Errors
/// As [`Sides::rows`].
pub(crate) fn stored_drives(
    keyframes: Vec<Keyframe>,
    images: impl IntoIterator<Item = (usize, FeaturedImage)>,
    sides: &Sides,
    vehicle: &VehicleFrame,
    emit: &mut Emit<'_>,
) -> Result<BTreeMap<String, FeaturedDrive<StoredRows>>, Fault> {
    let mounted = rig::sessions(sides)?;
    let mut drives: BTreeMap<String, FeaturedDrive<StoredRows>> = routes(keyframes);
    let mut images = by_session(images, |(_, image)| &image.session);
    for (session, drive) in &mut drives {
        let images = images.remove(session).unwrap_or_default();
        let shots: Vec<Shot<'_>> = images.iter().map(|(_, image)| Shot::named(image)).collect();
        let mut skip = |reason, images| emit.skip(reason, images);
        drive.rig = rig(mounted.get(session), &shots, vehicle, &mut skip);
        drive.find(&images);
    }
    Ok(drives)
}

/// The drives by session, without cameras and what they saw.
fn routes<F: Default>(keyframes: Vec<Keyframe>) -> BTreeMap<String, FeaturedDrive<F>> {
    let mut drives: BTreeMap<String, FeaturedDrive<F>> = BTreeMap::new();
    for row in keyframes {
        let Ok(odom_from_vehicle) = Pose::from_array(row.odom_from_vehicle.to_array()) else {
            continue;
        };
        let drive = drives.entry(row.session).or_default();
        drive.keyframes.push(FeaturedKeyframe {
            stamp: row.stamp,
            number: row.keyframe,
            stretch: row.stretch,
            odom_from_vehicle,
            features: F::default(),
        });
    }
    for drive in drives.values_mut() {
        drive.keyframes.sort_by_key(|keyframe| keyframe.stamp);
    }
    drives
}

/// The rig of every session of a site whose images these are: for programs that hand a map's cameras to others. Of the
/// features only camera, stamp and size of the image are looked at. Cameras that cannot be used are left out.
pub fn rigs(
    features: Vec<Features>,
    calibration: Vec<Calibration>,
    transforms: Vec<Transform>,
    vehicle: &VehicleFrame,
) -> BTreeMap<String, Rig> {
    let mounted = rig::rigs(calibration, transforms);
    let sessions = by_session(features, |row| &row.session).into_iter();
    let of = |(session, rows): (String, Vec<Features>)| {
        let shots: Vec<Shot<'_>> = rows.iter().map(Shot::of).collect();
        let rig = rig(mounted.get(&session), &shots, vehicle, &mut |_, _| {});
        (session, rig)
    };
    sessions.map(of).collect()
}

fn by_session<T>(
    rows: impl IntoIterator<Item = T>,
    session: impl Fn(&T) -> &String,
) -> BTreeMap<String, Vec<T>> {
    let mut sessions: BTreeMap<String, Vec<T>> = BTreeMap::new();
    for row in rows {
        let rows = sessions.entry(session(&row).clone()).or_default();
        rows.push(row);
    }
    sessions
}

/// What a rig is told by an image: the camera, when, and the image's width and height.
struct Shot<'a> {
    camera: &'a str,
    stamp: Stamp,
    size: [u32; 2],
}

impl<'a> Shot<'a> {
    fn of(row: &'a Features) -> Self {
        Self {
            camera: &row.camera,
            stamp: row.stamp,
            size: [row.width, row.height],
        }
    }

    fn named(image: &'a FeaturedImage) -> Self {
        Self {
            camera: &image.camera,
            stamp: image.stamp,
            size: [image.width, image.height],
        }
    }
}

/// The rig whose images these are. Cameras are calibrated once per session: by the calibration that holds at their first
/// image. A camera is of the size that most of its images have; others are counted, and are none of this rig's.
fn rig(
    mounted: Option<&rig::Rig>,
    shots: &[Shot<'_>],
    vehicle: &VehicleFrame,
    skip: &mut dyn FnMut(Reason, u64),
) -> Rig {
    let mut taken: BTreeMap<&str, Vec<&Shot<'_>>> = BTreeMap::new();
    for shot in shots {
        taken.entry(shot.camera).or_default().push(shot);
    }
    let mut cameras = Vec::new();
    for (name, shots) in taken {
        let (first, images) = usual(&shots);
        if images < shots.len() {
            let [width, height] = first.size;
            let reason = format!(
                "image of camera `{}` has another size than most of its session, {width} × {height}",
                frame(name)
            );
            skip(reason.into(), (shots.len() - images) as u64);
        }
        let mounted = mounted.ok_or_else(|| rig::uncalibrated(frame(name)));
        match mounted.and_then(|rig| camera(rig, first, vehicle)) {
            Ok(camera) => cameras.push(camera),
            Err(reason) => skip(reason, images as u64),
        }
    }
    Rig { cameras }
}

/// The first image of the size that most of these have, and how many have it; of sizes that are as usual, the first.
fn usual<'a>(shots: &[&'a Shot<'a>]) -> (&'a Shot<'a>, usize) {
    let mut counts: BTreeMap<[u32; 2], (usize, Reverse<usize>)> = BTreeMap::new();
    for (at, shot) in shots.iter().enumerate() {
        counts.entry(shot.size).or_insert((0, Reverse(at))).0 += 1;
    }
    let most = counts.into_values().max();
    let (images, Reverse(first)) = most.unwrap_or_default();
    (shots[first], images)
}

/// Calibrations by which no pixel moves farther than this are the same: features are not found better.
const SAME_PX: f64 = 0.5;

/// Whether one camera of a session, whose images these are, is calibrated anew between the first and the last of them, so
/// that pixels move. Drives go by the first calibration.
///
/// # Errors
/// As [`Sides::rows`].
pub(crate) fn is_recalibrated(rows: &[Features], sides: &Sides) -> Result<bool, Fault> {
    let mounted = rig::sessions(sides)?;
    let changes = |(first, last): (&Features, &Features)| {
        let (rig, name) = (mounted.get(&first.session)?, frame(&first.camera));
        let shots: Vec<Shot<'_>> = rows.iter().map(Shot::of).collect();
        let size = usual(&shots.iter().collect::<Vec<_>>()).0.size;
        let lens = |calibration: &Arc<Calibration>| {
            let frame_from_camera = rig::frame_from_camera(calibration).ok()?;
            Some((rig::camera(calibration, size).ok()?, frame_from_camera))
        };
        let used = lens(rig.calibration(name, first.stamp).ok()?)?;
        let mut later = rig
            .recalibrations(name, first.stamp, last.stamp)
            .iter()
            .map(lens);
        Some(later.any(|other| other.is_none_or(|other| moves(&used, &other))))
    };
    let ends = rows.first().zip(rows.last());
    Ok(ends.and_then(changes).unwrap_or_default())
}

/// Whether another lens, as it is mounted, has the rays of pixels elsewhere.
fn moves((used, mounted): &(Camera, Pose), (other, other_mounted): &(Camera, Pose)) -> bool {
    let other_from_used = other_mounted.inverse().compose(mounted);
    const TRIED: u32 = 5;
    let at = |step: u32, size: u32| f64::from(step) / f64::from(TRIED - 1) * f64::from(size - 1);
    let mut places = (0..TRIED).flat_map(|v| (0..TRIED).map(move |u| [u, v]));
    places.any(|[u, v]| {
        let pixel = [at(u, used.width), at(v, used.height)];
        let ray = used.unproject(pixel);
        let moved = ray.and_then(|ray| other.project(&other_from_used.rotate(&ray)));
        moved.is_some_and(|[u, v]| (u - pixel[0]).hypot(v - pixel[1]) > SAME_PX)
    })
}

impl<F> FeaturedDrive<F> {
    /// The index of a keyframe by its number.
    pub(crate) fn index(&self, number: u32) -> Option<usize> {
        self.keyframes
            .binary_search_by_key(&number, |keyframe| keyframe.number)
            .ok()
    }

    /// The indices of an image's keyframe and camera; `None` where its camera takes images of another size.
    fn image(&self, shot: &Shot<'_>) -> Option<(usize, usize)> {
        let keyframe = self
            .keyframes
            .binary_search_by_key(&shot.stamp, |keyframe| keyframe.stamp);
        let camera = self.rig.index(shot.camera)?;
        let lens = &self.rig.cameras[camera].camera;
        ([lens.width, lens.height] == shot.size).then_some((keyframe.ok()?, camera))
    }
}

impl FeaturedDrive {
    fn fill(&mut self, rows: Vec<Features>) {
        let cameras = self.rig.cameras.len();
        for keyframe in &mut self.keyframes {
            keyframe.features.images = vec![ImageFeatures::default(); cameras];
        }
        for row in rows {
            if let Some((keyframe, camera)) = self.image(&Shot::of(&row)) {
                self.keyframes[keyframe].features.images[camera] = image_features(&row);
            }
        }
    }
}

impl FeaturedDrive<StoredRows> {
    /// Notes where images are in the store.
    fn find(&mut self, images: &[(usize, FeaturedImage)]) {
        let cameras = self.rig.cameras.len();
        for keyframe in &mut self.keyframes {
            keyframe.features = vec![None; cameras];
        }
        for (row, image) in images {
            if let Some((keyframe, camera)) = self.image(&Shot::named(image)) {
                self.keyframes[keyframe].features[camera] = Some(*row);
            }
        }
    }
}

/// What the cameras of a drive saw, fetched when it is looked at.
pub(crate) struct FetchedFeatures<'a> {
    /// The drive.
    pub(crate) drive: &'a FeaturedDrive<StoredRows>,
    /// The row store that its keyframes name rows of.
    pub(crate) features: &'a FetchedRows<Features>,
}

impl FeatureSource<Fault> for FetchedFeatures<'_> {
    fn features(&self, keyframe: usize) -> Result<Cow<'_, KeyframeFeatures>, Fault> {
        let keyframe = self.drive.keyframes.get(keyframe);
        let rows = keyframe.into_iter().flat_map(|found| &found.features);
        let images = rows.map(|row| match row {
            Some(row) => self.features.row(*row).map(|row| image_features(&row)),
            None => Ok(ImageFeatures::default()),
        });
        let images = images.collect::<Result<_, Fault>>()?;
        Ok(Cow::Owned(KeyframeFeatures { images }))
    }
}

impl FetchedFeatures<'_> {
    /// The drive with its tracks.
    pub(crate) fn with_tracks(&self, tracks: Vec<DriveTrack>) -> places::Drive<'_, Fault> {
        let keyframes = self.drive.keyframes.iter();
        let keyframes = keyframes.map(|keyframe| places::DriveKeyframe {
            stamp: keyframe.stamp.0,
            odom_from_vehicle: keyframe.odom_from_vehicle,
        });
        places::Drive {
            rig: &self.drive.rig,
            keyframes: keyframes.collect(),
            seen: self,
            tracks,
        }
    }
}

/// Tracks by session, with keyframes by index. A track of a camera that cannot be used is left out.
pub(crate) fn tracks(
    rows: Vec<Track>,
    drives: &BTreeMap<String, FeaturedDrive<StoredRows>>,
    emit: &mut Emit<'_>,
) -> BTreeMap<String, Vec<DriveTrack>> {
    let mut tracks: BTreeMap<String, Vec<DriveTrack>> = BTreeMap::new();
    for row in rows {
        let drive = drives.get(&row.session);
        let camera = drive.and_then(|drive| Some((drive, drive.rig.index(&row.camera)?)));
        let Some((drive, camera)) = camera else {
            emit.skip("track of a camera that cannot be used", 1);
            continue;
        };
        let indexed = row.points.iter();
        let points = indexed
            .filter_map(|point| Some((drive.index(point.keyframe)? as u32, point.feature)))
            .collect();
        let of_session = tracks.entry(row.session).or_default();
        of_session.push(DriveTrack { camera, points });
    }
    tracks
}

fn camera(rig: &rig::Rig, shot: &Shot<'_>, vehicle: &VehicleFrame) -> Result<RigCamera, Reason> {
    let name = frame(shot.camera);
    let calibration = rig.calibration(name, shot.stamp)?;
    Ok(RigCamera {
        name: shot.camera.to_owned(),
        camera: rig::camera(calibration, shot.size)?,
        vehicle_from_camera: rig.vehicle_from_camera(vehicle.name(), calibration)?,
    })
}

/// The features of a row: as many as all its lists have.
pub(crate) fn image_features(row: &Features) -> ImageFeatures {
    let places = row.u.iter().zip(&row.v).zip(&row.size_px);
    let features = places.zip(descriptors(&row.descriptors));
    let features = features.map(|(((u, v), size_px), descriptor)| Feature {
        pixel: [f64::from(*u), f64::from(*v)],
        size_px: f64::from(*size_px),
        descriptor,
    });
    ImageFeatures {
        features: features.collect(),
    }
}

/// Descriptors that lie one after the other; a torn one at the end is none.
pub(crate) fn descriptors(bytes: &Bytes) -> impl Iterator<Item = Descriptor> {
    let (whole, _) = bytes.0.as_chunks::<DESCRIPTOR_BYTES>();
    whole.iter().copied().map(Descriptor)
}

#[cfg(test)]
mod tests;
