//! The pose graph as g2o's text: a layer of keyframe poses, with odometry and loops between them.
//!
//! Vertices are numbered by session, then stamp, from 0; the first is fixed. `EDGE_SE3:QUAT` lines are first those
//! between keyframes that follow each other in the odometry, then the loop closures, as uncertain as the operator
//! `pose_graph` takes them by default.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::pose_graph::drives::{DriveParams, DrivePose};
use evermap_algorithms::metric_map::pose_graph::{SpatialGraph, g2o};
use evermap_schemas::layers::{Keyframe, LoopClosure, VehiclePose};
use evermap_schemas::{Fault, Stamp};

use crate::reader::{MapReader, one_site, typed};

/// The graph of a layer of poses.
///
/// # Errors
/// A user fault for poses of several sites, or a map without keyframes.
pub async fn text(
    reader: &MapReader,
    batches: &[RecordBatch],
    site: Option<&str>,
) -> Result<String, Fault> {
    let poses: Vec<VehiclePose> = typed(batches)
        .map_err(|fault| fault.next("export adjusted_poses, graph_poses or poses"))?;
    let site = one_site(poses.iter().map(|row| row.site.as_str()), site)?;
    let keyframes: Vec<Keyframe> = reader.needed(Some(&site)).await?;
    // A drive without loops is a graph too.
    let loops: Vec<LoopClosure> = reader.rows(Some(&site)).await?;
    let (graph, ids) = graph(poses, keyframes, &loops)?;
    Ok(g2o::write_spatial(&graph, &ids))
}

fn graph(
    mut poses: Vec<VehiclePose>,
    mut keyframes: Vec<Keyframe>,
    loops: &[LoopClosure],
) -> Result<(SpatialGraph, Vec<u64>), Fault> {
    poses.sort_by(|a, b| (&a.session, a.stamp).cmp(&(&b.session, b.stamp)));
    let index: BTreeMap<(String, Stamp), usize> = (0..)
        .zip(&poses)
        .map(|(index, row)| ((row.session.clone(), row.stamp), index))
        .collect();
    keyframes.sort_by(|a, b| (&a.session, a.stamp).cmp(&(&b.session, b.stamp)));
    keyframes.retain(|row| index.contains_key(&(row.session.clone(), row.stamp)));
    let mut edges = Vec::new();
    let uncertain = DriveParams::default();
    for pair in keyframes.windows(2) {
        let [from, to] = [&pair[0], &pair[1]];
        if (&from.session, from.stretch) == (&to.session, to.stretch) {
            let ends = [from, to].map(|row| index[&(row.session.clone(), row.stamp)]);
            edges.push(uncertain.odometry_edge(ends, [&driven(from)?, &driven(to)?]));
        }
    }
    for row in loops {
        let from = index.get(&(row.other_session.clone(), row.other_stamp));
        let to = index.get(&(row.session.clone(), row.stamp));
        if let (Some(&from), Some(&to)) = (from, to) {
            let measured = pose(&row.other_from_vehicle)?;
            let sigmas = [row.sigma_m, row.sigma_rad];
            edges.extend(uncertain.loop_edge([from, to], measured, sigmas));
        }
    }
    let count = poses.len();
    let poses = poses
        .iter()
        .map(|row| pose(&row.map_from_vehicle))
        .collect::<Result<_, _>>()?;
    let graph = SpatialGraph {
        poses,
        fixed: (0..count).map(|index| index == 0).collect(),
        edges,
    };
    Ok((graph, (0..count as u64).collect()))
}

fn pose(found: &evermap_schemas::Pose) -> Result<Pose, Fault> {
    Pose::from_array(found.to_array()).map_err(|error| Fault::data(error.to_string()))
}

fn driven(row: &Keyframe) -> Result<DrivePose, Fault> {
    Ok(DrivePose {
        odom_from_vehicle: pose(&row.odom_from_vehicle)?,
        path_m: row.distance_m,
        known: None,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use super::*;
    use evermap_bench::g2o::{File, read};

    fn at(x: f64) -> evermap_schemas::Pose {
        evermap_schemas::Pose {
            x,
            ..evermap_schemas::Pose::IDENTITY
        }
    }

    fn keyframe(session: &str, number: u32, x: f64) -> Keyframe {
        Keyframe {
            site: "lot".into(),
            session: session.into(),
            stamp: Stamp(i64::from(number)),
            keyframe: number,
            distance_m: x,
            stretch: 0,
            odom_from_vehicle: at(x),
            images: vec![],
        }
    }

    #[test]
    fn odometry_and_loops_join_the_poses() {
        let keyframes: Vec<_> = [("a", 0), ("a", 1), ("b", 0), ("b", 1), ("b", 2)]
            .map(|(session, number)| keyframe(session, number, f64::from(number)))
            .into();
        // The last keyframe of b has no pose: it was not connected.
        let poses = keyframes[..4].iter().map(|row| VehiclePose {
            site: "lot".into(),
            session: row.session.clone(),
            stamp: row.stamp,
            map_from_vehicle: at(10.0 + row.distance_m),
        });
        let closed = |number: i64| LoopClosure {
            site: "lot".into(),
            session: "b".into(),
            stamp: Stamp(number),
            keyframe: number as u32,
            other_session: "a".into(),
            other_stamp: Stamp(0),
            other_keyframe: 0,
            other_from_vehicle: at(0.25),
            matches: 9,
            inliers: 8,
            sigma_m: 0.1,
            sigma_rad: 0.01,
        };
        let (graph, ids) = graph(
            poses.rev().collect(),
            keyframes.clone(),
            &[closed(1), closed(2)],
        )
        .unwrap();
        let text = g2o::write_spatial(&graph, &ids);
        let File::Spatial(read) = read(&text).unwrap() else {
            panic!("{text}")
        };
        assert_eq!(read.graph, graph);
        let ends: Vec<_> = graph
            .edges
            .iter()
            .map(|edge| (edge.from, edge.to))
            .collect();
        assert_eq!(ends, [(0, 1), (2, 3), (0, 3)]);
        let sigma_m = graph.edges[2].information[(0, 0)].powf(-0.5);
        assert!((sigma_m - 0.1_f64.hypot(0.05)).abs() < 1e-12);
        assert_eq!(graph.poses[3].translation.x, 11.0);
    }
}
