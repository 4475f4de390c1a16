//! What follows from a camera's calibration and mounting, kept from image to image.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Fault, Reason, Sides};
use evermap_schemas::Stamp;

use crate::inputs::rig::{self, Rig, VehicleFrame, frame};

/// What it depends on: the calibration (session, camera, stamp) and the size of the image.
type Name = (String, String, Stamp, [u32; 2]);

/// One of these for each camera, calibration and size of images, or why there is none.
type ByCamera<T> = BTreeMap<Name, Result<Arc<T>, Reason>>;

/// One `T` for each camera, calibration and size of images, made when first asked for.
pub(crate) struct Calibrated<T> {
    /// By session.
    rigs: BTreeMap<String, Rig>,
    vehicle: VehicleFrame,
    most: usize,
    made: Mutex<ByCamera<T>>,
}

/// A camera as it stands on its vehicle.
pub(crate) struct MountedCamera {
    pub(crate) camera: Camera,
    pub(crate) vehicle_from_camera: Pose,
}

impl<T> Calibrated<T> {
    /// From the tables of [`rig::ports`]. At most `most` are kept: a camera whose calibration changes with every image must
    /// not fill the memory.
    pub(crate) fn new(sides: &Sides, vehicle: &VehicleFrame, most: usize) -> Result<Self, Fault> {
        Ok(Self {
            rigs: rig::sessions(sides)?,
            vehicle: vehicle.clone(),
            most,
            made: Mutex::default(),
        })
    }

    /// That of a session's camera, as calibrated at an instant, for images of this size.
    pub(crate) fn get(
        &self,
        (session, camera, stamp): (&str, &str, Stamp),
        size: [u32; 2],
        make: impl FnOnce(MountedCamera) -> Result<T, Reason>,
    ) -> Result<Arc<T>, Reason> {
        let camera = frame(camera);
        let rig = self.rigs.get(session);
        let rig = rig.ok_or_else(|| rig::uncalibrated(camera))?;
        let calibration = rig.calibration(camera, stamp)?;
        let name = (
            session.to_owned(),
            camera.to_owned(),
            calibration.stamp,
            size,
        );
        if let Some(known) = self.made().get(&name) {
            return known.clone();
        }
        // Not under the lock: a thread that waits for parts of what it makes may be given other rows to work on.
        let mounted = || {
            Ok(MountedCamera {
                vehicle_from_camera: rig.vehicle_from_camera(self.vehicle.name(), calibration)?,
                camera: rig::camera(calibration, size)?,
            })
        };
        let one = mounted().and_then(make).map(Arc::new);
        let mut made = self.made();
        if made.len() >= self.most {
            made.clear();
        }
        made.entry(name).or_insert(one).clone()
    }

    fn made(&self) -> MutexGuard<'_, ByCamera<T>> {
        self.made.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
