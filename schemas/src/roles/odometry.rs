//! Odometry: where the vehicle thinks it is, drifting.

use std::cmp::Reverse;

use crate::roles::transforms::{self, Transform};
use crate::roles::{Choice, FromMessage, Message, Messages, Motion, Role, Topic, in_words};
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
const POSES: &[&str] = &[
    "foxglove.PoseInFrame",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/PoseWithCovarianceStamped",
];

/// Words in the names of topics whose poses are where the vehicle shall go, or was put.
const WISHES: &[&str] = &["goal", "target", "initial"];

/// The one topic with wheel or visual odometry; of transforms, those of one robot.
pub const ROLE: Role = Role::of::<OdometryPose>(Messages {
    choose,
    single: true,
    robots: Some(&ROBOTS),
    vehicle: Some(&VEHICLE),
    ..Messages::of::<OdometryPose>(TYPES)
});

const ROBOTS: Messages = Messages::of::<Motion>(transforms::TYPES);

const VEHICLE: Messages = Messages::of::<Motion>(&[ODOMETRY]);

const TYPES: &[&str] = &[
    ODOMETRY,
    POSES[0],
    POSES[1],
    POSES[2],
    transforms::TYPES[0],
    transforms::TYPES[1],
    transforms::TYPES[2],
    transforms::TYPES[3],
];

/// One `nav_msgs/Odometry` topic: `/odom` if there is one that has messages, else that with most messages, else the first by name. Where
/// there is none, a topic of poses whose name speaks of odometry; where there is none either, `/tf` likewise; at last a
/// topic of other poses, but of goals.
fn choose(topics: &[Topic]) -> Vec<Choice> {
    let odometry = |topic: &&Topic| topic.message_type == ODOMETRY;
    let poses = |topic: &&Topic| {
        POSES.contains(&topic.message_type.as_str()) && in_words(&topic.name, &["odom"])
    };
    let moving = |topic: &&Topic| {
        transforms::TYPES.contains(&topic.message_type.as_str())
            && !transforms::is_static(&topic.name)
    };
    let other_poses = |topic: &&Topic| {
        POSES.contains(&topic.message_type.as_str()) && !in_words(&topic.name, WISHES)
    };
    let kinds: [&dyn Fn(&&Topic) -> bool; 4] = [&odometry, &poses, &moving, &other_poses];
    let kind = kinds
        .into_iter()
        .find(|kind| topics.iter().any(|topic| kind(&topic)));
    let mut candidates: Vec<&Topic> = match kind {
        Some(kind) => topics.iter().filter(kind).collect(),
        None => Vec::new(),
    };
    candidates.sort_by_key(|topic| {
        let plain = ["odom", "tf"].contains(&topic.name.trim_start_matches('/'));
        let silent = topic.messages == 0;
        (silent, !plain, Reverse(topic.messages), &topic.name)
    });
    Choice::first_of(candidates).into_iter().collect()
}

impl FromMessage for OdometryPose {
    const MEMBERS: &'static [&'static str] = &[
        "header",
        "timestamp",
        "pose",
        "twist",
        "transforms",
        "parent_frame_id",
        "child_frame_id",
        "translation",
        "rotation",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        if let Some(transforms) = transforms::all(message) {
            // Another transform that makes no sense is the business of the role that reads them all.
            let sound = transforms.into_iter().flatten();
            let found = sound.filter(|found| message.robot.is(&found.parent, &found.child));
            return Ok(found
                .map(|found| Self::of_transform(message, found))
                .collect());
        }
        if let Some(stray) = message.robot.stray(&Motion::of_odometry(message)) {
            return Err(stray);
        }
        let fields = &message.fields;
        // nav_msgs/Odometry and PoseWithCovarianceStamped have a pose with covariance, PoseStamped and PoseInFrame a plain one.
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
            stamp: message.stamp()?,
            topic: message.topic.to_owned(),
            odom_from_vehicle: pose?,
            speed_mps: twist(["linear", "x"]),
            yaw_rate_radps: twist(["angular", "z"]),
        }])
    }
}

impl OdometryPose {
    fn of_transform(message: &Message<'_>, transform: Transform) -> Self {
        Self {
            site: transform.site,
            session: transform.session,
            stamp: transform.stamp,
            topic: message.topic.to_owned(),
            odom_from_vehicle: transform.parent_from_child,
            speed_mps: None,
            yaw_rate_radps: None,
        }
    }
}
