//! Paths of the rear axle.

use crate::plane::{Pose2, distance};
use std::f64::consts::{PI, TAU};

/// One sample of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Distance driven, metres.
    pub s: f64,
    /// Where, and which way; headings are unwrapped.
    pub pose: Pose2,
    /// Curvature, 1/m, positive to the left.
    pub curvature: f64,
}

/// A path being drawn.
#[derive(Debug, Default)]
pub struct Path {
    /// The samples so far.
    pub points: Vec<PathPoint>,
}

impl Path {
    /// Its length so far, metres.
    pub fn length(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.s)
    }

    /// Goes on to a point; `yaw` may be given in any turn.
    pub fn push(&mut self, at: [f64; 2], yaw: f64, curvature: f64) {
        let (s, yaw) = match self.points.last() {
            None => (0.0, yaw),
            Some(PathPoint { s, pose, .. }) => {
                let turn = (yaw - pose.yaw + PI).rem_euclid(TAU) - PI;
                (s + distance(pose.at(), at), pose.yaw + turn)
            }
        };
        let pose = Pose2::new(at, yaw);
        self.points.push(PathPoint { s, pose, curvature });
    }
}
