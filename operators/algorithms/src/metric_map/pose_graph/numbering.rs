//! Drives as a pose graph: which pose is which keyframe, and what odometry, loops and fixes say between them.

use nalgebra::{Matrix6, Vector6};

use super::drives::{DriveParams, DrivePose, FixConstraint, KeyframeRef, LoopConstraint};
use super::{Edge, Graph, SpatialGraph};
use crate::geometry::lie::se3;
use crate::geometry::pose::Pose;
use crate::solving::least_squares::Loss;

/// Steps shorter than this are as uncertain as one of this length (m): wheels tick.
const SHORTEST_STEP_M: f64 = 0.02;

/// Keyframes of placed drives as poses of a graph; pose 0 is the map's origin.
pub(super) struct Numbering {
    /// By drive: the pose of its first keyframe.
    first: Vec<Option<usize>>,
    lengths: Vec<usize>,
}

impl Numbering {
    pub(super) fn new(drives: &[Vec<DrivePose>], poses: &[Option<Vec<Pose>>]) -> Self {
        let mut next = 1;
        let first = drives.iter().zip(poses).map(|(drive, poses)| {
            poses.as_ref().map(|_| {
                next += drive.len();
                next - drive.len()
            })
        });
        Self {
            first: first.collect(),
            lengths: drives.iter().map(Vec::len).collect(),
        }
    }

    pub(super) fn of(&self, place: KeyframeRef) -> Option<usize> {
        let first = *self.first.get(place.drive)?;
        (place.keyframe < *self.lengths.get(place.drive)?).then_some(first? + place.keyframe)
    }

    /// The placed drives with their odometry.
    pub(super) fn graph(
        &self,
        drives: &[Vec<DrivePose>],
        poses: &[Option<Vec<Pose>>],
        params: &DriveParams,
    ) -> SpatialGraph {
        let mut graph = Graph {
            poses: vec![Pose::identity()],
            fixed: vec![true],
            edges: Vec::new(),
        };
        for (drive, poses) in drives.iter().zip(poses) {
            let Some(poses) = poses else { continue };
            let first = graph.poses.len();
            graph.poses.extend(poses);
            graph
                .fixed
                .extend(drive.iter().map(|at| at.known.is_some()));
            for (step, pair) in drive.windows(2).enumerate() {
                let ends = [first + step, first + step + 1];
                let edge = params.odometry_edge(ends, [&pair[0], &pair[1]]);
                graph.edges.push(edge);
            }
        }
        graph
    }

    pub(super) fn loop_edge(
        &self,
        given: &LoopConstraint,
        params: &DriveParams,
    ) -> Option<Edge<Pose, 6>> {
        let ends = [self.of(given.earlier)?, self.of(given.later)?];
        params.loop_edge(
            ends,
            given.earlier_from_later,
            [given.sigma_m, given.sigma_rad],
        )
    }

    pub(super) fn fix_edge(
        &self,
        fix: &FixConstraint,
        params: &DriveParams,
    ) -> Option<Edge<Pose, 6>> {
        let (m2, rad2) = (params.loop_m.powi(2), params.loop_rad.powi(2));
        let floor = Matrix6::from_diagonal(&Vector6::new(m2, m2, m2, rad2, rad2, rad2));
        let information = (fix.covariance + floor).cholesky()?.inverse();
        if !information.iter().all(|value| value.is_finite()) {
            return None;
        }
        Some(Edge {
            from: 0,
            to: self.of(fix.at)?,
            measured: fix.map_from_vehicle,
            information,
            loss: Loss::Quadratic,
        })
    }

    pub(super) fn read(&self, graph: &SpatialGraph, poses: &mut [Option<Vec<Pose>>]) {
        for ((first, length), poses) in self.first.iter().zip(&self.lengths).zip(poses) {
            if let Some(first) = first {
                *poses = Some(graph.poses[*first..first + length].to_vec());
            }
        }
    }
}

impl DriveParams {
    /// What the odometry says of a keyframe and the next one of its drive, given the indices of their poses.
    pub fn odometry_edge(
        &self,
        [from, to]: [usize; 2],
        [before, after]: [&DrivePose; 2],
    ) -> Edge<Pose, 6> {
        let measured = before
            .odom_from_vehicle
            .inverse()
            .compose(&after.odom_from_vehicle);
        let turn = se3::split(&se3::log(&measured)).1.norm();
        let driven = (after.path_m - before.path_m).max(measured.translation.norm());
        let step = driven.max(SHORTEST_STEP_M);
        let position = 1.0 / (self.odometry.walk_m().powi(2) * step);
        let upright = 1.0 / (self.slope.powi(2) * step);
        let heading = 1.0 / (self.walk_rad.powi(2) * step + self.turn_rad.powi(2) * turn);
        let diagonal = Vector6::new(position, position, upright, upright, upright, heading);
        Edge {
            from,
            to,
            measured,
            information: Matrix6::from_diagonal(&diagonal),
            loss: Loss::Quadratic,
        }
    }

    /// What a loop closure says of its earlier and its later keyframe, with the standard deviations (m, rad) that it
    /// gives itself; `None` where these are no numbers.
    pub fn loop_edge(
        &self,
        [earlier, later]: [usize; 2],
        earlier_from_later: Pose,
        [sigma_m, sigma_rad]: [f64; 2],
    ) -> Option<Edge<Pose, 6>> {
        let position = 1.0 / (sigma_m.powi(2) + self.loop_m.powi(2));
        let turn = 1.0 / (sigma_rad.powi(2) + self.loop_rad.powi(2));
        let diagonal = Vector6::new(position, position, position, turn, turn, turn);
        let sound = diagonal.iter().all(|value| value.is_finite());
        sound.then(|| Edge {
            from: earlier,
            to: later,
            measured: earlier_from_later,
            information: Matrix6::from_diagonal(&diagonal),
            loss: Loss::Quadratic,
        })
    }
}
