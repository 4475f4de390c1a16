//! The floor under drives.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::ground::floor::Floor;
use evermap_schemas::layers::VehiclePose;

/// The floor within `reach_m` of each session's poses, by session; `plane_m` is its height in the vehicle frame. Poses that
/// are none say nothing.
pub(crate) fn floors(poses: &[VehiclePose], plane_m: f64, reach_m: f64) -> BTreeMap<String, Floor> {
    let mut drives: BTreeMap<&str, Vec<Pose>> = BTreeMap::new();
    for row in poses {
        if let Ok(pose) = Pose::from_array(row.map_from_vehicle.to_array()) {
            drives.entry(&row.session).or_default().push(pose);
        }
    }
    let floor = |poses: Vec<Pose>| Floor::under(&poses, plane_m, reach_m);
    drives
        .into_iter()
        .map(|(session, poses)| (session.to_owned(), floor(poses)))
        .collect()
}
