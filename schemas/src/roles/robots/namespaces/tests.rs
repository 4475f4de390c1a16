use super::*;
use crate::roles::{frames, gnss_fixes};

const ODOMETRY: &str = "nav_msgs/msg/Odometry";
const IMAGE: &str = "sensor_msgs/msg/CompressedImage";
const TF: &str = "tf2_msgs/msg/TFMessage";
const FIX: &str = "sensor_msgs/msg/NavSatFix";

fn topics(all: &[(&str, &str, u64)]) -> Vec<Topic> {
    let all = all.iter();
    all.map(|(name, kind, messages)| Topic::new(name, kind, *messages))
        .collect()
}

/// Two robots of which the second one speaks more, and the first one alone has transforms.
static TWO: [(&str, &str, u64); 6] = [
    ("/r1/cam/image", IMAGE, 9),
    ("/r1/odom", ODOMETRY, 90),
    ("/r1/tf_static", TF, 1),
    ("/r2/cam/image", IMAGE, 9),
    ("/r2/odom", ODOMETRY, 99),
    ("/fix", FIX, 5),
];

fn names(robots: &Namespaces) -> Vec<String> {
    robots.odometry().into_keys().collect()
}

#[test]
fn robots_have_odometry_and_topics_that_are_called_alike() {
    let two = ["/r1/", "/r2/"];
    assert_eq!(names(&Namespaces::of(&topics(&TWO))), two);
    let none: [&[(&str, &str, u64)]; 6] = [
        &TWO[..4],
        // Odometry beside them may be anybody's.
        &[TWO[0], TWO[1], TWO[3], TWO[4], ("/odom", ODOMETRY, 1)],
        // A camera with odometry, and wheels.
        &[TWO[0], TWO[1], ("/wheels/odom", ODOMETRY, 9)],
        &[TWO[0], TWO[1], TWO[4], ("/r2/rear/image", IMAGE, 9)],
        // Nobody spoke of one.
        &[TWO[0], TWO[1], TWO[3], ("/r2/odom", ODOMETRY, 0)],
        &[],
    ];
    for topics_of in none {
        assert_eq!(
            Namespaces::of(&topics(topics_of)),
            Namespaces::default(),
            "{topics_of:?}"
        );
    }
    let third = [&TWO[..], &[("/gps/odom", ODOMETRY, 999)]].concat();
    assert_eq!(names(&Namespaces::of(&topics(&third))), two);
    let fleet = [
        ("/fleet/rö/image", IMAGE, 1),
        ("/fleet/rö/wheel/odom", ODOMETRY, 1),
        ("/fleet/rö/vio/odom", ODOMETRY, 2),
        ("/fleet/rü/image", IMAGE, 1),
        ("/fleet/rü/wheel/odom", ODOMETRY, 1),
    ];
    let fleet = Namespaces::of(&topics(&fleet));
    assert_eq!(names(&fleet), ["/fleet/rö/", "/fleet/rü/"]);
    assert_eq!(fleet.odometry()["/fleet/rö/"], "/fleet/rö/vio/odom");
    assert_eq!(fleet.of_topic("/fleet/rü/x/y"), Some("/fleet/rü/"));
    assert_eq!(fleet.of_topic("/fleet/rü"), None);
}

#[test]
fn the_one_with_most_roles_is_read_with_what_is_nobodys() {
    let third = [&TWO[..], &[("/gps/odom", ODOMETRY, 999)]].concat();
    let topics = topics(&third);
    let robots = Namespaces::of(&topics);
    assert_eq!(robots.usual(), Some("/r1/"));
    let read = |namespace: &str, role: &Role| {
        let choices = robots.infer(namespace, role, &topics).into_iter();
        choices.map(|choice| choice.topic).collect::<Vec<_>>()
    };
    assert_eq!(read("/r1/", &odometry::ROLE), ["/r1/odom"]);
    assert_eq!(read("/r1/", &frames::ROLE), ["/r1/cam/image"]);
    assert_eq!(read("/r1/", &gnss_fixes::ROLE), ["/fix"]);
    assert_eq!(read("/r2/", &odometry::ROLE), ["/r2/odom"]);
    assert!(read("/r2/", &transforms::ROLE).is_empty());
    let note = "topics of several robots would do: those behind /r1 are read, and none behind /r2; say which one is the \
                vehicle in a session manifest: `roles: { odometry: /r2/odom }`";
    assert_eq!(robots.note("/r1/"), note);
}

#[test]
fn frames_that_all_share_are_of_robots_where_prefixes_tell_them_apart() {
    let shared = [&TWO[..2], &TWO[3..5], &[("/tf", TF, 9)]].concat();
    let mut robots = Namespaces::of(&topics(&shared));
    assert!(robots.may_be_one());
    robots.name("/r1/", "a/base_link".to_owned());
    assert!(robots.may_be_one());
    robots.name("/r2/", "b/base_link".to_owned());
    assert!(!robots.may_be_one());
    assert!(robots.choice("/r2/").contains("vehicle_frame: b/base_link"));
    assert!(!Namespaces::of(&topics(&TWO)).may_be_one());
}

#[test]
fn topics_of_another_robot_are_strays_where_the_vehicle_has_such() {
    let topics = topics(&TWO);
    let mut robots = Namespaces::of(&topics);
    let played = |topics: &[&str]| -> Vec<String> {
        let topics = topics.iter();
        topics.map(|topic| (*topic).to_owned()).collect()
    };
    let (own, other) = (played(&["/r1/cam/image"]), played(&["/r2/cam/image"]));
    let both = [own.clone(), other.clone()].concat();
    let stray = |robots: &Namespaces, played: &[String]| {
        let stray = robots.stray("/r1/", &frames::ROLE, played, &topics);
        stray.map(|stray| [stray.topic.to_owned(), stray.own])
    };
    let found = Some(["/r2/cam/image", "/r1/cam/image"].map(str::to_owned));
    assert_eq!(stray(&robots, &own), None);
    assert_eq!(stray(&robots, &other), found);
    assert_eq!(stray(&robots, &both), found);
    // The second one has no transforms.
    let transforms = played(&["/r1/tf_static"]);
    assert_eq!(
        robots.stray("/r2/", &transforms::ROLE, &transforms, &topics),
        None
    );
    for (namespace, frame) in [("/r1/", "a/base_link"), ("/r2/", "b/base_link")] {
        robots.name(namespace, frame.to_owned());
    }
    assert_eq!(stray(&robots, &both), None);
    assert_eq!(stray(&robots, &other), found);
}
