//! Odometry as a guess of the next pose.

use super::LocalisationParams;
use crate::geometry::pose::Pose;
pub(super) use crate::geometry::resection::moved;
use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};

/// Steps and turns smaller than this are noise of the sensors, metres and radians: wheel ticks, suspension.
const FLOOR_M: f64 = 0.005;
const FLOOR_RAD: f64 = 0.004;
/// Learned scale and drift fade with this distance, metres.
const MEMORY_M: f64 = 20.0;
/// Standard deviations before anything is learned: of the scale, and of the yaw drift (rad/m).
const SCALE_PRIOR: f64 = 0.02;
const DRIFT_PRIOR: f64 = 0.01;

/// A pose and how sure it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guess {
    /// `map_from_vehicle`.
    pub pose: Pose,
    /// Translation along the map's axes (m²), then rotation about them (rad²).
    pub covariance: Matrix6<f64>,
}

impl Guess {
    /// Standard deviation of the position in its worst direction, metres.
    pub fn sigma_m(&self) -> f64 {
        worst(self.covariance.fixed_view::<3, 3>(0, 0).into_owned())
    }

    /// Standard deviation of the orientation about its worst axis, radians.
    pub fn sigma_rad(&self) -> f64 {
        worst(self.covariance.fixed_view::<3, 3>(3, 3).into_owned())
    }
}

fn worst(covariance: Matrix3<f64>) -> f64 {
    let symmetric = (covariance + covariance.transpose()) * 0.5;
    if symmetric.iter().any(|x| !x.is_finite()) {
        return f64::INFINITY;
    }
    symmetric.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// The difference of two poses as a 6-vector at `from`: translation, then rotation, in the map's axes. [`moved`] undoes
/// it.
pub(super) fn difference(from: &Pose, to: &Pose) -> Vector6<f64> {
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    let shift = to.translation - from.translation;
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// What localised keyframes have taught about this drive's odometry: its scale and its yaw drift.
#[derive(Debug, Clone, Copy)]
pub(super) struct Odometer {
    scale: f64,
    drift_rad_per_m: f64,
    /// Distance that they rest on, fading.
    known_m: f64,
}

impl Odometer {
    pub(super) fn new() -> Self {
        Self {
            scale: 1.0,
            drift_rad_per_m: 0.0,
            known_m: 0.0,
        }
    }

    /// The step from one keyframe's odometry to another's, corrected by what was learned. Going backwards in time
    /// the path is driven backwards too.
    fn step(&self, from: &Pose, to: &Pose, backwards: bool) -> Pose {
        let raw = from.inverse().compose(to);
        let path = raw.translation.norm() * if backwards { -1.0 } else { 1.0 };
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.drift_rad_per_m * path);
        let half =
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.5 * self.drift_rad_per_m * path);
        Pose::new(half * raw.translation * self.scale, turn * raw.rotation)
    }

    /// The guess at one keyframe from a pose at another, by their odometry.
    pub(super) fn guess(
        &self,
        at: &Guess,
        [from, to]: [&Pose; 2],
        backwards: bool,
        params: &LocalisationParams,
    ) -> Guess {
        let step = self.step(from, to, backwards);
        let arm = at.pose.rotate(&step.translation);
        let mut propagate = Matrix6::identity();
        propagate
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&-arm.cross_matrix());
        let mut covariance = propagate * at.covariance * propagate.transpose();
        let (shift, turn) = step_noise(&step, params);
        let axes = at.pose.rotation.to_rotation_matrix();
        let rotated = |variances: Vector3<f64>| {
            axes.matrix() * Matrix3::from_diagonal(&variances) * axes.matrix().transpose()
        };
        let mut block = covariance.fixed_view_mut::<3, 3>(0, 0);
        block += rotated(shift);
        let mut block = covariance.fixed_view_mut::<3, 3>(3, 3);
        block += rotated(turn);
        Guess {
            pose: at.pose.compose(&step),
            covariance,
        }
    }

    /// Learns from two localised keyframes, of which the first was driven last if `backwards`.
    pub(super) fn learn_either_way(
        &mut self,
        [from, to]: [&Pose; 2],
        [localised_from, localised_to]: [&Pose; 2],
        backwards: bool,
    ) {
        if backwards {
            self.learn([to, from], [localised_to, localised_from]);
        } else {
            self.learn([from, to], [localised_from, localised_to]);
        }
    }

    /// Learns from two localised keyframes, the later one second.
    fn learn(&mut self, odometry: [&Pose; 2], localised: [&Pose; 2]) {
        let odometer = odometry[0].inverse().compose(odometry[1]);
        let map = localised[0].inverse().compose(localised[1]);
        let path = odometer.translation.norm();
        if !(FLOOR_M..=MEMORY_M).contains(&path) {
            return;
        }
        let scale = map.translation.dot(&odometer.translation) / (path * path);
        let drift = (odometer.rotation.inverse() * map.rotation).scaled_axis().z / path;
        let outlandish = (scale - 1.0).abs() > 0.2 || drift.abs() > 0.2;
        if outlandish || !scale.is_finite() || !drift.is_finite() {
            return;
        }
        // A step is measured to a centimetre and half a degree; the priors weigh as many metres as would know as
        // much.
        let fade = (-path / MEMORY_M).exp();
        let known = self.known_m * fade;
        let (scale_prior, drift_prior) = (0.01 / SCALE_PRIOR, 0.008 / DRIFT_PRIOR);
        let mix = |old: f64, new: f64, prior: f64| {
            (old * (known + prior) + new * path) / (known + path + prior)
        };
        self.scale = mix(self.scale, scale, scale_prior);
        self.drift_rad_per_m = mix(self.drift_rad_per_m, drift, drift_prior);
        self.known_m = known + path;
    }
}

/// Variances of a step along and about the vehicle's axes.
fn step_noise(step: &Pose, params: &LocalisationParams) -> (Vector3<f64>, Vector3<f64>) {
    let path = step.translation.norm();
    let turn = step.rotation.angle();
    let share = params.odometry.share_of_guess();
    let along = FLOOR_M + share * path;
    let across = FLOOR_M + params.odometry_yaw_rad_per_m * path;
    let up = FLOOR_M + params.tilt_rad_per_m * path;
    let tilt = FLOOR_RAD + params.tilt_rad_per_m * path;
    let yaw = FLOOR_RAD + params.odometry_yaw_rad_per_m * path + share * turn;
    let square = |sigmas: [f64; 3]| Vector3::from(sigmas.map(|sigma| sigma * sigma));
    (square([along, across, up]), square([tilt, tilt, yaw]))
}
