#![doc = include_str!("map_frames.md")]

use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, Sides, group_whole};
use evermap_schemas::layers::{MapFrame, VehiclePose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::frames::Frames;

/// See the module's page.
pub struct MapFrames;

/// Where frames are made.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MapFramesParams {
    /// A pose farther than this from every frame (m) becomes a frame.
    pub gap_m: f64,
}

impl Default for MapFramesParams {
    fn default() -> Self {
        Self { gap_m: 5.0 }
    }
}

impl Operator for MapFrames {
    const NAME: &'static str = "map_frames";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("map_frames.md");
    type Params = MapFramesParams;
    type Output = MapFrame;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<VehiclePose>("poses", Grain::Whole),
            Port::of::<MapFrame>("previous", Grain::Whole).optional(),
        ]
    }

    fn kernel(MapFramesParams { gap_m }: MapFramesParams) -> Result<Kernel, Fault> {
        if !(gap_m > 0.0 && gap_m.is_finite()) {
            return Err(Fault::user(format!(
                "expected gap_m above 0 m, found {gap_m}"
            )));
        }
        Ok(group_whole(
            move |poses: Vec<VehiclePose>, sides: &Sides, emit: &mut Emit<'_>| {
                let site = poses.first().map(|pose| pose.site.clone());
                let mut previous = sides.rows::<MapFrame>("previous")?;
                previous.retain(|frame| Some(&frame.site) == site.as_ref());
                emit.rows(frames(poses, previous, gap_m))
            },
        ))
    }
}

/// The frames of the version before, then those of the base session if there were none, then those in the gaps.
fn frames(mut poses: Vec<VehiclePose>, previous: Vec<MapFrame>, gap_m: f64) -> Vec<MapFrame> {
    poses.retain(|pose| Pose::from_array(pose.map_from_vehicle.to_array()).is_ok());
    poses.sort_by(|a, b| (a.stamp, &a.session).cmp(&(b.stamp, &b.session)));
    let base = match poses.first() {
        Some(first) if previous.is_empty() => Some(first.session.clone()),
        _ => None,
    };
    let (of_base, others): (Vec<VehiclePose>, Vec<VehiclePose>) = poses
        .into_iter()
        .partition(|pose| base.as_ref() == Some(&pose.session));
    let mut frames = Frames::default();
    previous.into_iter().for_each(|frame| frames.push(frame));
    for pose in of_base {
        frames.push_pose(pose);
    }
    for pose in others {
        let position = [
            pose.map_from_vehicle.x,
            pose.map_from_vehicle.y,
            pose.map_from_vehicle.z,
        ];
        if frames
            .nearest(position)
            .is_none_or(|(_, away_m)| away_m > gap_m)
        {
            frames.push_pose(pose);
        }
    }
    frames.into_rows()
}
