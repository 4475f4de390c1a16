//! Sequences of the KITTI odometry benchmark.

use std::path::{Path, PathBuf};

use evermap_schemas::Fault;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};

use crate::import::calibration::Intrinsics;
use crate::import::log::{self, Camera};
use crate::import::poses::{self, PoseFormat};
use crate::import::{Imported, read};

/// Height of the benchmark's cameras above the road, m.
const CAMERA_HEIGHT_M: f64 = 1.65;

/// A sequence: images of the left grey camera, times and poses, each in the benchmark's own format. Image `000123.png`
/// belongs to the 124th time and pose, so a sequence may lack images.
///
/// The vehicle's frame is on the road below the camera, x forward, z up; the odometry frame is where it starts.
#[derive(Debug, Clone, Default)]
pub struct Kitti {
    /// Poses of the camera in its first frame, twelve numbers per line; none leaves odometry out.
    pub poses: Option<PathBuf>,
    /// Stamps, s, one per line, no two equal; without, ten per second.
    pub times: Option<PathBuf>,
    /// Folder of images; none leaves frames out.
    pub images: Option<PathBuf>,
    /// `calib.txt` with a line `P0:`, or a file with the nine numbers of K. Needed with images.
    pub calibration: Option<PathBuf>,
}

impl Kitti {
    /// Writes the log, as long as `is_stopped` does not say that nobody wants it any more.
    ///
    /// # Errors
    /// A user fault when a file is missing or malformed, a resource fault when `out` cannot be written.
    pub fn write(&self, out: &Path, is_stopped: &dyn Fn() -> bool) -> Result<Imported, Fault> {
        let times = match &self.times {
            Some(path) => Some(poses::times(path)?),
            None => None,
        };
        let stamp = |index: usize| match &times {
            Some(times) => times.get(index).copied().ok_or_else(|| {
                Fault::user(format!(
                    "expected a time for frame {index}, found {}",
                    times.len()
                ))
            }),
            None => poses::nanoseconds(index as f64 / 10.0),
        };
        let vehicle_from_camera = vehicle_from_camera();
        let mut trajectory = Vec::new();
        if let Some(path) = &self.poses {
            let read = poses::read_file(path, PoseFormat::Kitti)?;
            for (index, (_, start_from_camera)) in read.into_iter().enumerate() {
                let odom_from_vehicle =
                    vehicle_from_camera * start_from_camera * vehicle_from_camera.inverse();
                trajectory.push((stamp(index)?, odom_from_vehicle));
            }
        }
        let mut cameras = Vec::new();
        if let Some(folder) = &self.images {
            let mut images = Vec::new();
            for (index, path) in numbered(folder)? {
                images.push((stamp(index)?, path));
            }
            cameras.push(self.camera(images)?);
        }
        log::write(out, &cameras, &trajectory, &[], is_stopped)
    }

    fn camera(&self, images: Vec<(u64, PathBuf)>) -> Result<Camera, Fault> {
        let (width, height) = log::common_size(images.iter().map(|(_, image)| image))?;
        let path = self.calibration.as_ref();
        let path = path.ok_or_else(|| Fault::user("expected a calibration for the images"))?;
        let k = camera_matrix(&read(path)?).map_err(|fault| fault.at(path.display()))?;
        Ok(Camera {
            name: "image_0".to_owned(),
            width,
            height,
            intrinsics: Some(Intrinsics::given(None, &k, &[0.0; 5])?),
            vehicle_from_camera: Some(vehicle_from_camera()),
            images,
            labels: Vec::new(),
        })
    }
}

/// The camera looks forward (its z axis is the vehicle's x axis) from above the vehicle's origin.
fn vehicle_from_camera() -> Isometry3<f64> {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Isometry3::from_parts(Translation3::new(0.0, 0.0, CAMERA_HEIGHT_M), rotation)
}

/// K, row by row: nine numbers, or the left part of the line `P0:`.
fn camera_matrix(text: &str) -> Result<Vec<f64>, Fault> {
    if let Some(line) = text.lines().find_map(|line| line.strip_prefix("P0:")) {
        let p = poses::numbers(line)?;
        if p.len() != 12 {
            return Err(Fault::user(format!(
                "expected 12 numbers after P0, found {}",
                p.len()
            )));
        }
        return Ok([&p[0..3], &p[4..7], &p[8..11]].concat());
    }
    let rows: Result<Vec<Vec<f64>>, Fault> = text.lines().map(poses::numbers).collect();
    Ok(rows?.concat())
}

/// Image files by the number that they are named after.
fn numbered(folder: &Path) -> Result<Vec<(usize, PathBuf)>, Fault> {
    let entries = std::fs::read_dir(folder)
        .map_err(|error| Fault::user(error.to_string()).at(folder.display()))?;
    let mut images = Vec::new();
    for entry in entries {
        let path = entry
            .map_err(|error| Fault::resource(error.to_string()).at(folder.display()))?
            .path();
        let stem = path.file_stem().and_then(|stem| stem.to_str());
        if let Some(number) = stem.and_then(|stem| stem.parse().ok()) {
            images.push((number, path));
        }
    }
    images.sort();
    Ok(images)
}
