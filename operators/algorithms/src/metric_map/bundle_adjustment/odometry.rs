//! Terms without landmarks: wheel odometry.
//!
//! With `Δ` the measured motion of translation `d` and rotation `M`, `s` the session's scale, `b`
//! its yaw drift and `ℓ` the driven length, the residual of a step from pose `i` to pose `j` is
//!
//! ```text
//! r_t = Rᵢᵀ (tⱼ - tᵢ) / s - Rz(b ℓ / 2) d        translation, along the axes of i
//! r_R = Log( (M Rz(b ℓ))ᵀ Rᵢᵀ Rⱼ )               rotation
//! ```
//!
//! divided by the standard deviations axis by axis. The motion is divided by the scale, and not the measurement
//! multiplied: where one camera leaves the scale open, a smaller world would otherwise have smaller residuals, and
//! shrink. A drift that builds up evenly turns the chord
//! by half of what it turns the end, hence `b ℓ / 2`.

use nalgebra::{Matrix6, SMatrix, UnitQuaternion, Vector3, Vector6};

use super::{Odometry, SessionState};
use crate::geometry::lie::{hat, se3, so3};
use crate::geometry::pose::Pose;

/// Residual of a step and its derivatives by both poses and by (scale, yaw drift).
pub(super) struct StepLinear {
    pub(super) residual: Vector6<f64>,
    pub(super) from: Matrix6<f64>,
    pub(super) to: Matrix6<f64>,
    pub(super) session: SMatrix<f64, 6, 2>,
}

fn about_z(angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
}

/// The residual, in standard deviations.
pub(super) fn residual(
    step: &Odometry,
    from: &Pose,
    to: &Pose,
    session: &SessionState,
) -> Vector6<f64> {
    let motion = from.inverse().compose(to);
    let turn = session.odometry_yaw_rad_per_m * step.length_m;
    let measured = &step.from_from_to;
    let chord = about_z(0.5 * turn) * measured.translation;
    let rotation = (measured.rotation * about_z(turn)).inverse() * motion.rotation;
    let moved = motion.translation / session.odometry_scale;
    let residual = se3::join(&(moved - chord), &so3::log(&rotation));
    residual.component_div(&Vector6::from(step.sigma))
}

/// The residual with its derivatives.
pub(super) fn linearise(
    step: &Odometry,
    from: &Pose,
    to: &Pose,
    session: &SessionState,
) -> StepLinear {
    let motion = from.inverse().compose(to);
    let turn = session.odometry_yaw_rad_per_m * step.length_m;
    let chord = about_z(0.5 * turn) * step.from_from_to.translation;
    let whitened = residual(step, from, to, session);
    let sigma = Vector6::from(step.sigma);
    let (_, angle) = se3::split(&whitened.component_mul(&sigma));
    let r = motion.rotation.to_rotation_matrix().into_inner();
    let inverse = so3::right_jacobian_inverse(&angle);
    let shrink = 1.0 / session.odometry_scale;

    let mut from = Matrix6::zeros();
    from.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&-nalgebra::Matrix3::from_diagonal_element(shrink));
    from.fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(hat(&motion.translation) * shrink));
    from.fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&-(inverse * r.transpose()));
    let mut to = Matrix6::zeros();
    to.fixed_view_mut::<3, 3>(0, 0).copy_from(&(r * shrink));
    to.fixed_view_mut::<3, 3>(3, 3).copy_from(&inverse);
    let mut of_session = SMatrix::<f64, 6, 2>::zeros();
    let by_scale = -motion.translation * (shrink * shrink);
    let half = 0.5 * step.length_m;
    let by_yaw = -Vector3::z().cross(&chord) * half;
    let by_turn = -(so3::left_jacobian_inverse(&angle) * Vector3::z() * step.length_m);
    for axis in 0..3 {
        of_session[(axis, 0)] = by_scale[axis];
        of_session[(axis, 1)] = by_yaw[axis];
        of_session[(axis + 3, 1)] = by_turn[axis];
    }
    for axis in 0..6 {
        from.row_mut(axis).scale_mut(1.0 / sigma[axis]);
        to.row_mut(axis).scale_mut(1.0 / sigma[axis]);
        of_session.row_mut(axis).scale_mut(1.0 / sigma[axis]);
    }
    StepLinear {
        residual: whitened,
        from,
        to,
        session: of_session,
    }
}
