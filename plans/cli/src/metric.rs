//! What there is to say and to draw of a map's poses: odometry before, adjusted poses after, landmarks, loops.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_schemas::layers::{AdjustedPose, GraphPose, Keyframe, VehiclePose};
use evermap_schemas::{Fault, Stamp};

use crate::draw::{LoopLine, Scene, Trajectory};
use crate::reader::MapReader;
use crate::shown::LandmarkPoint;

/// Above this a loop closure counts as one that the relaxed poses agree with: half of what it would count as sound.
pub const ACCEPTED: f64 = 0.5;

/// How far the map moved a session's poses from where its odometry had them.
#[derive(Debug, Clone, PartialEq)]
pub struct Drift {
    /// Session.
    pub session: String,
    /// Keyframes of the session.
    pub keyframes: u64,
    /// Keyframes that the map has poses of.
    pub mapped: u64,
    /// Driven path of those, m.
    pub driven_m: f64,
    /// Distance of the last pose from the odometry's, when the first ones are laid on each other, m.
    pub end_m: f64,
    /// The largest such distance, m.
    pub most_m: f64,
}

/// The metric map of one site.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MetricMap {
    /// Trajectories, those of the odometry laid on the first pose of their session in the map; landmarks and loops.
    pub scene: Scene,
    /// Drift, by session.
    pub drifts: Vec<Drift>,
}

/// The metric map of a site; `None` where the map has no adjusted poses of it.
///
/// # Errors
/// As [`MapReader::rows`].
pub async fn metric_map(reader: &MapReader, site: &str) -> Result<Option<MetricMap>, Fault> {
    let site = Some(site);
    let adjusted: Vec<AdjustedPose> = reader.rows(site).await?;
    if adjusted.is_empty() {
        return Ok(None);
    }
    let poses: Vec<VehiclePose> = reader.rows(site).await?;
    let keyframes: Vec<Keyframe> = reader.rows(site).await?;
    let landmarks: Vec<LandmarkPoint> = reader.rows(site).await?;
    let mut found = compared(&poses, &keyframes);
    found.scene.landmarks = landmarks.iter().map(|row| [row.x, row.y]).collect();
    found.scene.loops = loops(&reader.rows(site).await?);
    Ok(Some(found))
}

fn at(found: &evermap_schemas::Pose) -> Option<Pose> {
    Pose::from_array(found.to_array()).ok()
}

/// Stamp, odometry, map.
type Pair = (Stamp, Pose, Pose);

fn compared(poses: &[VehiclePose], keyframes: &[Keyframe]) -> MetricMap {
    let by_stamp: BTreeMap<(&str, Stamp), &VehiclePose> = poses
        .iter()
        .map(|row| ((row.session.as_str(), row.stamp), row))
        .collect();
    let mut counts: BTreeMap<&str, u64> = BTreeMap::new();
    let mut pairs: BTreeMap<&str, Vec<Pair>> = BTreeMap::new();
    for row in keyframes {
        *counts.entry(&row.session).or_default() += 1;
        let mapped = by_stamp.get(&(row.session.as_str(), row.stamp));
        let both = mapped
            .and_then(|mapped| Some((at(&row.odom_from_vehicle)?, at(&mapped.map_from_vehicle)?)));
        let of_session = pairs.entry(&row.session).or_default();
        of_session.extend(both.map(|(odometry, mapped)| (row.stamp, odometry, mapped)));
    }
    let mut found = MetricMap::default();
    for (session, mut pairs) in pairs {
        pairs.sort_by_key(|(stamp, ..)| *stamp);
        found.add(session, counts[session], &pairs);
    }
    found
}

impl MetricMap {
    fn add(&mut self, session: &str, keyframes: u64, pairs: &[Pair]) {
        let Some((_, odometry, mapped)) = pairs.first() else {
            return;
        };
        let map_from_odom = mapped.compose(&odometry.inverse());
        let laid: Vec<Pose> = pairs
            .iter()
            .map(|(_, odometry, _)| map_from_odom.compose(odometry))
            .collect();
        let off =
            |(laid, (_, _, mapped)): (&Pose, &Pair)| (laid.translation - mapped.translation).norm();
        let offs: Vec<f64> = laid.iter().zip(pairs).map(off).collect();
        let trajectory = |poses: Vec<&Pose>| Trajectory {
            session: session.to_owned(),
            points: poses
                .iter()
                .map(|pose| [pose.translation.x, pose.translation.y])
                .collect(),
        };
        let after = trajectory(pairs.iter().map(|(_, _, mapped)| mapped).collect());
        self.drifts.push(Drift {
            session: session.to_owned(),
            keyframes,
            mapped: pairs.len() as u64,
            driven_m: after.length_m(),
            end_m: offs.last().copied().unwrap_or_default(),
            most_m: offs.into_iter().fold(0.0, f64::max),
        });
        self.scene.odometry.push(trajectory(laid.iter().collect()));
        self.scene.trajectories.push(after);
    }
}

/// Loops between relaxed poses.
fn loops(graph: &[GraphPose]) -> Vec<LoopLine> {
    let positions: BTreeMap<(&str, u32), [f64; 2]> = graph
        .iter()
        .map(|row| {
            let pose = &row.map_from_vehicle;
            ((row.session.as_str(), row.keyframe), [pose.x, pose.y])
        })
        .collect();
    let mut lines = Vec::new();
    for row in graph {
        let to = [row.map_from_vehicle.x, row.map_from_vehicle.y];
        for closed in &row.loops {
            if let Some(from) = positions.get(&(closed.session.as_str(), closed.keyframe)) {
                lines.push(LoopLine {
                    ends: [*from, to],
                    accepted: closed.weight > ACCEPTED,
                });
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use evermap_schemas::layers::LoopEdge;

    fn pose(x: f64, y: f64, yaw: f64) -> evermap_schemas::Pose {
        evermap_schemas::Pose::from_array(Pose::from_yaw(x, y, yaw).to_array())
    }

    #[test]
    fn drift_is_measured_from_the_first_pose_on() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let keyframes: Vec<Keyframe> = (0..5)
            .map(|k| Keyframe {
                site: "lot".into(),
                session: "a".into(),
                stamp: Stamp(i64::from(k)),
                keyframe: k,
                distance_m: 0.0,
                stretch: 0,
                // Odometry is 10 % too long.
                odom_from_vehicle: pose(1.1 * f64::from(k), 0.0, 0.0),
                images: vec![],
            })
            .collect();
        // The map has the drive go north from (10, 20), and does not have its last keyframe.
        let poses: Vec<VehiclePose> = (0..4)
            .map(|k| VehiclePose {
                site: "lot".into(),
                session: "a".into(),
                stamp: Stamp(i64::from(k)),
                map_from_vehicle: pose(10.0, 20.0 + f64::from(k), quarter),
            })
            .collect();
        let found = compared(&poses, &keyframes);
        let drift = &found.drifts[0];
        assert_eq!((drift.keyframes, drift.mapped), (5, 4));
        assert!((drift.end_m - 0.3).abs() < 1e-12 && (drift.most_m - 0.3).abs() < 1e-12);
        assert!((drift.driven_m - 3.0).abs() < 1e-12);
        let [x, y] = found.scene.odometry[0].points[3];
        assert!((x - 10.0).abs() < 1e-12 && (y - 23.3).abs() < 1e-12);
    }

    #[test]
    fn loops_lie_between_their_keyframes() {
        let row = |keyframe: u32, loops| GraphPose {
            site: "lot".into(),
            session: "a".into(),
            stamp: Stamp(i64::from(keyframe)),
            keyframe,
            map_from_vehicle: pose(f64::from(keyframe), 0.0, 0.0),
            loops,
            optimality: "optimal".into(),
        };
        let edge = |keyframe, weight| LoopEdge {
            session: "a".into(),
            keyframe,
            residual_m: 0.0,
            residual_rad: 0.0,
            weight,
        };
        let edges = vec![edge(0, 0.9), edge(1, 0.1), edge(7, 1.0)];
        let found = loops(&[row(0, vec![]), row(1, vec![]), row(2, edges)]);
        let accepted: Vec<_> = found.iter().map(|line| line.accepted).collect();
        assert_eq!(accepted, [true, false]);
        assert_eq!(found[1].ends, [[1.0, 0.0], [2.0, 0.0]]);
    }
}
