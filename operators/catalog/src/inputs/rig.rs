//! A session's cameras: their calibrations over time, and where they are mounted.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::{Rig as MountedCameras, RigCamera};
use evermap_contract::{Fault, Port, Reach, Reason, Sides};
use evermap_schemas::Stamp;
pub(crate) use evermap_schemas::roles::frame_names::plain as frame;
use evermap_schemas::roles::{Calibration, Transform, calibration, frame_names};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The frame that poses are of where nobody says.
pub const USUAL_VEHICLE: &str = "base_link";

/// The frame that poses are of: a parameter of all that read cameras.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct VehicleFrame {
    /// The frame that poses are of, as the transforms name it. Without a prefix it also means the only frame that has
    /// one in front of this name (`robot1/base_link`).
    pub vehicle_frame: String,
}

impl VehicleFrame {
    /// Its name, without ROS 1's slash.
    pub(crate) fn name(&self) -> &str {
        frame(&self.vehicle_frame)
    }
}

impl Default for VehicleFrame {
    fn default() -> Self {
        Self {
            vehicle_frame: USUAL_VEHICLE.to_owned(),
        }
    }
}

/// The options of an algorithm that works on a vehicle's cameras.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
pub struct OfVehicle<O> {
    /// Those of the algorithm.
    #[serde(flatten)]
    pub options: O,
    /// The vehicle.
    #[serde(flatten)]
    pub vehicle: VehicleFrame,
}

/// The ports that [`sessions`] reads.
pub(crate) fn ports(reach: Reach) -> [Port; 2] {
    [
        Port::of::<Calibration>("calibration", reach),
        Port::of::<Transform>("transforms", reach),
    ]
}

/// The rigs by session, from the tables of [`ports`].
pub(crate) fn sessions(sides: &Sides) -> Result<BTreeMap<String, Rig>, Fault> {
    Ok(rigs(sides.rows("calibration")?, sides.rows("transforms")?))
}

/// The rigs of one site's sessions.
pub(crate) fn rigs(
    calibration: Vec<Calibration>,
    transforms: Vec<Transform>,
) -> BTreeMap<String, Rig> {
    let mut sessions: BTreeMap<String, Rig> = BTreeMap::new();
    for row in calibration {
        let rig = sessions.entry(row.session.clone()).or_default();
        let of_camera = rig.calibrations.entry(frame(&row.camera).to_owned());
        of_camera.or_default().push(Arc::new(row));
    }
    for row in transforms.into_iter().filter(|row| row.fixed) {
        sessions.entry(row.session.clone()).or_default().mount(row);
    }
    sessions.values_mut().for_each(Rig::settle);
    sessions
}

/// How a session's fixed transforms carry its vehicle.
#[derive(Debug, Clone)]
pub struct Footing {
    /// The frame that poses are of, as the transforms name it.
    pub vehicle: String,
    /// The frame that all of them hang off which lead to the vehicle: the vehicle itself where none leads to it.
    pub root: String,
    /// That frame on the vehicle; `None` where it is the vehicle.
    pub vehicle_from_root: Option<Pose>,
}

/// How these transforms of one session carry its vehicle: for programs that hand a map's frames to others.
pub fn footing(transforms: Vec<Transform>, vehicle: &VehicleFrame) -> Footing {
    let mut rig = Rig::default();
    let fixed = transforms.into_iter().filter(|row| row.fixed);
    fixed.for_each(|row| rig.mount(row));
    rig.settle();
    let meant = frame_names::meant(vehicle.name(), rig.frames());
    let vehicle = meant.unwrap_or(vehicle.name());
    let ancestors = rig.ancestors(vehicle);
    let carried = ancestors.last().filter(|(root, _)| *root != vehicle);
    Footing {
        vehicle: vehicle.to_owned(),
        root: carried.map_or(vehicle, |(root, _)| *root).to_owned(),
        vehicle_from_root: carried.map(|(_, root_from_vehicle)| root_from_vehicle.inverse()),
    }
}

/// One session's cameras, and how they are mounted.
#[derive(Default)]
pub(crate) struct Rig {
    /// By camera, by stamp.
    calibrations: BTreeMap<String, Vec<Arc<Calibration>>>,
    /// Stamp, parent and `parent_from_child` by child; the latest of several.
    mounts: BTreeMap<String, (Stamp, String, Pose)>,
    /// Frames that are fixed to each other in a circle: they are mounted nowhere.
    circles: BTreeSet<String>,
}

impl Rig {
    fn mount(&mut self, row: Transform) {
        let Ok(parent_from_child) = Pose::from_array(row.parent_from_child.to_array()) else {
            return;
        };
        let (child, parent) = (frame(&row.child), frame(&row.parent).to_owned());
        let known = self.mounts.get(child);
        if known.is_none_or(|(stamp, other, _)| (row.stamp, &parent) >= (*stamp, other)) {
            self.mounts
                .insert(child.to_owned(), (row.stamp, parent, parent_from_child));
        }
    }

    /// When all calibrations and mounts have come.
    fn settle(&mut self) {
        for of_camera in self.calibrations.values_mut() {
            of_camera.sort_by_key(|calibration| calibration.stamp);
        }
        self.circles = self.circles();
        let circles = &self.circles;
        self.mounts.retain(|child, _| !circles.contains(child));
    }

    /// The frames that are fixed to each other in a circle.
    fn circles(&self) -> BTreeSet<String> {
        let mut circles = BTreeSet::new();
        // By frame, the walk that came there first.
        let mut walked = BTreeMap::new();
        for (walk, start) in self.mounts.keys().enumerate() {
            let mut next = Some(start);
            while let Some(frame) = next
                && !walked.contains_key(frame)
            {
                walked.insert(frame, walk);
                next = self.mounts.get(frame).map(|(_, parent, _)| parent);
            }
            // The walk meets itself.
            while let Some(frame) = next
                && walked.get(frame) == Some(&walk)
                && circles.insert(frame.clone())
            {
                next = self.mounts.get(frame).map(|(_, parent, _)| parent);
            }
        }
        circles
    }

    /// The calibration that holds at an instant: the latest that is not after it, else the first.
    pub(crate) fn calibration(
        &self,
        camera: &str,
        stamp: Stamp,
    ) -> Result<&Arc<Calibration>, Reason> {
        let of_camera = self.calibrations.get(camera).map_or(&[][..], Vec::as_slice);
        let after = of_camera.partition_point(|calibration| calibration.stamp <= stamp);
        let calibration = of_camera.get(after.saturating_sub(1));
        calibration.ok_or_else(|| uncalibrated(camera))
    }

    /// The calibrations that come to hold after an instant, up to another one.
    pub(crate) fn recalibrations(
        &self,
        camera: &str,
        after: Stamp,
        until: Stamp,
    ) -> &[Arc<Calibration>] {
        let of_camera = self.calibrations.get(camera).map_or(&[][..], Vec::as_slice);
        let at = |stamp: Stamp| of_camera.partition_point(|calibration| calibration.stamp <= stamp);
        of_camera.get(at(after)..at(until)).unwrap_or_default()
    }

    /// The cameras as they were first calibrated, for images of the size that they were calibrated for; those that cannot
    /// be used are left out.
    pub(crate) fn cameras(&self, vehicle: &VehicleFrame) -> MountedCameras {
        let mounted = |(name, calibrations): (&String, &Vec<Arc<Calibration>>)| {
            let first = calibrations.first()?;
            Some(RigCamera {
                name: name.clone(),
                camera: camera(first, [first.width, first.height]).ok()?,
                vehicle_from_camera: self.vehicle_from_camera(vehicle.name(), first).ok()?,
            })
        };
        MountedCameras {
            cameras: self.calibrations.iter().filter_map(mounted).collect(),
        }
    }

    /// All frames that are mounted, and what they are mounted on.
    fn frames(&self) -> impl Iterator<Item = &str> {
        let mounts = self.mounts.iter();
        mounts.flat_map(|(child, (_, parent, _))| [child.as_str(), parent.as_str()])
    }

    /// The vehicle from a frame of these ancestors.
    fn vehicle_from(&self, vehicle: &str, ancestors: &[(&str, Pose)]) -> Option<Pose> {
        let of_vehicle = self.ancestors(vehicle);
        ancestors.iter().find_map(|(ancestor, from_frame)| {
            let (_, from_vehicle) = of_vehicle.iter().find(|(name, _)| name == ancestor)?;
            Some(from_vehicle.inverse().compose(from_frame))
        })
    }

    /// A frame and its ancestors, each with its own pose: `(ancestor, ancestor_from_frame)`. No mount is on a circle.
    fn ancestors<'a>(&'a self, start: &'a str) -> Vec<(&'a str, Pose)> {
        let mut chain = vec![(start, Pose::identity())];
        while let Some((child, child_from_start)) = chain.last()
            && let Some((_, parent, parent_from_child)) = self.mounts.get(*child)
        {
            chain.push((parent, parent_from_child.compose(child_from_start)));
        }
        chain
    }

    /// Whether the session has fixed transforms.
    pub(crate) fn is_mounted(&self) -> bool {
        !self.mounts.is_empty()
    }

    /// A frame on the vehicle, through the nearest common ancestor of the two, of which the vehicle's may be the only one of
    /// its name behind a prefix.
    pub(crate) fn vehicle_from_frame(&self, vehicle: &str, frame: &str) -> Result<Pose, Reason> {
        let of_frame = self.ancestors(frame);
        let prefixed = || {
            let frames = self.frames().chain([frame]);
            self.vehicle_from(frame_names::meant(vehicle, frames)?, &of_frame)
        };
        let found = self.vehicle_from(vehicle, &of_frame).or_else(prefixed);
        let found = found.ok_or_else(|| {
            let ends = of_frame.last().map_or(frame, |(ancestor, _)| *ancestor);
            match self.circles.contains(ends) {
                true => in_circle(frame, ends),
                false => apart(frame, vehicle, ends),
            }
        })?;
        near(found, frame, vehicle)
    }

    /// The camera of a calibration on the vehicle, as its images look: from where its frame is, or where the calibration
    /// says that it is mounted. The one place that says so.
    pub(crate) fn vehicle_from_camera(
        &self,
        vehicle: &str,
        calibration: &Calibration,
    ) -> Result<Pose, Reason> {
        let Some(mount) = &calibration.mount else {
            return self.vehicle_from_frame(vehicle, frame(&calibration.camera));
        };
        let vehicle_from_frame = self.vehicle_from_frame(vehicle, frame(&mount.frame))?;
        let found = vehicle_from_frame.compose(&frame_from_camera(calibration)?);
        near(found, &calibration.camera, vehicle)
    }

    /// The camera of an image on the vehicle, by the calibration that holds; one without any is at the frame of its name.
    pub(crate) fn vehicle_from_image(
        &self,
        vehicle: &str,
        camera: &str,
        stamp: Stamp,
    ) -> Result<Pose, Reason> {
        match self.calibration(camera, stamp) {
            Ok(calibration) => self.vehicle_from_camera(vehicle, calibration),
            Err(_) => self.vehicle_from_frame(vehicle, camera),
        }
    }
}

/// The camera of a calibration, as its images look, in the frame that it is mounted on.
pub(crate) fn frame_from_camera(calibration: &Calibration) -> Result<Pose, Reason> {
    let Some(mount) = &calibration.mount else {
        return Ok(Pose::identity());
    };
    let found = Pose::from_array(mount.frame_from_camera.to_array());
    found.map_err(|error| {
        let (name, error) = (shown(&calibration.camera), error.to_string());
        format!("mount of camera `{name}`: {error}").into()
    })
}

/// A text from a log, such that it can be printed: what moves a cursor is escaped, quotes stay.
pub(crate) fn shown(text: &str) -> String {
    const MOST_SHOWN: usize = 120;
    let mut shown = String::new();
    for c in text.chars().take(MOST_SHOWN) {
        match "\"'".contains(c) {
            true => shown.push(c),
            false => shown.extend(c.escape_debug()),
        }
    }
    shown
}

/// Why an image of a camera is left out of which a session has no calibration.
pub(crate) fn uncalibrated(camera: &str) -> Reason {
    format!("no calibration of camera `{}`", shown(camera)).into()
}

/// Why what is mounted at a frame is left out whose fixed transforms do not lead to the vehicle, but end at another.
fn apart(frame: &str, vehicle: &str, ends: &str) -> Reason {
    let [from, to, last] = [frame, vehicle, ends].map(shown);
    match frame == ends {
        true => format!("no fixed transforms from frame `{from}` to `{to}`"),
        false => format!("fixed transforms from frame `{from}` lead to `{last}`, not to `{to}`"),
    }
    .into()
}

/// Why what is mounted at a frame is left out whose fixed transforms lead in a circle.
fn in_circle(frame: &str, ends: &str) -> Reason {
    let [frame, ends] = [frame, ends].map(shown);
    format!("fixed transforms from frame `{frame}` lead in a circle, through `{ends}`").into()
}

/// How far from its vehicle's frame anything is mounted, m: the longest ship had 458. Farther away are numbers in
/// millimetres, and places on earth.
const LONGEST_VEHICLE_M: f64 = 500.0;

/// A place on the vehicle, if it can be one.
fn near(place: Pose, frame: &str, vehicle: &str) -> Result<Pose, Reason> {
    let metres = place.translation.norm();
    if metres <= LONGEST_VEHICLE_M {
        return Ok(place);
    }
    let [frame, vehicle] = [frame, vehicle].map(shown);
    Err(format!(
        "expected frame `{frame}` at most {LONGEST_VEHICLE_M} m from `{vehicle}`, found {metres:.0} m"
    )
    .into())
}

/// Images are at most so many times as large as their calibration.
const LARGEST: f64 = 4.0;
/// The share by which sides that were rounded may differ from those of the calibration made larger or smaller.
const ROUNDED: f64 = 0.01;

/// The camera of a calibration, for images of this size: a driver that halves its images often leaves the
/// calibration as it was, and a camera is calibrated at half its size to have it done sooner.
///
/// # Errors
/// In words: for images of another shape, of a size that no resize of the calibrated ones has, and for numbers that no lens has.
pub(crate) fn camera(
    calibration: &Calibration,
    [width, height]: [u32; 2],
) -> Result<Camera, Reason> {
    let Calibration {
        camera,
        model,
        intrinsics,
        distortion,
        ..
    } = calibration;
    let mut k = intrinsics.clone();
    let (full_width, full_height) = (calibration.width, calibration.height);
    let given = full_width > 0 && full_height > 0;
    if given && (full_width, full_height) != (width, height) {
        let x = f64::from(width) / f64::from(full_width);
        let y = f64::from(height) / f64::from(full_height);
        let name = shown(camera);
        if model.starts_with("ocam") || (x / y - 1.0).abs() > ROUNDED {
            let reason = format!("image of camera `{name}` has another shape than its calibration");
            return Err(reason.into());
        }
        if !is_resized(x) {
            return Err(format!(
                "image of camera `{name}` is larger than its calibration, but not 1.5, 2, 2.5 … or {LARGEST} times"
            )
            .into());
        }
        scale(&mut k, x, y);
    }
    // An error names the model, which may be any text; no known one is so long that it is cut.
    let made = Camera::from_calibration(&shown(model), width, height, &k, distortion);
    made.map_err(|error| format!("calibration of camera `{}`: {error}", shown(camera)).into())
}

/// Whether images that are so many times as large as calibrated ones may be the same, resized: smaller by any factor, larger by
/// halves. Others are of another camera or mode, of which nobody knows what part of the sensor it reads.
fn is_resized(times: f64) -> bool {
    let halves = 2.0 * times;
    let is_by_halves = (halves - halves.round()).abs() <= ROUNDED * halves;
    times <= 1.0 || (is_by_halves && times <= LARGEST * (1.0 + ROUNDED))
}

/// Intrinsics of an image scaled by `x` and `y`; the corners of the image stay corners.
fn scale(k: &mut [f64], x: f64, y: f64) {
    for ([focal, centre], factor) in calibration::axes(k).into_iter().zip([x, y]) {
        if let Some(focal) = k.get_mut(focal) {
            *focal *= factor;
        }
        if let Some(centre) = k.get_mut(centre) {
            *centre = (*centre + 0.5) * factor - 0.5;
        }
    }
}

#[cfg(test)]
mod tests;
