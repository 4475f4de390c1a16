//! A rig's pose from points and rays, with outliers.
