//! The vehicle pose that a label is tied to: the one whose camera sees it most centrally, with a free line of sight.
//!
//! "Visible and most central" (paper 1, V-A3) says neither how far away nor what hides a label. Here: poses within reach of
//! the label; of their cameras those whose image has the label's middle in it; of these the one whose axis makes the
//! smallest angle with the ray to it, if nothing that the map knows stands in between, else the next. Where no camera sees
//! it, or none is known, the nearest pose.

use nalgebra::Vector3;
use rstar::primitives::GeomWithData;
use rstar::{AABB, RTree};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::geometry::pose::Pose;
use crate::geometry::rig::Rig;

/// Which poses may hold a label, and what hides it from them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct AnchorParams {
    /// A label is tied to poses within this distance (m): as far as ground patches reach, so that what is drawn on the
    /// overhead image was seen from there. What hangs off a pose at 8 m moves by 1.4 cm where the pose turns by a tenth of
    /// a degree.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub reach_m: f64,
    /// Landmarks hide a label that stand higher than this above it and nearer than this to the line of sight (m): what is
    /// higher than a kerb, and about as wide as a post or a wheel.
    #[schemars(range(min = 0.0))]
    pub obstacle_m: f64,
}

impl Default for AnchorParams {
    fn default() -> Self {
        Self {
            reach_m: 8.0,
            obstacle_m: 0.3,
        }
    }
}

/// Points of the map that may stand between a camera and a label.
#[derive(Debug, Clone, Default)]
pub struct Obstacles(RTree<[f64; 3]>);

impl Obstacles {
    /// Of points in the map, m; those that are not finite are left out.
    pub fn new(points: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let finite = |point: &[f64; 3]| point.iter().all(|value| value.is_finite());
        Self(RTree::bulk_load(
            points.into_iter().filter(finite).collect(),
        ))
    }

    /// Whether none of them stands between an eye and a label.
    fn free(&self, eye: &Vector3<f64>, label: &Vector3<f64>, obstacle_m: f64) -> bool {
        let room = Vector3::repeat(obstacle_m);
        let corners = (eye.inf(label) - room, eye.sup(label) + room);
        let around = AABB::from_corners(corners.0.into(), corners.1.into());
        let ray = label - eye;
        let hides = |point: &[f64; 3]| {
            let from_eye = Vector3::from(*point) - eye;
            let along = from_eye.dot(&ray) / ray.norm_squared();
            let off = (from_eye - ray * along).norm();
            point[2] - label.z > obstacle_m && (0.0..=1.0).contains(&along) && off < obstacle_m
        };
        !self.0.locate_in_envelope(&around).any(hides)
    }
}

/// The poses that labels may be tied to.
#[derive(Debug, Clone, Default)]
pub struct Stations(RTree<GeomWithData<[f64; 3], usize>>);

/// Where a label is seen from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sight {
    /// Index of the pose.
    pub pose: usize,
    /// Index of the camera in its rig; `None` where no camera sees the label.
    pub camera: Option<usize>,
}

impl Stations {
    /// Of poses `map_from_vehicle`.
    pub fn new(poses: &[Pose]) -> Self {
        let places = poses.iter().enumerate();
        let places = places.map(|(index, pose)| GeomWithData::new(pose.translation.into(), index));
        Self(RTree::bulk_load(places.collect()))
    }

    /// The pose to tie a label to, whose middle is at `label` in the map; `None` where none is within reach. Of equally good
    /// ones the one of the lowest index. `rig` gives the cameras of a pose.
    pub fn sight<'r>(
        &self,
        label: &Vector3<f64>,
        poses: &[Pose],
        rig: impl Fn(usize) -> Option<&'r Rig>,
        obstacles: &Obstacles,
        params: &AnchorParams,
    ) -> Option<Sight> {
        let within = self
            .0
            .locate_within_distance((*label).into(), params.reach_m * params.reach_m);
        let mut near: Vec<usize> = within.map(|place| place.data).collect();
        near.sort_unstable();
        let mut views = Vec::new();
        for &pose in &near {
            let cameras = rig(pose).map_or(&[][..], |rig| &rig.cameras);
            for (camera, mounted) in cameras.iter().enumerate() {
                let map_from_camera = poses[pose].compose(&mounted.vehicle_from_camera);
                let ray = map_from_camera.inverse().transform(label);
                let pixel = mounted.camera.project(&ray);
                if pixel.is_some_and(|pixel| mounted.camera.contains(pixel)) {
                    let off_axis_rad = ray.xy().norm().atan2(ray.z);
                    views.push((off_axis_rad, pose, camera, map_from_camera.translation));
                }
            }
        }
        views.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut free = views.iter();
        let free = free.find(|(.., eye)| obstacles.free(eye, label, params.obstacle_m));
        let central = free.map(|(_, pose, camera, _)| Sight {
            pose: *pose,
            camera: Some(*camera),
        });
        let away = |pose: &usize| (poses[*pose].translation - label).norm_squared();
        let nearest = || near.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
        central.or_else(|| {
            nearest().map(|pose| Sight {
                pose: *pose,
                camera: None,
            })
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::f64::consts::FRAC_PI_2;

    use nalgebra::{Matrix3, Rotation3, UnitQuaternion};

    use super::*;
    use crate::geometry::camera::Camera;
    use crate::geometry::rig::RigCamera;

    /// A camera 1 m above the ground that looks ahead, 90 degrees wide.
    fn ahead() -> Rig {
        let optical = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let turn = Rotation3::from_matrix_unchecked(optical);
        let k = [320.0, 0.0, 319.5, 0.0, 320.0, 319.5, 0.0, 0.0, 1.0];
        let lens = Camera::from_calibration("plumb_bob", 640, 640, &k, &[]).unwrap();
        let camera = RigCamera {
            name: "ahead".into(),
            camera: lens,
            vehicle_from_camera: Pose::new(
                Vector3::new(0.0, 0.0, 1.0),
                UnitQuaternion::from_rotation_matrix(&turn),
            ),
        };
        Rig {
            cameras: vec![camera],
        }
    }

    fn seen(poses: &[Pose], rig: Option<&Rig>, obstacles: &[[f64; 3]]) -> Option<Sight> {
        let label = Vector3::new(6.0, 0.0, 0.0);
        let obstacles = Obstacles::new(obstacles.iter().copied());
        let params = AnchorParams::default();
        Stations::new(poses).sight(&label, poses, |_| rig, &obstacles, &params)
    }

    fn at(x: f64, y: f64, yaw: f64) -> Pose {
        Pose::from_yaw(x, y, yaw)
    }

    #[test]
    fn the_most_central_view_within_reach_holds_the_label() {
        // Far, near, aside, turned away; the farther away, the nearer to the axis.
        let poses = [
            at(-3.0, 0.0, 0.0),
            at(0.0, 0.0, 0.0),
            at(3.0, 0.0, 0.0),
            at(5.0, 0.5, 3.0),
        ];
        let rig = ahead();
        let expected = |pose, camera| Some(Sight { pose, camera });
        assert_eq!(seen(&poses, Some(&rig), &[]), expected(1, Some(0)));
        assert_eq!(seen(&poses, None, &[]), expected(3, None));
        assert_eq!(seen(&poses[3..], Some(&rig), &[]), expected(0, None));
        assert_eq!(seen(&poses[..1], Some(&rig), &[]), None);
    }

    #[test]
    fn what_stands_between_hides_and_the_ground_does_not() {
        let poses = [at(0.0, 0.0, 0.0), at(6.0, -5.0, FRAC_PI_2)];
        let rig = ahead();
        let hidden_from = |obstacle: [f64; 3]| {
            let found = seen(&poses, Some(&rig), &[obstacle]);
            found.map(|sight| sight.pose)
        };
        assert_eq!(hidden_from([2.0, 0.1, 0.7]), Some(1), "on the ray");
        assert_eq!(hidden_from([2.0, 0.5, 0.7]), Some(0), "beside it");
        assert_eq!(hidden_from([5.0, 0.0, 0.1]), Some(0), "on the ground");
        assert_eq!(hidden_from([8.0, 0.0, 0.5]), Some(0), "behind the label");
        let both = [[2.0, 0.0, 0.7], [6.0, -3.0, 0.6]];
        let found = seen(&poses, Some(&rig), &both);
        assert_eq!(
            found,
            Some(Sight {
                pose: 1,
                camera: None
            }),
            "the nearest, then"
        );
    }
}
