//! A session as the metric map's algorithms want it: the rig, and its keyframes with their features.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::{Rig, RigCamera};
use evermap_algorithms::metric_map::features::{
    DESCRIPTOR_BYTES, Descriptor, Feature, ImageFeatures, KeyframeFeatures,
};
use evermap_contract::{Fault, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{Features, Keyframe};

use super::rig::{self, SessionName, frame};

/// One keyframe of a drive.
pub(crate) struct DriveKeyframe {
    /// Its instant.
    pub(crate) stamp: Stamp,
    /// Its number within the session.
    pub(crate) number: u32,
    /// The vehicle in the drifting odometry frame.
    pub(crate) odom_from_vehicle: Pose,
    /// What its cameras saw, in the rig's order.
    pub(crate) features: KeyframeFeatures,
}

/// One session.
pub(crate) struct Drive {
    /// Its cameras: those with features and a calibration.
    pub(crate) rig: Rig,
    /// Its keyframes, by stamp.
    pub(crate) keyframes: Vec<DriveKeyframe>,
    /// Images whose camera cannot be used, by reason.
    pub(crate) skipped: BTreeMap<rig::Reason, u64>,
}

/// The drives of all sessions, from the rows of their keyframes and features and the ports `calibration` and
/// `transforms`. A keyframe without features is kept: odometry goes through it.
///
/// # Errors
/// As [`Sides::rows`].
pub(crate) fn drives(
    keyframes: Vec<Keyframe>,
    features: Vec<Features>,
    sides: &Sides,
    vehicle_frame: &str,
) -> Result<BTreeMap<SessionName, Drive>, Fault> {
    let mounted = rig::sessions(sides)?;
    let mut drives: BTreeMap<SessionName, Drive> = BTreeMap::new();
    for row in keyframes {
        let Ok(odom_from_vehicle) = Pose::from_array(row.odom_from_vehicle.to_array()) else {
            continue;
        };
        let drive = drives
            .entry((row.site, row.session))
            .or_insert_with(Drive::empty);
        drive.keyframes.push(DriveKeyframe {
            stamp: row.stamp,
            number: row.keyframe,
            odom_from_vehicle,
            features: KeyframeFeatures::default(),
        });
    }
    let mut by_session: BTreeMap<SessionName, Vec<Features>> = BTreeMap::new();
    for row in features {
        by_session
            .entry((row.site.clone(), row.session.clone()))
            .or_default()
            .push(row);
    }
    for (name, drive) in &mut drives {
        drive.keyframes.sort_by_key(|keyframe| keyframe.stamp);
        let rows = by_session.remove(name).unwrap_or_default();
        drive.mount(mounted.get(name), &rows, vehicle_frame);
        drive.fill(rows);
    }
    Ok(drives)
}

/// The rig of every session whose images these are, from the ports `calibration` and `transforms`: for programs that
/// hand a map's cameras to others. Of the features only camera, stamp and size of the image are looked at. Cameras that
/// cannot be used are left out.
///
/// # Errors
/// As [`Sides::rows`].
pub fn rigs(
    features: Vec<Features>,
    sides: &Sides,
    vehicle_frame: &str,
) -> Result<BTreeMap<(String, String), Rig>, Fault> {
    let mounted = rig::sessions(sides)?;
    let mut by_session: BTreeMap<SessionName, Vec<Features>> = BTreeMap::new();
    for row in features {
        let name = (row.site.clone(), row.session.clone());
        by_session.entry(name).or_default().push(row);
    }
    let rigs = by_session.into_iter().map(|(name, rows)| {
        let mut drive = Drive::empty();
        drive.mount(mounted.get(&name), &rows, vehicle_frame);
        (name, drive.rig)
    });
    Ok(rigs.collect())
}

impl Drive {
    fn empty() -> Self {
        Self {
            rig: Rig::default(),
            keyframes: Vec::new(),
            skipped: BTreeMap::new(),
        }
    }

    /// Cameras are calibrated once per session: by the calibration that holds at their first image.
    fn mount(&mut self, mounted: Option<&rig::Rig>, rows: &[Features], vehicle_frame: &str) {
        let mut first: BTreeMap<&str, &Features> = BTreeMap::new();
        for row in rows {
            first.entry(&row.camera).or_insert(row);
        }
        for (name, row) in first {
            match mounted.map_or(Err("camera has no calibration"), |rig| {
                camera(rig, row, vehicle_frame)
            }) {
                Ok(camera) => self.rig.cameras.push(camera),
                Err(reason) => {
                    let images = rows.iter().filter(|row| row.camera == name).count() as u64;
                    *self.skipped.entry(reason).or_default() += images;
                }
            }
        }
    }

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

fn camera(rig: &rig::Rig, row: &Features, vehicle_frame: &str) -> Result<RigCamera, rig::Reason> {
    let name = frame(&row.camera);
    let calibration = rig
        .calibration(name, row.stamp)
        .ok_or("camera has no calibration")?;
    let vehicle_from_camera = rig
        .vehicle_from_camera(frame(vehicle_frame), name)
        .ok_or("no fixed transforms from camera to vehicle")?;
    Ok(RigCamera {
        name: row.camera.clone(),
        camera: rig::camera(calibration, [row.width, row.height])?,
        vehicle_from_camera,
    })
}

/// The features of a row: as many as all its lists have.
pub(crate) fn image_features(row: &Features) -> ImageFeatures {
    let descriptors = row.descriptors.0.chunks_exact(DESCRIPTOR_BYTES);
    let places = row.u.iter().zip(&row.v).zip(&row.size_px);
    let features = places.zip(descriptors).map(|(((u, v), size_px), bytes)| {
        let mut descriptor = [0; DESCRIPTOR_BYTES];
        descriptor.copy_from_slice(bytes);
        Feature {
            pixel: [f64::from(*u), f64::from(*v)],
            size_px: f64::from(*size_px),
            descriptor: Descriptor(descriptor),
        }
    });
    ImageFeatures {
        features: features.collect(),
    }
}
