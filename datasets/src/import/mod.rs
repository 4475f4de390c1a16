//! Converters: images, calibrations and trajectories in files of their own become a ROS 2 MCAP log.
//!
//! An import is described by a small YAML file:
//!
//! ```yaml
//! cameras:
//!   - name: front                        # becomes the optical frame, and the topic /front/image/compressed
//!     images: [imgs/Front.png]           # PNG or JPEG files or globs, relative to this file, in natural order
//!     calibration: intrinsic/Front.json  # SensorsCalibration JSON; or `model`, `intrinsics`, `distortion` in place
//!     camera_from_reference:
//!       file: extrinsic/Front.json       # SensorsCalibration JSON; or `matrix` or `pose` in place
//!       scale: 1.028                     # of the translation; 1 if not given
//!     labels: [labels/Front.png]         # class labels of the images, PNG: see below
//!     classes: [road, car]               # their names by pixel value, or a file with one a line
//! vehicle_from_reference:                # identity if not given
//!   matrix: [[0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 6.25], [0, 0, 0, 1]]
//! poses: { file: poses.txt, format: tum } # odom_from_vehicle; the vehicle stands still if not given
//! times: times.txt                       # one stamp per image, s, each of its own; else `rate_hz`
//! rate_hz: 10
//! ```
//!
//! Label images belong to the images whose file stems they have; where stems differ, to the images in order, and then
//! there is one for each. A value whose name is empty, or beyond the list, has no class.
//!
//! Stamps and poses without stamps belong to the images in order, and need not rise: where cameras differ in how many
//! images they have, poses to those of the camera with most. In both files, empty lines and those that begin with `#`
//! are skipped.
//!
//! Written are, per camera, `/NAME/image/compressed`, `/NAME/camera_info` and `/NAME/labels`, for the vehicle
//! `/tf_static` and `/odom`, and the metadata record `label_classes`. What a camera lacks (calibration, place, labels)
//! is left out. All images of a camera have one size. Frames are those of REP-103: the vehicle's x forward, y left, z
//! up; the camera's x right, y down, z forward.

mod calibration;
mod kitti;
mod labels;
mod log;
mod placement;
mod poses;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use evermap_schemas::Fault;
use nalgebra::Isometry3;
use serde::Deserialize;

pub use kitti::Kitti;
pub use labels::ClassNames;
pub use placement::Placement;
pub use poses::PoseFormat;

use crate::stores::read_text;
use crate::yaml::from_yaml;
use calibration::Intrinsics;

/// What an import wrote.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Imported {
    /// Images.
    pub images: usize,
    /// Poses.
    pub poses: usize,
    /// Label images.
    pub labels: usize,
}

/// The description of an import.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageImport {
    /// Cameras.
    pub cameras: Vec<CameraImport>,
    /// The vehicle's frame and that of the extrinsic calibration; identity if not given.
    #[serde(default)]
    pub vehicle_from_reference: Option<Placement>,
    /// Trajectory of the vehicle in the odometry frame.
    #[serde(default)]
    pub poses: Option<PoseFile>,
    /// File with one stamp per line, s, for the images of every camera in order; no two are equal.
    #[serde(default)]
    pub times: Option<PathBuf>,
    /// Images per second where there are no stamps.
    #[serde(default = "default_rate_hz")]
    pub rate_hz: f64,
    /// Stamp of the first image where there are no stamps, s.
    #[serde(default)]
    pub start_s: f64,
    #[serde(skip)]
    folder: PathBuf,
}

fn default_rate_hz() -> f64 {
    10.0
}

/// One camera of an import.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraImport {
    /// Name; also that of the optical frame. No two cameras have the same.
    pub name: String,
    /// PNG or JPEG files, or globs; all of one size.
    pub images: Vec<String>,
    /// Intrinsic calibration in a SensorsCalibration JSON file (`cam_K`, `cam_dist`).
    #[serde(default)]
    pub calibration: Option<PathBuf>,
    /// Camera model, where it is not `plumb_bob` or, for a calibration file with 11 distortion coefficients, `ocam`.
    #[serde(default)]
    pub model: Option<String>,
    /// Camera matrix, row-major.
    #[serde(default)]
    pub intrinsics: Option<Vec<f64>>,
    /// Distortion coefficients.
    #[serde(default)]
    pub distortion: Vec<f64>,
    /// From the frame of the extrinsic calibration into the camera's. Give this, or `vehicle_from_camera`, or neither.
    #[serde(default)]
    pub camera_from_reference: Option<Placement>,
    /// From the camera's frame into the vehicle's.
    #[serde(default)]
    pub vehicle_from_camera: Option<Placement>,
    /// PNG files, or globs, with the classes of the images' pixels.
    #[serde(default)]
    pub labels: Vec<String>,
    /// Names of the classes by pixel value; the same for all cameras that give them.
    #[serde(default)]
    pub classes: Option<ClassNames>,
}

/// A file of poses.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseFile {
    /// The file.
    pub file: PathBuf,
    /// Its format.
    pub format: PoseFormat,
}

impl ImageImport {
    /// Reads a description; its paths become relative to its folder.
    ///
    /// # Errors
    /// A user fault when the file cannot be read or is no such description.
    pub fn load(path: &Path) -> Result<Self, Fault> {
        let mut import: Self = from_yaml(&read(path)?, "the description of an import")
            .map_err(|fault| fault.at(path.display()))?;
        import.folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Ok(import)
    }

    /// The same description, with its paths relative to another folder.
    #[must_use]
    pub fn within(mut self, folder: &Path) -> Self {
        folder.clone_into(&mut self.folder);
        self
    }

    /// Writes the log, as long as `is_stopped` does not say that nobody wants it any more.
    ///
    /// # Errors
    /// A user fault when something is missing or contradicts itself, a resource fault when `out` cannot be written.
    pub fn write(&self, out: &Path, is_stopped: &dyn Fn() -> bool) -> Result<Imported, Fault> {
        self.check_names()?;
        let vehicle_from_reference = match &self.vehicle_from_reference {
            Some(placement) => placement
                .read(&self.folder)
                .map_err(|fault| fault.at("vehicle_from_reference"))?,
            None => Isometry3::identity(),
        };
        let mut cameras = Vec::new();
        for camera in &self.cameras {
            let loaded = self.camera(camera, &vehicle_from_reference);
            cameras.push(loaded.map_err(|fault| fault.at(format!("camera {}", camera.name)))?);
        }
        let poses = self.odom_from_vehicle(&image_stamps(&cameras))?;
        log::write(out, &cameras, &poses, &self.classes()?, is_stopped)
    }

    /// That each camera has a name of its own, as its topics and its frame have that name.
    fn check_names(&self) -> Result<(), Fault> {
        let mut seen = BTreeSet::new();
        let mut cameras = self.cameras.iter();
        match cameras.find(|camera| !seen.insert(&camera.name)) {
            None => Ok(()),
            Some(camera) => Err(Fault::user(format!(
                "expected a name of its own for each camera, found two called {}",
                camera.name
            ))),
        }
    }

    /// Poses with their stamps, ns: those of the file, or a vehicle that stands still at the images.
    fn odom_from_vehicle(&self, stamps: &[u64]) -> Result<Vec<(u64, Isometry3<f64>)>, Fault> {
        let Some(file) = &self.poses else {
            let still = |stamp: &u64| (*stamp, Isometry3::identity());
            return Ok(stamps.iter().map(still).collect());
        };
        let path = self.folder.join(&file.file);
        let poses = poses::read_file(&path, file.format)?;
        poses::stamped(poses, stamps).map_err(|fault| fault.at(path.display()))
    }

    /// The classes that the cameras give.
    fn classes(&self) -> Result<Vec<String>, Fault> {
        let mut given = self
            .cameras
            .iter()
            .filter_map(|camera| camera.classes.as_ref());
        let Some(first) = given.next() else {
            return Ok(Vec::new());
        };
        let classes = first.read(&self.folder)?;
        for other in given {
            if other.read(&self.folder)? != classes {
                return Err(Fault::user(
                    "expected the same classes for all cameras, because a log has one list; found different ones",
                ));
            }
        }
        Ok(classes)
    }

    fn camera(
        &self,
        camera: &CameraImport,
        vehicle_from_reference: &Isometry3<f64>,
    ) -> Result<log::Camera, Fault> {
        let files = self.files(&camera.images)?;
        let stamps = self.stamps(files.len())?;
        let (width, height) = log::common_size(&files)?;
        let intrinsics = match (&camera.calibration, &camera.intrinsics) {
            (Some(file), None) => Some(Intrinsics::read(
                &self.folder.join(file),
                camera.model.as_deref(),
            )?),
            (None, Some(k)) => Some(Intrinsics::given(
                camera.model.as_deref(),
                k,
                &camera.distortion,
            )?),
            (None, None) => None,
            _ => {
                return Err(Fault::user(
                    "expected calibration or intrinsics, found both",
                ));
            }
        };
        let vehicle_from_camera = match (&camera.vehicle_from_camera, &camera.camera_from_reference)
        {
            (Some(placement), None) => Some(placement.read(&self.folder)?),
            (None, Some(placement)) => {
                Some(vehicle_from_reference * placement.read(&self.folder)?.inverse())
            }
            (None, None) => None,
            _ => {
                return Err(Fault::user(
                    "expected vehicle_from_camera or camera_from_reference, found both",
                ));
            }
        };
        let labels = match camera.labels.as_slice() {
            [] => Vec::new(),
            globs => labels::of_images(&files, &stamps, self.files(globs)?, (width, height))?,
        };
        Ok(log::Camera {
            name: camera.name.clone(),
            width,
            height,
            intrinsics,
            vehicle_from_camera,
            images: stamps.into_iter().zip(files).collect(),
            labels,
        })
    }

    /// The files of these names or patterns. What the folder is called is no pattern.
    fn files(&self, names: &[String]) -> Result<Vec<PathBuf>, Fault> {
        let folder = PathBuf::from(glob::Pattern::escape(&self.folder.to_string_lossy()));
        let mut files = Vec::new();
        for name in names {
            let found = glob::glob(&folder.join(name).to_string_lossy())
                .map_err(|error| Fault::user(format!("the pattern {name}: {}", error.msg)))?;
            let mut found: Vec<PathBuf> = found.filter_map(Result::ok).collect();
            if found.is_empty() {
                return Err(Fault::user(format!(
                    "expected images, found none at {}",
                    self.folder.join(name).display()
                )));
            }
            found.sort_by_key(|path| crate::stores::natural_key(&path.to_string_lossy()));
            files.extend(found);
        }
        Ok(files)
    }

    fn stamps(&self, count: usize) -> Result<Vec<u64>, Fault> {
        let Some(times) = &self.times else {
            if !(self.rate_hz > 0.0 && self.rate_hz.is_finite()) {
                return Err(Fault::user(format!(
                    "expected a rate above 0, found {}",
                    self.rate_hz
                )));
            }
            let stamp = |i: usize| poses::nanoseconds(self.start_s + i as f64 / self.rate_hz);
            return (0..count).map(stamp).collect();
        };
        let stamps = poses::times(&self.folder.join(times))?;
        if stamps.len() != count {
            return Err(Fault::user(format!(
                "expected a stamp for each of {count} images, found {}",
                stamps.len()
            ))
            .at(times.display()));
        }
        Ok(stamps)
    }
}

/// Stamps of the images, ns, in the order of the images, which is not always that of time: those of the camera that has
/// most images. Cameras with fewer images share the first of them.
fn image_stamps(cameras: &[log::Camera]) -> Vec<u64> {
    let most = cameras.iter().max_by_key(|camera| camera.images.len());
    let images = most.into_iter().flat_map(|camera| &camera.images);
    images.map(|(stamp, _)| *stamp).collect()
}

/// The text of a file.
fn read(path: &Path) -> Result<String, Fault> {
    read_text(path)
        .map_err(|error| Fault::user(format!("expected a file, found {error}")).at(path.display()))
}
