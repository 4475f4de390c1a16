//! What of a map can hold labels: vehicle poses, with what their cameras see from there, and map frames.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::rig::{Rig, RigCamera};
use evermap_algorithms::labels::anchors::{AnchorParams, Obstacles, Stations};
use evermap_algorithms::labels::points::PointIndex;
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
    /// The instants of each session's poses.
    instants: BTreeMap<String, BTreeSet<Stamp>>,
    stations: Stations,
    /// The poses from above.
    stood: PointIndex,
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
        let mut instants: BTreeMap<String, BTreeSet<Stamp>> = BTreeMap::new();
        for (session, stamp) in of.iter().cloned() {
            instants.entry(session).or_default().insert(stamp);
        }
        let from_above = |pose: &Pose| [pose.translation.x, pose.translation.y];
        let mounted = rigs(rows.calibration, rows.transforms).into_iter();
        let rigs = mounted.map(|(session, rig)| (session, rig.cameras(&params.vehicle)));
        Self {
            params: params.options,
            stations: Stations::new(&poses),
            stood: PointIndex::new(poses.iter().map(from_above)),
            poses,
            of,
            instants,
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
    pub fn ground(&self, at: [f64; 2]) -> f64 {
        let nearest = self.stood.nearest(at);
        nearest.map_or(0.0, |pose| self.poses[pose].translation.z)
    }

    /// Whether it is known of any camera of a session how it sees, and where it is mounted.
    pub fn knows_cameras(&self, session: &str) -> bool {
        let rig = self.rigs.get(session);
        rig.is_some_and(|rig| !rig.cameras.is_empty())
    }

    /// Whether the vehicle has a pose of just this instant.
    pub fn has_pose(&self, session: &str, stamp: Stamp) -> bool {
        let instants = self.instants.get(session);
        instants.is_some_and(|instants| instants.contains(&stamp))
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::VehicleFrame;

    fn pose(session: &str, stamp: i64, [x, y, z]: [f64; 3]) -> VehiclePose {
        VehiclePose {
            site: "lot".into(),
            session: session.into(),
            stamp: Stamp(stamp),
            map_from_vehicle: evermap_schemas::Pose {
                x,
                y,
                z,
                ..evermap_schemas::Pose::IDENTITY
            },
        }
    }

    fn holds(poses: Vec<VehiclePose>) -> Holds {
        let rows = MapRows {
            poses,
            ..MapRows::default()
        };
        let params = OfVehicle {
            options: AnchorParams::default(),
            vehicle: VehicleFrame::default(),
        };
        Holds::new(rows, &params)
    }

    proptest! {
        /// Storeys lie above each other: of poses that are equally far away the first says how high the ground is.
        #[test]
        fn the_ground_is_as_high_as_the_pose_that_is_nearest_from_above(
            stood in prop::collection::vec([-4..4_i32, -4..4, 0..3], 0..40),
            at in [-5..5_i32, -5..5],
        ) {
            let stood: Vec<[f64; 3]> = stood.iter().map(|place| place.map(f64::from)).collect();
            let rows = (0..).zip(&stood).map(|(stamp, place)| pose("a", stamp, *place));
            let at = at.map(f64::from);
            let away = |place: &&[f64; 3]| (place[0] - at[0]).hypot(place[1] - at[1]);
            let nearest = stood.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
            let height = nearest.map_or(0.0, |place| place[2]);
            prop_assert_eq!(holds(rows.collect()).ground(at), height);
        }
    }

    #[test]
    fn a_pose_is_of_its_session_and_instant() {
        let mut nowhere = pose("b", 7, [0.0; 3]);
        nowhere.map_from_vehicle.x = f64::NAN;
        let known = holds(vec![
            pose("a", 5, [0.0; 3]),
            pose("b", 6, [0.0; 3]),
            nowhere,
        ]);
        let found = [("a", 5), ("b", 6), ("a", 6), ("b", 7), ("c", 5)];
        let found = found.map(|(session, stamp)| known.has_pose(session, Stamp(stamp)));
        assert_eq!(found, [true, true, false, false, false]);
    }
}
