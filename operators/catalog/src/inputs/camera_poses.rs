//! Where cameras were when they took images.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::{MAX_GAP_NS, StampedPose, pose_at};
use evermap_contract::{Fault, Port, Reach, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::layers::VehiclePose;
use evermap_schemas::roles::OdometryPose;

use crate::inputs::rig::{self, Rig, VehicleFrame, frame};

/// Drives with the cameras that were mounted on their vehicles.
pub(crate) struct CameraPoses {
    /// By session, in order of time.
    drives: BTreeMap<String, Vec<StampedPose>>,
    rigs: BTreeMap<String, Rig>,
}

/// The ports that they are read from: those of a map, where they are given, or else odometry, whose frame begins anew with
/// each session.
pub(crate) fn ports(reach: Reach) -> [Port; 3] {
    let [_, transforms] = rig::ports(reach);
    let poses = Port::of::<VehiclePose>("poses", reach);
    let odometry = Port::of::<OdometryPose>("odometry", reach);
    [poses, odometry, transforms].map(Port::optional)
}

impl CameraPoses {
    /// From [`ports`]; poses that are no rigid transforms are left out.
    pub(crate) fn new(sides: &Sides) -> Result<Self, Fault> {
        let of_map = sides.rows::<VehiclePose>("poses")?.into_iter();
        let mut poses: Vec<_> = of_map
            .map(|row| (row.session, row.stamp, row.map_from_vehicle))
            .collect();
        if poses.is_empty() {
            let odometry = sides.rows::<OdometryPose>("odometry")?.into_iter();
            poses.extend(odometry.map(|row| (row.session, row.stamp, row.odom_from_vehicle)));
        }
        let mut drives: BTreeMap<String, Vec<StampedPose>> = BTreeMap::new();
        for (session, Stamp(stamp_ns), pose) in poses {
            if let Ok(pose) = Pose::from_array(pose.to_array()) {
                let drive = drives.entry(session).or_default();
                drive.push(StampedPose { stamp_ns, pose });
            }
        }
        let by_time = |drive: &mut Vec<StampedPose>| drive.sort_by_key(|pose| pose.stamp_ns);
        drives.values_mut().for_each(by_time);
        let rigs = rig::rigs(Vec::new(), sides.rows("transforms")?);
        Ok(Self { drives, rigs })
    }

    /// The camera in the frame of the poses; `None` where none are near, or nothing says where it is mounted.
    pub(crate) fn at(
        &self,
        (session, camera, stamp): (&str, &str, Stamp),
        vehicle: &VehicleFrame,
    ) -> Option<Pose> {
        let drive = self.drives.get(session)?;
        let rig = self.rigs.get(session)?;
        let vehicle_from_camera = rig
            .vehicle_from_camera(vehicle.name(), frame(camera))
            .ok()?;
        let map_from_vehicle = pose_at(drive, stamp.0, MAX_GAP_NS)?;
        Some(map_from_vehicle.compose(&vehicle_from_camera))
    }
}
