//! Odometry: where the vehicle thinks it is, drifting.

use std::cmp::Reverse;

use crate::roles::{Choice, FromMessage, Message, Messages, Role, Topic, in_words};
use crate::{Pose, Stamp, record};

record! {
    /// One odometry message: the vehicle in the drifting odometry frame.
    #[layer("odometry", key(site, session, stamp))]
    pub struct OdometryPose {
        /// Site that the session belongs to.
        site: String,
        /// Session that the pose belongs to.
        session: String,
        /// Instant of the pose.
        stamp: Stamp ["ns"],
        /// Topic that the pose was recorded on.
        topic: String,
        /// The vehicle in the drifting odometry frame.
        odom_from_vehicle: Pose ["", "odom"],
        /// Speed along the vehicle's x axis; null where the log does not say it.
        speed_mps: Option<f64> ["m/s", "vehicle"],
        /// Rate of turn about the vehicle's z axis; null where the log does not say it.
        yaw_rate_radps: Option<f64> ["rad/s", "vehicle"],
    }
}

const ODOMETRY: &str = "nav_msgs/Odometry";

/// The one topic with wheel or visual odometry.
pub const ROLE: Role = Role::of::<OdometryPose>(Messages {
    choose,
    single: true,
    ..Messages::of::<OdometryPose>(&[
        ODOMETRY,
        "foxglove.PoseInFrame",
        "geometry_msgs/PoseStamped",
    ])
});

/// One `nav_msgs/Odometry` topic: `/odom` if there is one, else that with most messages, else the first by name. Where
/// there is none, a topic of poses whose name speaks of odometry.
fn choose(topics: &[Topic]) -> Vec<Choice> {
    let (odometry, poses): (Vec<&Topic>, Vec<&Topic>) = topics
        .iter()
        .partition(|topic| topic.message_type == ODOMETRY);
    let named = |topic: &&Topic| in_words(&topic.name, &["odom"]);
    let mut candidates: Vec<&Topic> = match odometry.is_empty() {
        true => poses.into_iter().filter(named).collect(),
        false => odometry,
    };
    candidates.sort_by_key(|topic| {
        let plain = topic.name.trim_start_matches('/') == "odom";
        (!plain, Reverse(topic.messages), &topic.name)
    });
    Choice::first_of(candidates).into_iter().collect()
}

impl FromMessage for OdometryPose {
    const MEMBERS: &'static [&'static str] = &["header", "timestamp", "pose", "twist"];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let fields = &message.fields;
        // nav_msgs/Odometry has a pose with covariance, PoseStamped and PoseInFrame a plain one.
        let nested = fields.number(&["pose", "pose", "position", "x"]).is_some();
        let pose = match nested {
            true => fields.pose(
                &["pose", "pose", "position"],
                &["pose", "pose", "orientation"],
            ),
            false => fields.pose(&["pose", "position"], &["pose", "orientation"]),
        };
        let twist = |[kind, axis]: [&str; 2]| {
            let covariant = fields.number(&["twist", "twist", kind, axis]);
            let found = covariant.or_else(|| fields.number(&["twist", kind, axis]));
            found.filter(|number| number.is_finite())
        };
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp(),
            topic: message.topic.to_owned(),
            odom_from_vehicle: pose?,
            speed_mps: twist(["linear", "x"]),
            yaw_rate_radps: twist(["angular", "z"]),
        }])
    }
}
