#![doc = include_str!("frame_poses.md")]

use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Fault, Operator, Port, Reason, Sides, Work};
use evermap_schemas::layers::{FramePose, MapFrame, VehiclePose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::frames::Frames;

/// See the module's page.
pub struct FramePoses;

/// There is nothing to choose.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
pub struct FramePosesParams {}

impl Operator for FramePoses {
    const NAME: &'static str = "frame_poses";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("frame_poses.md");
    type Params = FramePosesParams;
    type Output = FramePose;

    fn work() -> Work<Self::Params> {
        let poses = Port::session::<VehiclePose>("poses");
        let sides = vec![Port::site::<MapFrame>("frames")];
        Work::each_row(poses, sides, frames, hang)
    }
}

fn frames(_: &FramePosesParams, sides: &Sides) -> Result<Frames, Fault> {
    Ok(sides.rows("frames")?.into_iter().collect())
}

fn hang(frames: &Frames, row: VehiclePose) -> Result<Option<FramePose>, Reason> {
    let map_from_vehicle = Pose::from_array(row.map_from_vehicle.to_array())
        .map_err(|_| "pose is no rigid transform")?;
    let position = map_from_vehicle.translation.into();
    let (frame, map_from_frame) = frames
        .nearest(position)
        .and_then(|(frame, _)| {
            let map_from_frame = Pose::from_array(frame.map_from_frame.to_array()).ok()?;
            Some((frame.frame, map_from_frame))
        })
        .ok_or("site has no map frame")?;
    let frame_from_vehicle = map_from_frame.inverse().compose(&map_from_vehicle);
    Ok(Some(FramePose {
        site: row.site,
        session: row.session,
        stamp: row.stamp,
        frame,
        frame_from_vehicle: evermap_schemas::Pose::from_array(frame_from_vehicle.to_array()),
        map_from_vehicle: row.map_from_vehicle,
    }))
}
