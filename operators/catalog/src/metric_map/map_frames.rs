#![doc = include_str!("map_frames.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::Stamp;
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
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("map_frames.md");
    type Params = MapFramesParams;
    type Output = MapFrame;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<VehiclePose>("poses");
        let sides = vec![Port::site::<MapFrame>("previous").optional()];
        Work::group(poses, Key::SITE, sides, frames)
    }
}

/// The frames of the version before where their keyframes are now, then those in the gaps.
fn frames(
    params: &MapFramesParams,
    mut poses: Vec<VehiclePose>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    poses.retain(|pose| Pose::from_array(pose.map_from_vehicle.to_array()).is_ok());
    poses.sort_by(|a, b| (a.stamp, &a.session).cmp(&(b.stamp, &b.session)));
    let previous = sides.rows::<MapFrame>("previous")?;
    let now: BTreeMap<(&str, Stamp), &evermap_schemas::Pose> = poses
        .iter()
        .map(|pose| ((pose.session.as_str(), pose.stamp), &pose.map_from_vehicle))
        .collect();
    let moved = previous.into_iter().map(|frame| {
        let now = now.get(&(frame.session.as_str(), frame.stamp)).copied();
        moved(frame, now)
    });
    let mut frames: Frames = moved.collect();
    for pose in poses {
        let at = &pose.map_from_vehicle;
        let nearest = frames.nearest([at.x, at.y, at.z]);
        if nearest.is_none_or(|(_, away_m)| away_m > params.gap_m) {
            frames.push_pose(pose);
        }
    }
    emit.rows(frames.into_rows())
}

/// The frame where its keyframe is now; where it was, if that is not known.
fn moved(frame: MapFrame, now: Option<&evermap_schemas::Pose>) -> MapFrame {
    let map_from_frame = now.unwrap_or(&frame.map_from_frame).clone();
    let poses = [&frame.map_from_frame, &map_from_frame];
    let [before, after] = poses.map(|pose| Pose::from_array(pose.to_array()).ok());
    let motion = before
        .zip(after)
        .map(|(before, after)| before.inverse().compose(&after));
    MapFrame {
        map_from_frame,
        moved_m: motion.map(|motion| motion.translation.norm()),
        moved_rad: motion.map(|motion| motion.rotation.angle()),
        ..frame
    }
}
