//! The one small rigid motion of a keyframe that most of its hits agree on.

use nalgebra::{Matrix2x6, Matrix6, UnitQuaternion, Vector3, Vector6};

use super::point::{LineOfSight, Miss};
use crate::geometry::pose::Pose;

/// Steps; the first ones mostly decide which hits count.
const STEPS: usize = 10;
/// Standard deviation of what a keyframe may move: position (m) and orientation (rad). It only matters where there
/// are few hits, or all in one direction.
const MOTION_SIGMA: [f64; 2] = [0.5, 0.05];

/// What a camera of the vehicle saw of a point of the map.
pub(super) struct Resighting {
    /// The ray, in the vehicle's frame.
    pub(super) line: LineOfSight,
    /// The point, metres in the map.
    pub(super) point: Vector3<f64>,
    /// Scales the residual, pixels per radian.
    pub(super) px_per_rad: f64,
}

impl Resighting {
    /// Distance between ray and point, pixels at the middle of the image; `None` behind the camera.
    pub(super) fn residual_px(&self, vehicle_from_map: &Pose) -> Option<f64> {
        let angles = self.line.angles(&vehicle_from_map.transform(&self.point))?;
        Some(angles.norm() * self.px_per_rad)
    }

    /// Adds to the normal equations of a motion of the vehicle `[translation, rotation]` in its own frame.
    fn add(&self, vehicle_from_map: &Pose, scale_px: f64, sums: &mut (Matrix6<f64>, Vector6<f64>)) {
        let in_vehicle = vehicle_from_map.transform(&self.point);
        let Some(Miss { angles, by_point }) = self.line.miss(&in_vehicle) else {
            return;
        };
        let residual = angles * self.px_per_rad;
        let by_point = by_point * self.px_per_rad;
        let mut by_motion = Matrix2x6::zeros();
        by_motion.fixed_view_mut::<2, 3>(0, 0).copy_from(&-by_point);
        by_motion
            .fixed_view_mut::<2, 3>(0, 3)
            .copy_from(&(by_point * in_vehicle.cross_matrix()));
        // Cauchy, as hits that are wrong are many and arbitrarily far off.
        let weight = 1.0 / (1.0 + residual.norm_squared() / (scale_px * scale_px));
        sums.0 += by_motion.transpose() * by_motion * weight;
        sums.1 += by_motion.transpose() * residual * weight;
    }
}

/// The pose nearby that most resightings agree with. The loss is scaled from `from_px`, what poses are off by, down
/// to `to_px`, so that the first steps see all hits and the last only those that agree (graduated non-convexity).
pub(super) fn agreed_pose(
    resightings: &[Resighting],
    map_from_vehicle: &Pose,
    from_px: f64,
    to_px: f64,
) -> Pose {
    let mut pose = *map_from_vehicle;
    for step in 0..STEPS {
        let along = (step as f64 / (STEPS - 2) as f64).min(1.0);
        let scale_px = from_px.max(to_px) * (to_px / from_px.max(to_px)).powf(along);
        let mut sums = (prior(), Vector6::zeros());
        let vehicle_from_map = pose.inverse();
        for resighting in resightings {
            resighting.add(&vehicle_from_map, scale_px, &mut sums);
        }
        let Some(factors) = sums.0.cholesky() else {
            break;
        };
        let motion = -factors.solve(&sums.1);
        if !motion.iter().all(|x| x.is_finite()) {
            break;
        }
        pose = moved(&pose, &motion);
    }
    pose
}

fn prior() -> Matrix6<f64> {
    let [position, orientation] = MOTION_SIGMA.map(|sigma| 1.0 / (sigma * sigma));
    Matrix6::from_diagonal(&Vector6::new(
        position,
        position,
        position,
        orientation,
        orientation,
        orientation,
    ))
}

fn moved(pose: &Pose, motion: &Vector6<f64>) -> Pose {
    let translation = motion.fixed_rows::<3>(0).into_owned();
    let rotation = UnitQuaternion::from_scaled_axis(motion.fixed_rows::<3>(3).into_owned());
    pose.compose(&Pose::new(translation, rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points around a vehicle with two cameras, a third of them seen where they are not.
    fn resightings(truth: &Pose, wrong: impl Fn(usize) -> bool) -> Vec<Resighting> {
        let mounts = [
            Pose::new(
                Vector3::new(2.0, 0.0, 1.0),
                UnitQuaternion::from_euler_angles(-1.6, 0.0, -1.5),
            ),
            Pose::new(
                Vector3::new(1.0, 1.0, 1.0),
                UnitQuaternion::from_euler_angles(-1.5, 0.1, 0.1),
            ),
        ];
        (0..90)
            .map(|at| {
                let turn = at as f64 * 0.7;
                let out = 3.0 + (at % 7) as f64;
                let point = truth.transform(&Vector3::new(
                    out * turn.cos(),
                    out * turn.sin(),
                    (at % 5) as f64,
                ));
                let camera = mounts[at % 2];
                let seen = truth.compose(&camera).inverse().transform(&point);
                let off = if wrong(at) { 0.08 } else { 0.0 };
                let ray = (seen.normalize() + Vector3::new(off, -off, off)).normalize();
                Resighting {
                    line: LineOfSight::new(&camera, &ray),
                    point,
                    px_per_rad: 127.0,
                }
            })
            .collect()
    }

    #[test]
    fn the_truth_is_found_among_wrong_hits() {
        let truth = Pose::from_yaw(4.0, 1.0, 0.7);
        let guess = Pose::from_yaw(4.2, 0.85, 0.72);
        let seen = resightings(&truth, |at| at % 3 == 0);
        let found = agreed_pose(&seen, &guess, 12.0, 1.5);
        assert!(
            (found.translation - truth.translation).norm() < 0.02,
            "{found:?}"
        );
        assert!(
            found.rotation.angle_to(&truth.rotation) < 0.004,
            "{found:?}"
        );
        let near = |seen: &Resighting| {
            let off_px = seen.residual_px(&found.inverse());
            off_px.is_some_and(|off_px| off_px < 3.0)
        };
        let agree = seen.iter().enumerate();
        let agree = agree.filter(|(at, seen)| near(seen) == (at % 3 != 0));
        assert_eq!(agree.count(), 90);
    }

    #[test]
    fn without_hits_nothing_moves() {
        let pose = Pose::from_yaw(4.0, 1.0, 0.7);
        let found = agreed_pose(&[], &pose, 12.0, 1.5);
        assert!((found.translation - pose.translation).norm() < 1e-12);
    }
}
