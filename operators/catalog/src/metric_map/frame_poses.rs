#![doc = include_str!("frame_poses.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, Sides, group_whole};
use evermap_schemas::layers::{FramePose, MapFrame, VehiclePose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::frames::Frames;

/// See the module's page.
pub struct FramePoses;

/// There is nothing to choose.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FramePosesParams {}

impl Operator for FramePoses {
    const NAME: &'static str = "frame_poses";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("frame_poses.md");
    type Params = FramePosesParams;
    type Output = FramePose;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<VehiclePose>("poses", Grain::SESSION),
            Port::of::<MapFrame>("frames", Grain::Whole),
        ]
    }

    fn kernel(_: FramePosesParams) -> Result<Kernel, Fault> {
        Ok(group_whole(
            |poses: Vec<VehiclePose>, sides: &Sides, emit: &mut Emit<'_>| {
                let mut sites: BTreeMap<String, Frames> = BTreeMap::new();
                for frame in sides.rows::<MapFrame>("frames")? {
                    sites.entry(frame.site.clone()).or_default().push(frame);
                }
                hang(poses, &sites, emit)
            },
        ))
    }
}

fn hang(
    poses: Vec<VehiclePose>,
    sites: &BTreeMap<String, Frames>,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let mut hung = Vec::with_capacity(poses.len());
    for row in poses {
        let Ok(map_from_vehicle) = Pose::from_array(row.map_from_vehicle.to_array()) else {
            emit.skip("pose is no rigid transform", 1);
            continue;
        };
        let position = map_from_vehicle.translation.into();
        let nearest = sites
            .get(&row.site)
            .and_then(|frames| frames.nearest(position))
            .and_then(|(frame, _)| {
                let map_from_frame = Pose::from_array(frame.map_from_frame.to_array()).ok()?;
                Some((frame.frame, map_from_frame))
            });
        let Some((frame, map_from_frame)) = nearest else {
            emit.skip("site has no map frame", 1);
            continue;
        };
        let frame_from_vehicle = map_from_frame.inverse().compose(&map_from_vehicle);
        hung.push(FramePose {
            site: row.site,
            session: row.session,
            stamp: row.stamp,
            frame,
            frame_from_vehicle: evermap_schemas::Pose::from_array(frame_from_vehicle.to_array()),
            map_from_vehicle: row.map_from_vehicle,
        });
    }
    emit.rows(hung)
}
