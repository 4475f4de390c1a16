//! Rigid transforms, with the two habits that keep them safe.
//!
//! Every pose column in the map is seven numbers `[x, y, z, qx, qy, qz, qw]` that somebody else
//! wrote. They are checked once, at the door: a quaternion of zero length or a NaN is an error,
//! every other quaternion is normalised. Inside, a [`Pose`] is always a proper rigid motion.
//!
//! Names read from right to left: `map_from_vehicle.transform(p)` takes a point of the vehicle
//! frame and gives it in the map frame, and `map_from_vehicle.compose(&vehicle_from_camera)` is
//! `map_from_camera`, so a chain cancels by eye.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::lie::se3;

/// A quaternion shorter than this has no direction worth trusting.
const MIN_QUATERNION_NORM: f64 = 1e-6;

/// A rigid transform: rotation first, then translation (metres).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position of the right-hand frame's origin in the left-hand frame, metres.
    pub translation: Vector3<f64>,
    /// Orientation of the right-hand frame in the left-hand frame.
    pub rotation: UnitQuaternion<f64>,
}

/// Why seven numbers are not a pose.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// A component is NaN or infinite.
    #[error("expected seven finite numbers [x, y, z, qx, qy, qz, qw], found {found:?}")]
    NotFinite {
        /// What was given.
        found: [f64; 7],
    },
    /// The quaternion has (nearly) zero length, so it names no rotation.
    #[error(
        "expected a unit quaternion [qx, qy, qz, qw], found one of length {norm:e}; an all-zero \
         quaternion usually means the field was never filled in"
    )]
    NoRotation {
        /// Length of the quaternion given.
        norm: f64,
    },
}

impl Pose {
    /// The transform that changes nothing.
    pub fn identity() -> Self {
        Self {
            translation: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
        }
    }

    /// From parts.
    pub fn new(translation: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Self {
        Self {
            translation,
            rotation,
        }
    }

    /// From `[x, y, z, qx, qy, qz, qw]` (metres; quaternion of any length but zero).
    ///
    /// # Errors
    /// [`PoseError`] when a number is not finite or the quaternion has no length.
    pub fn from_array(found: [f64; 7]) -> Result<Self, PoseError> {
        if found.iter().any(|value| !value.is_finite()) {
            return Err(PoseError::NotFinite { found });
        }
        let [x, y, z, qx, qy, qz, qw] = found;
        let quaternion = Quaternion::new(qw, qx, qy, qz);
        let norm = quaternion.norm();
        if !norm.is_finite() || norm < MIN_QUATERNION_NORM {
            return Err(PoseError::NoRotation { norm });
        }
        // A quaternion that is already a unit to the last bits is kept as it is, so that writing
        // a pose and reading it back gives the same bytes.
        let rotation = if (norm - 1.0).abs() <= 4.0 * f64::EPSILON {
            UnitQuaternion::new_unchecked(quaternion)
        } else {
            UnitQuaternion::new_normalize(quaternion)
        };
        Ok(Self::new(Vector3::new(x, y, z), rotation))
    }

    /// As `[x, y, z, qx, qy, qz, qw]`.
    pub fn to_array(&self) -> [f64; 7] {
        let (t, q) = (&self.translation, self.rotation.quaternion());
        [t.x, t.y, t.z, q.i, q.j, q.k, q.w]
    }

    /// A planar pose: `x`, `y` in metres, `yaw` in radians, counter-clockwise about z.
    pub fn from_yaw(x: f64, y: f64, yaw: f64) -> Self {
        Self::new(
            Vector3::new(x, y, 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        )
    }

    /// Heading of the x axis in the xy plane, radians in (-π, π]; 0 when it points straight up
    /// or down.
    pub fn yaw(&self) -> f64 {
        let forward = self.rotation * Vector3::x();
        forward.y.atan2(forward.x)
    }

    /// `a_from_b.compose(&b_from_c)` is `a_from_c`.
    pub fn compose(&self, right: &Pose) -> Pose {
        // Renormalised, so that a chain of a million odometry steps stays a rotation.
        let rotation = (self.rotation * right.rotation).into_inner();
        Pose::new(
            self.translation + self.rotation * right.translation,
            UnitQuaternion::new_normalize(rotation),
        )
    }

    /// `a_from_b.inverse()` is `b_from_a`.
    pub fn inverse(&self) -> Pose {
        let rotation = self.rotation.inverse();
        Pose::new(-(rotation * self.translation), rotation)
    }

    /// A point of the right-hand frame, expressed in the left-hand frame (metres).
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// A direction of the right-hand frame, expressed in the left-hand frame.
    pub fn rotate(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * direction
    }

    /// The pose a fraction `t` of the way from `self` (0) to `other` (1), moving with a constant twist: straight where
    /// the two are turned alike, along an arc (in general a helix) by the shorter turn where not, as vehicles drive. `t`
    /// outside [0, 1] extrapolates.
    pub fn interpolate(&self, other: &Pose, t: f64) -> Pose {
        se3::plus(self, &(se3::minus(other, self) * t))
    }

    /// The pose at `stamp` (ns) between two stamped poses; the nearer one when `stamp` lies
    /// outside them, and the first when both carry the same stamp.
    pub fn at_stamp(stamp: i64, before: (i64, &Pose), after: (i64, &Pose)) -> Pose {
        let span = after.0.saturating_sub(before.0);
        if span <= 0 || stamp <= before.0 {
            return *before.1;
        }
        if stamp >= after.0 {
            return *after.1;
        }
        let t = stamp.saturating_sub(before.0) as f64 / span as f64;
        before.1.interpolate(after.1, t)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = Pose> {
        (
            prop::array::uniform3(-100.0..100.0f64),
            prop::array::uniform3(-3.0..3.0f64),
        )
            .prop_map(|(t, r)| {
                Pose::new(
                    Vector3::from(t),
                    UnitQuaternion::from_scaled_axis(Vector3::from(r)),
                )
            })
    }

    fn distance(a: &Pose, b: &Pose) -> f64 {
        (a.translation - b.translation).norm() + a.rotation.angle_to(&b.rotation)
    }

    proptest! {
        #[test]
        fn inverse_undoes(pose in poses()) {
            prop_assert!(distance(&pose.compose(&pose.inverse()), &Pose::identity()) < 1e-9);
        }

        #[test]
        fn composing_is_transforming_twice(
            a in poses(), b in poses(), p in prop::array::uniform3(-9.0..9.0f64)
        ) {
            let p = Vector3::from(p);
            let once = a.compose(&b).transform(&p);
            prop_assert!((once - a.transform(&b.transform(&p))).norm() < 1e-9);
        }

        #[test]
        fn seven_numbers_round_trip_to_the_bit(pose in poses()) {
            let written = pose.to_array();
            let read = Pose::from_array(written).unwrap().to_array();
            for (a, b) in written.iter().zip(read) {
                prop_assert!((a - b).abs() <= 1e-15 * a.abs().max(1.0));
            }
            prop_assert_eq!(Pose::from_array(read).unwrap().to_array(), read);
        }

        #[test]
        fn interpolation_keeps_its_ends_and_its_rate(a in poses(), b in poses(), t in 0.0..1.0f64) {
            prop_assert!(distance(&a.interpolate(&b, 0.0), &a) < 1e-7);
            prop_assert!(distance(&a.interpolate(&b, 1.0), &b) < 1e-7);
            let turned = a.rotation.angle_to(&a.interpolate(&b, t).rotation);
            prop_assert!((turned - t * a.rotation.angle_to(&b.rotation)).abs() < 1e-6);
        }

        #[test]
        fn any_seven_numbers_are_a_pose_or_an_error(found in prop::array::uniform7(any::<f64>())) {
            if let Ok(pose) = Pose::from_array(found) {
                prop_assert!((pose.rotation.norm() - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn half_turns_and_nonsense() {
        let a = Pose::from_yaw(0.0, 0.0, 0.0);
        let b = Pose::from_yaw(2.0, 0.0, std::f64::consts::PI);
        let middle = a.interpolate(&b, 0.5);
        assert!((middle.yaw().abs() - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
        assert!(Pose::from_array([0.0; 7]).is_err());
        assert!(Pose::from_array([0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0, 1.0]).is_err());
        assert!(Pose::from_array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -7.0]).is_ok());
    }

    #[test]
    fn between_two_poses_of_a_bend_lies_the_bend() {
        let bend = |yaw: f64| Pose::from_yaw(8.0 * yaw.sin(), 8.0 * (1.0 - yaw.cos()), yaw);
        for t in [0.0, 0.3, 0.5, 1.0, 1.4] {
            let found = bend(0.2).interpolate(&bend(1.4), t);
            assert!(
                distance(&found, &bend(0.2 + 1.2 * t)) < 1e-9,
                "{t}: {found:?}"
            );
        }
    }

    #[test]
    fn stamps_outside_stay_at_the_ends() {
        let (a, b) = (Pose::from_yaw(0.0, 0.0, 0.0), Pose::from_yaw(1.0, 0.0, 0.0));
        let x = |stamp| Pose::at_stamp(stamp, (10, &a), (20, &b)).translation.x;
        assert_eq!(
            [x(i64::MIN), x(10), x(15), x(20), x(i64::MAX)],
            [0.0, 0.0, 0.5, 1.0, 1.0]
        );
        assert_eq!(Pose::at_stamp(10, (10, &a), (10, &b)), a);
    }
}
