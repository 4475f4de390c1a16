//! The shape of the floor: two planes that fall towards a drain between them.
//!
//! A floor that is flat everywhere would hide every mistake a map makes in height, roll and pitch.

use crate::plane::Pose2;
use evermap_algorithms::geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};

/// Distance between the axles, metres.
const WHEELBASE_M: f64 = 2.6;
/// Distance between the wheels of an axle, metres.
pub(super) const TRACK_M: f64 = 1.55;

/// A floor hinged along a line of constant y, where it is lowest (z = 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ground {
    /// Where the drain lies, metres.
    pub drain_y: f64,
    /// Rise per metre away from the drain.
    pub slope: f64,
}

impl Ground {
    /// Height of the floor, metres.
    pub fn height(&self, y: f64) -> f64 {
        self.slope * (y - self.drain_y).abs()
    }

    /// Turns upright things so that they stand on the floor at `y`.
    pub fn tilt(&self, y: f64) -> UnitQuaternion<f64> {
        let rise = self.slope * (y - self.drain_y).signum();
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), rise.atan())
    }

    /// Where a thing stands, tilted as the floor is.
    pub fn place(&self, pose: &Pose2) -> Pose {
        let upright = pose.upright(self.height(pose.y));
        Pose::new(upright.translation, self.tilt(pose.y) * upright.rotation)
    }

    /// `map_from_vehicle` of a vehicle on its four wheels; `pose` is below the middle of its rear axle.
    pub fn stand(&self, pose: &Pose2) -> Pose {
        let (sin, cos) = pose.yaw.sin_cos();
        let wheel = |ahead: f64, left: f64| self.height(pose.y + ahead * sin + left * cos);
        let half = 0.5 * TRACK_M;
        let [rear_left, rear_right] = [wheel(0.0, half), wheel(0.0, -half)];
        let [front_left, front_right] = [wheel(WHEELBASE_M, half), wheel(WHEELBASE_M, -half)];
        let rear = 0.5 * (rear_left + rear_right);
        let climb = (0.5 * (front_left + front_right) - rear) / WHEELBASE_M;
        let bank = 0.5 * (rear_left + front_left - rear_right - front_right) / TRACK_M;
        let upright = pose.upright(rear);
        let turned = upright.rotation
            * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -climb.atan())
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), bank.atan());
        Pose::new(upright.translation, turned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GROUND: Ground = Ground {
        drain_y: 10.0,
        slope: 0.015,
    };

    #[test]
    fn wheels_touch_the_floor_on_either_side_of_the_drain() {
        for (y, yaw) in [(3.0, 0.0), (3.0, 1.2), (18.0, -2.0), (16.0, 3.0)] {
            let pose = GROUND.stand(&Pose2::new([5.0, y], yaw));
            for (ahead, left) in [(0.0, 0.775), (0.0, -0.775), (2.6, 0.775), (2.6, -0.775)] {
                let wheel = pose.transform(&Vector3::new(ahead, left, 0.0));
                let gap = wheel.z - GROUND.height(wheel.y);
                assert!(gap.abs() < 1e-4, "{y} {yaw}: {gap}");
            }
            let up = GROUND.tilt(y) * Vector3::z();
            assert!(up.dot(&pose.rotate(&Vector3::z())) > 1.0 - 1e-7);
        }
    }

    #[test]
    fn heights_are_smooth_where_the_drain_is_crossed() {
        let at = |step: i32| {
            let y = 5.0 + 0.01 * f64::from(step);
            GROUND.stand(&Pose2::new([0.0, y], 1.57))
        };
        for step in 0..1000 {
            let (a, b) = (at(step), at(step + 1));
            assert!((a.translation.z - b.translation.z).abs() < 2e-4);
            assert!(a.rotation.angle_to(&b.rotation) < 3e-4);
        }
    }
}
