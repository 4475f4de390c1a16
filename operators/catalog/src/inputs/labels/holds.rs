//! What of a map can hold labels: vehicle poses, with what their cameras see from there, and map frames.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::{Rig, RigCamera};
use evermap_algorithms::labels::anchors::{AnchorParams, Obstacles, Stations};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{MapFrame, VehiclePose};
use evermap_schemas::roles::{Anchor, Calibration, Transform};

use crate::inputs::frames::Frames;
use crate::inputs::rig::{OfVehicle, frame, rigs};

/// The rows of one site's map that can hold labels.
#[derive(Debug, Clone, Default)]
pub struct MapRows {
    /// Vehicle poses.
    pub poses: Vec<VehiclePose>,
    /// Map frames.
    pub frames: Vec<MapFrame>,
    /// Calibrations of the cameras; none where nothing is known of them.
    pub calibration: Vec<Calibration>,
    /// Where the cameras are mounted.
    pub transforms: Vec<Transform>,
    /// Points of landmarks in the map, m.
    pub landmarks: Vec<[f64; 3]>,
}

/// A label in a map frame.
pub(super) struct Framed {
    /// Number of the frame in the map that it was chosen on.
    pub(super) number: u32,
    /// Session and instant of the pose that the frame was made from.
    pub(super) of: (String, Stamp),
    /// The label's own frame in it.
    pub(super) frame_from_label: evermap_schemas::Pose,
}

/// What can hold labels.
pub struct Holds {
    params: AnchorParams,
    poses: Vec<Pose>,
    /// Session and instant of each pose.
    of: Vec<(String, Stamp)>,
    stations: Stations,
    rigs: BTreeMap<String, Rig>,
    obstacles: Obstacles,
    frames: Frames,
}

impl Holds {
    /// Of the rows of a map. Poses that are no rigid transform, and cameras that cannot be used, hold nothing.
    pub fn new(rows: MapRows, params: &OfVehicle<AnchorParams>) -> Self {
        let (mut poses, mut of) = (Vec::new(), Vec::new());
        for row in rows.poses {
            if let Ok(pose) = Pose::from_array(row.map_from_vehicle.to_array()) {
                poses.push(pose);
                of.push((row.session, row.stamp));
            }
        }
        let mounted = rigs(rows.calibration, rows.transforms).into_iter();
        let rigs = mounted.map(|(session, rig)| (session, rig.cameras(&params.vehicle)));
        Self {
            params: params.options,
            stations: Stations::new(&poses),
            poses,
            of,
            rigs: rigs.collect(),
            obstacles: Obstacles::new(rows.landmarks),
            frames: rows.frames.into_iter().collect(),
        }
    }

    /// Whether there are any poses.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Height of the ground, about, at a place of the map, m: that of the vehicle pose nearest to it from above; 0 where
    /// there is none.
    pub fn ground(&self, [x, y]: [f64; 2]) -> f64 {
        let away = |pose: &&Pose| (pose.translation.x - x).hypot(pose.translation.y - y);
        let nearest = self.poses.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
        nearest.map_or(0.0, |pose| pose.translation.z)
    }

    /// Whether it is known of any camera of a session how it sees, and where it is mounted.
    pub fn knows_cameras(&self, session: &str) -> bool {
        let rig = self.rigs.get(session);
        rig.is_some_and(|rig| !rig.cameras.is_empty())
    }

    /// Whether the vehicle has a pose of just this instant.
    pub fn has_pose(&self, session: &str, stamp: Stamp) -> bool {
        let mut of = self.of.iter();
        of.any(|(known, at)| known == session && *at == stamp)
    }

    /// A camera of a session; `None` where it is not known how it sees, or where it is mounted.
    pub fn camera(&self, session: &str, name: &str) -> Option<&RigCamera> {
        let rig = self.rigs.get(session)?;
        rig.cameras.get(rig.index(frame(name))?)
    }

    /// The vehicle pose to tie a label to; `None` where none is within reach.
    pub fn anchor(&self, map_from_label: &evermap_schemas::Pose) -> Option<Anchor> {
        let map_from_label = Pose::from_array(map_from_label.to_array()).ok()?;
        let rig = |pose: usize| self.rigs.get(&self.of[pose].0);
        let (poses, middle) = (&self.poses, &map_from_label.translation);
        let found = self
            .stations
            .sight(middle, poses, rig, &self.obstacles, &self.params)?;
        let (session, stamp) = self.of[found.pose].clone();
        let camera = found
            .camera
            .and_then(|camera| Some(rig(found.pose)?.cameras.get(camera)?.name.clone()));
        let vehicle_from_label = poses[found.pose].inverse().compose(&map_from_label);
        Some(Anchor {
            session,
            stamp,
            camera,
            vehicle_from_label: evermap_schemas::Pose::from_array(vehicle_from_label.to_array()),
        })
    }

    /// The map frame nearest to a label, and the label in it.
    pub(super) fn frame(&self, map_from_label: &evermap_schemas::Pose) -> Option<Framed> {
        let map_from_label = Pose::from_array(map_from_label.to_array()).ok()?;
        let (nearest, _) = self.frames.nearest(map_from_label.translation.into())?;
        let map_from_frame = Pose::from_array(nearest.map_from_frame.to_array()).ok()?;
        let frame_from_label = map_from_frame.inverse().compose(&map_from_label);
        Some(Framed {
            number: nearest.frame,
            of: (nearest.session.clone(), nearest.stamp),
            frame_from_label: evermap_schemas::Pose::from_array(frame_from_label.to_array()),
        })
    }
}
