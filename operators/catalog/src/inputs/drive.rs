//! A session as the metric map's algorithms want it: the rig, and its keyframes with their features.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::{Rig, RigCamera};
use evermap_algorithms::metric_map::features::{
    DESCRIPTOR_BYTES, Descriptor, Feature, ImageFeatures, KeyframeFeatures,
};
use evermap_algorithms::metric_map::places::{self, DriveTrack};
use evermap_contract::{Emit, Fault, Reason, Sides};
use evermap_schemas::layers::{Features, Keyframe, Track};
use evermap_schemas::roles::{Calibration, Transform};
use evermap_schemas::{Bytes, Stamp};

use super::rig::{self, VehicleFrame, frame};

/// One keyframe of a drive.
pub(crate) struct DriveKeyframe {
    /// Its instant.
    pub(crate) stamp: Stamp,
    /// Its number within the session.
    pub(crate) number: u32,
    /// The stretch of unbroken odometry that it lies in.
    pub(crate) stretch: u32,
    /// The vehicle in the drifting odometry frame of that stretch.
    pub(crate) odom_from_vehicle: Pose,
    /// What its cameras saw, in the rig's order.
    pub(crate) features: KeyframeFeatures,
}

/// One session.
#[derive(Default)]
pub(crate) struct Drive {
    /// Its cameras: those with features and a calibration.
    pub(crate) rig: Rig,
    /// Its keyframes, by stamp.
    pub(crate) keyframes: Vec<DriveKeyframe>,
}

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
) -> Result<BTreeMap<String, Drive>, Fault> {
    let mounted = rig::sessions(sides)?;
    let mut drives: BTreeMap<String, Drive> = BTreeMap::new();
    for row in keyframes {
        let Ok(odom_from_vehicle) = Pose::from_array(row.odom_from_vehicle.to_array()) else {
            continue;
        };
        let drive = drives.entry(row.session).or_default();
        drive.keyframes.push(DriveKeyframe {
            stamp: row.stamp,
            number: row.keyframe,
            stretch: row.stretch,
            odom_from_vehicle,
            features: KeyframeFeatures::default(),
        });
    }
    let mut features = by_session(features);
    for (session, drive) in &mut drives {
        let rows = features.remove(session).unwrap_or_default();
        let mut skip = |reason, images| emit.skip(reason, images);
        drive.rig = rig(mounted.get(session), &rows, vehicle, &mut skip);
        drive.keyframes.sort_by_key(|keyframe| keyframe.stamp);
        drive.fill(rows);
    }
    Ok(drives)
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
    let sessions = by_session(features).into_iter();
    let of = |(session, rows): (String, Vec<Features>)| {
        let rig = rig(mounted.get(&session), &rows, vehicle, &mut |_, _| {});
        (session, rig)
    };
    sessions.map(of).collect()
}

fn by_session(features: Vec<Features>) -> BTreeMap<String, Vec<Features>> {
    let mut sessions: BTreeMap<String, Vec<Features>> = BTreeMap::new();
    for row in features {
        sessions.entry(row.session.clone()).or_default().push(row);
    }
    sessions
}

/// The rig whose images these are. Cameras are calibrated once per session: by the calibration that holds at their first
/// image.
fn rig(
    mounted: Option<&rig::Rig>,
    rows: &[Features],
    vehicle: &VehicleFrame,
    skip: &mut dyn FnMut(Reason, u64),
) -> Rig {
    let mut first: BTreeMap<&str, &Features> = BTreeMap::new();
    for row in rows {
        first.entry(&row.camera).or_insert(row);
    }
    let mut cameras = Vec::new();
    for (name, row) in first {
        let mounted = mounted.ok_or_else(|| rig::uncalibrated(name));
        match mounted.and_then(|rig| camera(rig, row, vehicle)) {
            Ok(camera) => cameras.push(camera),
            Err(reason) => {
                let images = rows.iter().filter(|row| row.camera == name).count();
                skip(reason, images as u64);
            }
        }
    }
    Rig { cameras }
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
        let size = [first.width, first.height];
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

impl Drive {
    fn fill(&mut self, rows: Vec<Features>) {
        let cameras = self.rig.cameras.len();
        for keyframe in &mut self.keyframes {
            keyframe.features.images = vec![ImageFeatures::default(); cameras];
        }
        for row in rows {
            let keyframe = self
                .keyframes
                .binary_search_by_key(&row.stamp, |keyframe| keyframe.stamp);
            if let (Ok(keyframe), Some(camera)) = (keyframe, self.rig.index(&row.camera)) {
                self.keyframes[keyframe].features.images[camera] = image_features(&row);
            }
        }
    }

    /// The index of a keyframe by its number.
    pub(crate) fn index(&self, number: u32) -> Option<usize> {
        self.keyframes
            .binary_search_by_key(&number, |keyframe| keyframe.number)
            .ok()
    }
}

/// A drive with its tracks.
pub(crate) fn with_tracks(drive: &Drive, tracks: Vec<DriveTrack>) -> places::Drive<'_> {
    let keyframes = drive
        .keyframes
        .iter()
        .map(|keyframe| places::DriveKeyframe {
            stamp: keyframe.stamp.0,
            odom_from_vehicle: keyframe.odom_from_vehicle,
            features: &keyframe.features,
        });
    places::Drive {
        rig: &drive.rig,
        keyframes: keyframes.collect(),
        tracks,
    }
}

/// Tracks by session, with keyframes by index. A track of a camera that cannot be used is left out.
pub(crate) fn tracks(
    rows: Vec<Track>,
    drives: &BTreeMap<String, Drive>,
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

fn camera(rig: &rig::Rig, row: &Features, vehicle: &VehicleFrame) -> Result<RigCamera, Reason> {
    let name = frame(&row.camera);
    let calibration = rig.calibration(name, row.stamp)?;
    Ok(RigCamera {
        name: row.camera.clone(),
        camera: rig::camera(calibration, [row.width, row.height])?,
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
mod tests {
    #![allow(clippy::unwrap_used)]
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    #[test]
    fn a_camera_that_is_turned_otherwise_has_its_pixels_elsewhere() {
        let k = [100.0, 0.0, 99.5, 0.0, 100.0, 74.5, 0.0, 0.0, 1.0];
        let lens = Camera::from_calibration("plumb_bob", 200, 150, &k, &[]).unwrap();
        let turned = |angle_rad: f64| {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle_rad);
            (lens.clone(), Pose::new(Vector3::zeros(), rotation))
        };
        // In the corners, twice as many pixels to an angle as in the middle.
        assert!(!moves(&turned(0.05), &turned(0.05)));
        assert!(!moves(&turned(0.0), &turned(0.002)));
        assert!(moves(&turned(0.0), &turned(0.01)));
    }
}
