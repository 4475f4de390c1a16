//! Where cameras were when they took images.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::{MAX_GAP_NS, StampedPose, pose_at};
use evermap_algorithms::metric_map::drive::borne_ns;
use evermap_contract::{Fault, Port, Reach, Reason, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::layers::VehiclePose;
use evermap_schemas::roles::OdometryPose;

use crate::inputs::lenses;
use crate::inputs::outside;
use crate::inputs::rig::{self, Rig, VehicleFrame, frame};

/// Drives with the cameras that were mounted on their vehicles.
pub(crate) struct CameraPoses {
    /// By session, in order of time.
    drives: BTreeMap<String, Vec<StampedPose>>,
    /// Whose poses they are, in words.
    whose: &'static str,
    rigs: BTreeMap<String, Rig>,
}

/// The ports that they are read from: the poses of a map, where they are given, or else odometry, whose frame begins anew
/// with each session; calibrations are those of [`lenses::port`].
pub(crate) fn ports(reach: Reach) -> [Port; 4] {
    let [_, transforms] = rig::ports(reach);
    let poses = Port::of::<VehiclePose>("poses", reach);
    let odometry = Port::of::<OdometryPose>("odometry", reach);
    [lenses::port(reach), poses, odometry, transforms].map(Port::optional)
}

impl CameraPoses {
    /// From [`ports`]; poses that are no rigid transforms are left out.
    pub(crate) fn new(sides: &Sides) -> Result<Self, Fault> {
        let of_map = sides.rows::<VehiclePose>("poses")?.into_iter();
        let mut poses: Vec<_> = of_map
            .map(|row| (row.session, row.stamp, row.map_from_vehicle))
            .collect();
        let mut whose = "the map's trajectory";
        if poses.is_empty() {
            let odometry = sides.rows::<OdometryPose>("odometry")?.into_iter();
            poses.extend(odometry.map(|row| (row.session, row.stamp, row.odom_from_vehicle)));
            whose = "odometry";
        }
        let mut drives: BTreeMap<String, Vec<StampedPose>> = BTreeMap::new();
        for (session, Stamp(stamp_ns), pose) in poses {
            let drive = drives.entry(session).or_default();
            if let Ok(pose) = Pose::from_array(pose.to_array()) {
                drive.push(StampedPose { stamp_ns, pose });
            }
        }
        let by_time = |drive: &mut Vec<StampedPose>| drive.sort_by_key(|pose| pose.stamp_ns);
        drives.values_mut().for_each(by_time);
        let mut rigs = rig::rigs(sides.rows("calibration")?, sides.rows("transforms")?);
        rigs.retain(|_, rig| rig.is_mounted());
        Ok(Self {
            drives,
            whose,
            rigs,
        })
    }

    /// The camera in the frame of the poses; `None` where its session has no poses or no fixed transforms, and for the
    /// moments before the first pose and after the last one that are borne.
    ///
    /// # Errors
    /// Why it is not known, where the session has both: the camera is not mounted on the vehicle, or no pose is near.
    pub(crate) fn at(
        &self,
        (session, camera, stamp): (&str, &str, Stamp),
        vehicle: &VehicleFrame,
    ) -> Result<Option<Pose>, Reason> {
        let (Some(drive), Some(rig)) = (self.drives.get(session), self.rigs.get(session)) else {
            return Ok(None);
        };
        let vehicle_from_camera = rig.vehicle_from_image(vehicle.name(), frame(camera), stamp)?;
        let map_from_vehicle = self.vehicle_at(drive, stamp.0)?;
        Ok(map_from_vehicle.map(|pose| pose.compose(&vehicle_from_camera)))
    }

    fn vehicle_at(&self, drive: &[StampedPose], stamp_ns: i64) -> Result<Option<Pose>, Reason> {
        let whose = self.whose;
        let (Some(first), Some(last)) = (drive.first(), drive.last()) else {
            return Err(format!("{whose} has no pose that is a rigid transform").into());
        };
        if let Some(pose) = pose_at(drive, stamp_ns, MAX_GAP_NS) {
            return Ok(Some(pose));
        }
        let span_ns = last.stamp_ns.saturating_sub(first.stamp_ns);
        let borne_ns = borne_ns(span_ns, MAX_GAP_NS);
        let before_ns = first.stamp_ns.saturating_sub(stamp_ns);
        let after_ns = stamp_ns.saturating_sub(last.stamp_ns);
        match before_ns.max(after_ns) {
            ..=0 => Err(format!("frame where {whose} has a gap").into()),
            outside_ns if outside_ns <= borne_ns => Ok(None),
            _ if before_ns > 0 => Err(outside::early(before_ns, whose)),
            _ => Err(outside::late(after_ns, whose)),
        }
    }
}
