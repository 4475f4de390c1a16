//! A map's trajectories beside the truth.

use std::collections::BTreeMap;
use std::path::Path;

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::StampedPose;
use evermap_bench::trajectory::{
    AbsoluteError, PosePair, Statistics, absolute_error, align, associate, tum,
};
use serde_json::Value;

use crate::{answered, text};

/// Poses of a drive further apart than this are not interpolated, ns.
const MAX_GAP_NS: i64 = 500_000_000;

/// Trajectories by session, each ordered by stamp.
pub type Trajectories = BTreeMap<String, Vec<StampedPose>>;

/// A TUM file.
///
/// # Panics
/// Where it is none.
pub fn truth(path: &Path) -> Vec<StampedPose> {
    let read = std::fs::read_to_string(path);
    let read = read.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    tum::read(&read).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The rows of a query on a version of a map (the newest where none is given).
///
/// # Panics
/// Where the query fails.
pub fn rows(map: &Path, version: Option<u32>, sql: &str) -> Vec<Value> {
    let version = version.map(|version| version.to_string());
    let mut of = vec!["--map", text(map)];
    if let Some(version) = &version {
        of.extend(["--version", version]);
    }
    answered(&of, sql).as_array().cloned().unwrap_or_default()
}

/// The poses in `column` of a layer, by session.
///
/// # Panics
/// Where the layer or the column is not there.
pub fn poses(map: &Path, version: Option<u32>, layer: &str, column: &str) -> Trajectories {
    let sql = format!(
        "SELECT session, CAST(stamp AS BIGINT) AS stamp_ns, {column} AS pose FROM {layer} \
         WHERE {column} IS NOT NULL ORDER BY session, stamp"
    );
    let mut trajectories = Trajectories::new();
    for row in rows(map, version, &sql) {
        let session = row["session"].as_str().expect("a session is text");
        let stamp_ns = row["stamp_ns"].as_i64().expect("a stamp is a number");
        let pose = pose(&row["pose"]);
        let of_session = trajectories.entry(session.to_owned()).or_default();
        of_session.push(StampedPose { stamp_ns, pose });
    }
    trajectories
}

pub(crate) fn pose(value: &Value) -> Pose {
    let names = ["x", "y", "z", "qx", "qy", "qz", "qw"];
    let numbers = names.map(|name| value[name].as_f64().expect("a pose is seven numbers"));
    Pose::from_array(numbers).expect("a pose is a rigid motion")
}

/// Estimates and truth at the same instants, of the sessions that both have.
pub fn pairs(estimates: &Trajectories, truths: &Trajectories) -> BTreeMap<String, Vec<PosePair>> {
    let joined = estimates.iter().filter_map(|(session, estimate)| {
        let truth = truths.get(session)?;
        Some((session.clone(), associate(estimate, truth, MAX_GAP_NS)))
    });
    joined.collect()
}

/// The rigid motion that lays a map onto the truth.
///
/// # Panics
/// Where they share no pose.
pub fn truth_from_map(map: &Trajectories, truths: &Trajectories) -> Pose {
    let all: Vec<PosePair> = pairs(map, truths).into_values().flatten().collect();
    align(&all).expect("the map and the truth share poses")
}

/// The error of all sessions after one rigid alignment.
///
/// # Panics
/// Where they share no pose.
pub fn map_error(map: &Trajectories, truths: &Trajectories) -> AbsoluteError {
    error_in(map, truths, &truth_from_map(map, truths)).expect("the map and the truth share poses")
}

/// The error after a given alignment; `None` without poses.
pub fn error_in(
    estimates: &Trajectories,
    truths: &Trajectories,
    truth_from_map: &Pose,
) -> Option<AbsoluteError> {
    let all: Vec<PosePair> = pairs(estimates, truths).into_values().flatten().collect();
    absolute_error(&all, truth_from_map)
}

/// Each session's error after an alignment of its own, over all sessions: what odometry does, whose
/// frame begins anew with every drive.
///
/// # Panics
/// Where they share no pose.
pub fn error_by_session(estimates: &Trajectories, truths: &Trajectories) -> Statistics {
    let mut errors = Vec::new();
    for of_session in pairs(estimates, truths).into_values() {
        let moved = align(&of_session).expect("a session and its truth share poses");
        errors.extend(of_session.iter().map(|pair| {
            let there = moved.transform(&pair.estimate.translation);
            (there - pair.truth.translation).norm()
        }));
    }
    Statistics::of(errors).expect("errors are numbers")
}
