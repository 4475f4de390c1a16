//! Inertial measurements: how a vehicle turns, and what acceleration it feels.

use crate::roles::role::fullest;
use crate::roles::{FromMessage, Message, Messages, Role};
use crate::{Stamp, record};

record! {
    /// One measurement of an IMU. Messages that say that they lack rates of turn or accelerations give no row.
    #[layer("imu", key(site, session, stamp))]
    pub struct ImuMeasurement {
        /// Site that the session belongs to.
        site: String,
        /// Session that the measurement belongs to.
        session: String,
        /// Instant of the measurement.
        stamp: Stamp ["ns"],
        /// Topic that the measurement was recorded on.
        topic: String,
        /// The frame that the sensor measures in; empty where the log does not say it.
        frame: String,
        /// Rate of turn about the sensor's x axis.
        angular_velocity_x_radps: f64 ["rad/s", "sensor"],
        /// Rate of turn about the sensor's y axis.
        angular_velocity_y_radps: f64 ["rad/s", "sensor"],
        /// Rate of turn about the sensor's z axis.
        angular_velocity_z_radps: f64 ["rad/s", "sensor"],
        /// Acceleration along the sensor's x axis as it is felt, gravity's reaction included: at rest, all of it points up.
        linear_acceleration_x_mps2: f64 ["m/s²", "sensor"],
        /// Acceleration along the sensor's y axis.
        linear_acceleration_y_mps2: f64 ["m/s²", "sensor"],
        /// Acceleration along the sensor's z axis.
        linear_acceleration_z_mps2: f64 ["m/s²", "sensor"],
    }
}

/// The one topic of an IMU: the faster one of two sensors, or of two rates of one.
pub const ROLE: Role = Role::of::<ImuMeasurement>(Messages {
    choose: fullest,
    single: true,
    ..Messages::of::<ImuMeasurement>(&["sensor_msgs/Imu"])
});

/// The first entry of a covariance whose quantity is not measured.
const ABSENT: f64 = -1.0;

impl FromMessage for ImuMeasurement {
    const MEMBERS: &'static [&'static str] = &[
        "header",
        "angular_velocity",
        "angular_velocity_covariance",
        "linear_acceleration",
        "linear_acceleration_covariance",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let fields = &message.fields;
        let absent = |name: &str| fields.numbers(&[name]).first() == Some(&ABSENT);
        if absent("angular_velocity_covariance") || absent("linear_acceleration_covariance") {
            return Ok(Vec::new());
        }
        let number = |member: &str, axis: &str| {
            let found = fields
                .number(&[member, axis])
                .filter(|found| found.is_finite());
            found.ok_or(format!("expected a finite number as {member}.{axis}"))
        };
        let turn = |axis| number("angular_velocity", axis);
        let felt = |axis| number("linear_acceleration", axis);
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp()?,
            topic: message.topic.to_owned(),
            frame: message.frame(),
            angular_velocity_x_radps: turn("x")?,
            angular_velocity_y_radps: turn("y")?,
            angular_velocity_z_radps: turn("z")?,
            linear_acceleration_x_mps2: felt("x")?,
            linear_acceleration_y_mps2: felt("y")?,
            linear_acceleration_z_mps2: felt("z")?,
        }])
    }
}
