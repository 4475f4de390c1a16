//! Rotations and rigid motions with their Jacobians.
