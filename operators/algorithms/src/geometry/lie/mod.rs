//! Rotations and rigid motions with their Jacobians.
//!
//! An optimiser needs to move a pose by a small vector and to know what that does to a residual.
//! One convention serves the whole crate:
//!
//! > **A pose `a_from_b` is moved in its own, right-hand frame:
//! > `a_from_b ⊞ ξ = a_from_b · Exp(ξ)`, with `ξ = (ρ, φ)`, first the translation ρ (metres),
//! > then the rotation φ (radians), both along the axes of `b`.**
//!
//! So for a landmark `p` (frame a), `b_from_a · p = p_b` changes by `-ρ + [p_b]× φ`, and a 6×6
//! covariance or information matrix of a pose has translation in its first three rows. One along
//! the axes of `a` instead is turned by [`se3::covariance_along_right`].
//!
//! | module | group | tangent |
//! |---|---|---|
//! | [`so3`] | rotations, [`nalgebra::UnitQuaternion`] | φ, 3 |
//! | [`se3`] | rigid motions, [`crate::geometry::pose::Pose`] | (ρ, φ), 6 |
//!
//! Every coefficient that is `0/0` at the identity is taken from its Taylor series below half a
//! radian; logarithms go through `atan2` of half the angle, which keeps all digits at half a
//! turn.
//!
//! Source: Solà, Deray, Atchuthan, *A micro Lie theory for state estimation in robotics* (2018);
//! Barfoot, *State Estimation for Robotics* (2017), section 7.1.

pub mod coefficients;
pub mod se3;
pub mod so3;

#[cfg(test)]
mod tests;

pub use so3::hat;
