#![doc = include_str!("antenna_positions.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::layers::{AntennaPosition, Keyframe};
use evermap_schemas::roles::GnssFix;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::rig::{self, VehicleFrame, frame};

/// See the module's page.
pub struct AntennaPositions;

/// Where antennas are.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct AntennaPositionsParams {
    /// The vehicle.
    #[serde(flatten)]
    pub vehicle: VehicleFrame,
    /// Antennas that no transform places, by frame: `[x, y, z]` on the vehicle (m). The frame `*` stands for all that are not
    /// named.
    pub antennas: BTreeMap<String, [f64; 3]>,
    /// Between keyframes farther apart than this (m) nobody knows well enough where the vehicle was.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub gap_m: f64,
}

impl Default for AntennaPositionsParams {
    fn default() -> Self {
        Self {
            vehicle: VehicleFrame::default(),
            antennas: BTreeMap::new(),
            gap_m: 5.0,
        }
    }
}

impl Operator for AntennaPositions {
    const NAME: &'static str = "antenna_positions";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("antenna_positions.md");
    type Params = AntennaPositionsParams;
    type Output = AntennaPosition;

    fn work() -> Work<Self::Params> {
        let keyframes = Port::session::<Keyframe>("keyframes");
        let [_, transforms] = rig::ports(Reach::Session);
        let sides = vec![
            Port::session::<GnssFix>("gnss_fixes").optional(),
            transforms.optional(),
        ];
        Work::group(keyframes, Key::SESSION, sides, hang)
    }
}

fn hang(
    params: &AntennaPositionsParams,
    keyframes: Vec<Keyframe>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let fixes: Vec<GnssFix> = sides.rows("gnss_fixes")?;
    let mounts = rig::rigs(Vec::new(), sides.rows("transforms")?);
    let mounts = mounts.into_values().next().unwrap_or_default();
    let vehicle = params.vehicle.name();
    let antenna = |name: &str| -> Option<Vector3<f64>> {
        let placed = mounts.vehicle_from_frame(vehicle, name);
        let given = || params.antennas.get(name).or(params.antennas.get("*"));
        placed
            .ok()
            .map(|pose| pose.translation)
            .or_else(|| given().map(|place| Vector3::from(*place)))
    };
    let (all, mut outside) = (fixes.len(), 0);
    let mut hung = Vec::with_capacity(all);
    for fix in fixes {
        let place = antenna(frame(&fix.frame));
        if place.is_none() {
            let name = rig::shown(frame(&fix.frame));
            let reason =
                format!("antenna `{name}` without a transform, taken for the vehicle's origin");
            emit.skip(reason, 1);
        }
        match hook(&keyframes, &fix, params.gap_m) {
            Ok(Some((keyframe, motion))) => {
                hung.push(row(keyframe, &motion, place.unwrap_or_default(), fix));
            }
            Ok(None) => outside += 1,
            Err(reason) => emit.skip(reason, 1),
        }
    }
    // Some are before the drive and after it as a rule; and a vehicle that has one keyframe stood.
    if outside == all && keyframes.len() > 1 {
        let reason = "fix of a session none of whose fixes are of the time of its drive";
        emit.skip(reason, all as u64);
    }
    emit.rows(hung)
}

/// The keyframe that a fix hangs on, and where the vehicle was from there; `None` outside of the drive.
fn hook<'a>(
    keyframes: &'a [Keyframe],
    fix: &GnssFix,
    gap_m: f64,
) -> Result<Option<(&'a Keyframe, Pose)>, Reason> {
    let after = keyframes.partition_point(|keyframe| keyframe.stamp <= fix.stamp);
    let Some(before) = after.checked_sub(1).and_then(|at| keyframes.get(at)) else {
        return Ok(None);
    };
    if before.stamp == fix.stamp {
        return Ok(Some((before, Pose::identity())));
    }
    let Some(next) = keyframes.get(after) else {
        return Ok(None);
    };
    if before.stretch != next.stretch || next.distance_m - before.distance_m > gap_m {
        return Err("fix where odometry has a gap".into());
    }
    let poses = [before, next].map(|at| Pose::from_array(at.odom_from_vehicle.to_array()).ok());
    let [Some(from), Some(to)] = poses else {
        return Err("fix beside a keyframe whose pose is not a rigid transform".into());
    };
    let between = Pose::at_stamp(fix.stamp.0, (before.stamp.0, &from), (next.stamp.0, &to));
    Ok(Some((before, from.inverse().compose(&between))))
}

fn row(keyframe: &Keyframe, motion: &Pose, antenna: Vector3<f64>, fix: GnssFix) -> AntennaPosition {
    let place = motion.transform(&antenna);
    AntennaPosition {
        site: fix.site,
        session: fix.session,
        stamp: fix.stamp,
        keyframe_stamp: keyframe.stamp,
        x: place.x,
        y: place.y,
        z: place.z,
        latitude_deg: fix.latitude_deg,
        longitude_deg: fix.longitude_deg,
        height_m: fix.height_m,
        horizontal_sd_m: fix.horizontal_sd_m,
        vertical_sd_m: fix.vertical_sd_m,
    }
}
