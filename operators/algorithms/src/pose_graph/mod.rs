//! Odometry and loops relaxed into consistent poses.
