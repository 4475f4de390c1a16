#![doc = include_str!("map_frames.md")]

use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{MapFrame, VehiclePose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::frames::Frames;

/// See the module's page.
pub struct MapFrames;

/// Where frames are made.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct MapFramesParams {
    /// A pose farther than this from every frame (m) becomes a frame. About the range of the landmarks that a car park's
    /// keyframe sees best.
    #[schemars(extend("exclusiveMinimum" = 0))]
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

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<VehiclePose>("poses");
        let sides = vec![Port::site::<MapFrame>("previous").optional()];
        Work::group(poses, Key::SITE, sides, frames)
    }
}

/// The frames of the version before, then those of the base session if there were none, then those in the gaps.
fn frames(
    params: &MapFramesParams,
    mut poses: Vec<VehiclePose>,
    sides: &Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    poses.retain(|pose| Pose::from_array(pose.map_from_vehicle.to_array()).is_ok());
    poses.sort_by(|a, b| (a.stamp, &a.session).cmp(&(b.stamp, &b.session)));
    let previous = sides.rows::<MapFrame>("previous")?;
    let base = match poses.first() {
        Some(first) if previous.is_empty() => Some(first.session.clone()),
        _ => None,
    };
    let (of_base, others): (Vec<VehiclePose>, Vec<VehiclePose>) = poses
        .into_iter()
        .partition(|pose| base.as_ref() == Some(&pose.session));
    let mut frames: Frames = previous.into_iter().collect();
    of_base.into_iter().for_each(|pose| frames.push_pose(pose));
    for pose in others {
        let at = &pose.map_from_vehicle;
        let nearest = frames.nearest([at.x, at.y, at.z]);
        if nearest.is_none_or(|(_, away_m)| away_m > params.gap_m) {
            frames.push_pose(pose);
        }
    }
    emit.rows(frames.into_rows())
}
