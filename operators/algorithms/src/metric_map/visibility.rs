//! From where a landmark may be recognised, and which landmarks may be from here.

use nalgebra::Vector3;
use rstar::RTree;
use rstar::primitives::{GeomWithData, Rectangle};

use crate::geometry::rig::RigCamera;

/// No cosine is as low: a cone of this edge reaches all around.
const ALL_AROUND: f64 = -2.0;

/// Where a camera may be that recognises a landmark: in a cone about the directions that it was seen from, at about the
/// ranges that it was seen at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Visibility {
    landmark: Vector3<f64>,
    /// Unit vector.
    view: Vector3<f64>,
    /// Cosine of the cone's half angle.
    edge_cos: f64,
    /// Nearest and farthest, metres.
    ranges_m: [f64; 2],
}

/// How a landmark was seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct ViewCone {
    /// Mean direction to the cameras, a unit vector.
    pub(super) view: Vector3<f64>,
    /// Cosine of the largest angle between it and the direction to a camera.
    pub(super) view_cos: f64,
    /// Distance of the nearest camera and of the farthest one, metres.
    pub(super) ranges_m: [f64; 2],
}

impl Visibility {
    /// From directions that are `slack_rad` outside the cone that it was seen from, and ranges that differ by this factor.
    pub(super) fn new(
        landmark: Vector3<f64>,
        seen: &ViewCone,
        slack_rad: f64,
        range_slack: f64,
    ) -> Self {
        let cos = seen.view_cos.clamp(-1.0, 1.0);
        let (slack_sin, slack_cos) = slack_rad.min(std::f64::consts::PI).sin_cos();
        let edge_cos = match cos <= -slack_cos {
            true => ALL_AROUND,
            false => cos * slack_cos - (1.0 - cos * cos).sqrt() * slack_sin,
        };
        let [near_m, far_m] = seen.ranges_m;
        Self {
            landmark,
            view: seen.view,
            edge_cos,
            ranges_m: [near_m / range_slack, far_m * range_slack],
        }
    }

    /// Never from farther than this.
    pub(super) fn within(mut self, reach_m: f64) -> Self {
        self.ranges_m[1] = self.ranges_m[1].min(reach_m);
        self
    }

    /// Whether a camera that stands there may recognise it.
    pub(super) fn from(&self, camera: &Vector3<f64>) -> bool {
        let away = camera - self.landmark;
        let range_m = away.norm();
        (self.ranges_m[0]..=self.ranges_m[1]).contains(&range_m)
            && away.dot(&self.view) >= self.edge_cos * range_m
    }
}

/// The box that the cameras are in which may recognise a landmark, and which landmark that is.
type Reach = GeomWithData<Rectangle<[f64; 3]>, u32>;

/// Landmarks by where they may be recognised from.
#[derive(Debug, Clone)]
pub(super) struct Reaches {
    tree: RTree<Reach>,
}

impl Reaches {
    /// Of landmarks with their numbers, for vehicles with these cameras. Those whose reach has no bounds are never around.
    pub(super) fn new<'a>(
        landmarks: impl IntoIterator<Item = (u32, &'a Visibility)>,
        cameras: &[RigCamera],
    ) -> Self {
        let arms = cameras.iter();
        let arms = arms.map(|camera| camera.vehicle_from_camera.translation.norm());
        let arm_m = arms.fold(0.0, f64::max);
        let reach = |(number, visibility): (u32, &Visibility)| {
            let reach_m = visibility.ranges_m[1] + arm_m;
            let corners = [-reach_m, reach_m].map(|away| visibility.landmark.add_scalar(away));
            let bounded = corners.iter().flatten().all(|side| side.is_finite());
            let [low, high] = corners.map(<[f64; 3]>::from);
            // The tree sorts boxes by their middles, which others do not have.
            bounded.then(|| Reach::new(Rectangle::from_corners(low, high), number))
        };
        Self {
            tree: RTree::bulk_load(landmarks.into_iter().filter_map(reach).collect()),
        }
    }

    /// The numbers of landmarks that a camera of a vehicle at this place may recognise, by its range alone; ascending.
    pub(super) fn around(&self, vehicle: &Vector3<f64>) -> Vec<u32> {
        let place: [f64; 3] = (*vehicle).into();
        let within = self.tree.locate_all_at_point(&place);
        let mut around: Vec<u32> = within.map(|reach| reach.data).collect();
        around.sort_unstable();
        around
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose::Pose;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_a_cone_between_two_ranges(
            landmark in prop::array::uniform3(-5.0..5.0f64), camera in prop::array::uniform3(-20.0..20.0f64),
            view in prop::array::uniform3(-1.0..1.0f64), half_rad in 0.0..3.1f64, slack_rad in 0.0..3.5f64,
        ) {
            prop_assume!(Vector3::from(view).norm() > 0.1);
            let [landmark, camera] = [landmark, camera].map(Vector3::from);
            let view = Vector3::from(view).normalize();
            let seen = ViewCone { view, view_cos: half_rad.cos(), ranges_m: [3.0, 10.0] };
            let visibility = Visibility::new(landmark, &seen, slack_rad, 1.5);
            let (angle, range_m) = ((camera - landmark).angle(&view), (camera - landmark).norm());
            prop_assume!((angle - half_rad - slack_rad).abs() > 1e-6);
            let expected = angle <= half_rad + slack_rad && (2.0..=15.0).contains(&range_m);
            prop_assert_eq!(visibility.from(&camera), expected);
            prop_assert!(!visibility.within(range_m - 1e-6).from(&camera));
        }

        #[test]
        fn what_a_camera_may_recognise_is_around_its_vehicle(
            landmarks in prop::collection::vec(prop::array::uniform3(-30.0..30.0f64), 0..60),
            vehicle in prop::array::uniform3(-30.0..30.0f64), arm in prop::array::uniform3(-2.0..2.0f64),
        ) {
            let [vehicle, arm] = [vehicle, arm].map(Vector3::from);
            let lens = crate::geometry::camera::Camera::from_calibration(
                "plumb_bob", 64, 48, &[30.0, 30.0, 32.0, 24.0], &[],
            );
            let camera = RigCamera {
                name: "front".into(),
                camera: lens.map_err(|error| TestCaseError::fail(error.to_string()))?,
                vehicle_from_camera: Pose { translation: arm, ..Pose::identity() },
            };
            let seen = |far_m| ViewCone { view: Vector3::z(), view_cos: -1.0, ranges_m: [0.0, far_m] };
            let all = landmarks.iter().zip(1..);
            let all = all.map(|(at, far)| Visibility::new((*at).into(), &seen(f64::from(far)), 0.0, 1.0));
            let all: Vec<Visibility> = all.collect();
            let around = Reaches::new((0..).zip(&all), &[camera]).around(&vehicle);
            prop_assert!(around.is_sorted());
            for (visibility, number) in all.iter().zip(0..) {
                prop_assert!(!visibility.from(&(vehicle + arm)) || around.contains(&number));
            }
        }
    }

    #[test]
    fn nowhere_is_around_nothing() {
        let seen = ViewCone {
            view: Vector3::z(),
            view_cos: -1.0,
            ranges_m: [0.0, 1e9],
        };
        let visibility = Visibility::new(Vector3::zeros(), &seen, 0.0, 1.0);
        let endless = Visibility::new(Vector3::zeros(), &seen, 0.0, f64::INFINITY);
        let all = [(7, &visibility), (8, &endless), (9, &endless)];
        let reaches = Reaches::new(all, &[]);
        assert_eq!(reaches.around(&Vector3::x()), [7]);
        assert!(reaches.around(&Vector3::repeat(f64::NAN)).is_empty());
    }
}
