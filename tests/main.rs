//! Tests of the whole program, a module for each of its sides. They are one binary, so that datafusion is linked once and
//! short tests run beside long ones: `cargo test --test end_to_end metric_map` runs those of one.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr
)]

mod arrows;
mod cameras;
mod cluster;
mod concurrent;
mod exports;
mod first_hour;
mod hostile;
mod inspect;
mod labels;
mod lifecycle;
mod lifelong;
mod messages;
mod metric_map;
mod mistakes;
mod object_store;
mod odometry;
mod plans;
mod python;
mod python_steps;
mod queries;
mod real_logs;
mod semantic_map;
mod serve;
mod sound;
mod stable_map;
mod stamps;
mod stereo;
mod strangers_car_park;
mod video;
