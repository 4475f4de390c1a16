#![allow(clippy::unwrap_used)]
use super::*;

/// Robots of which odometry moves these frames.
fn robots(frames: &[&str]) -> Robots {
    let mut robots = Robots::default();
    for frame in frames {
        let odom = match frame_names::split(frame).0 {
            "" => "odom".to_owned(),
            prefix => format!("{prefix}/odom"),
        };
        robots.add(&odom, frame);
    }
    robots
}

fn moving(motions: &[(&str, &str)]) -> Robots {
    let mut robots = Robots::default();
    let all = motions.iter();
    all.for_each(|(parent, child)| robots.add(parent, child));
    robots
}

fn robot(prefix: &str) -> Option<OdometryOf> {
    Some(OdometryOf::Robot(prefix.to_owned()))
}

fn frame(parent: &str, child: &str) -> Option<OdometryOf> {
    Some(odometry(&(parent.to_owned(), child.to_owned())))
}

#[test]
fn odometry_moves_a_base_in_an_odometry_frame_of_the_same_robot() {
    for (parent, child, robot) in [
        ("odom", "base_link", Some("")),
        ("/odom", "/base_footprint", Some("")),
        ("odom_combined", "base_link", Some("")),
        ("robot1/odom", "robot1/base_link", Some("robot1")),
        ("/fleet/a/odom", "fleet/a/base_footprint", Some("fleet/a")),
        ("odom", "robot1/base_link", None),
        ("robot1/odom", "robot2/base_link", None),
        ("map", "odom", None),
        ("robot1/base_link", "robot1/wheel", None),
    ] {
        assert_eq!(moved(parent, child), robot, "{parent} -> {child}");
    }
}

#[test]
fn the_robot_that_is_meant_is_named_plain_or_the_only_one() {
    assert_eq!(robots(&[]).meant("").unwrap(), None);
    assert_eq!(robots(&[]).meant("a/base_link").unwrap(), None);
    assert_eq!(robots(&["a/base_link"]).meant("").unwrap(), robot("a"));
    let both = robots(&["a/base_link", "a/base_footprint", "b/base_link"]);
    let named = both.meant("b/base_link").unwrap();
    assert_eq!(named, frame("b/odom", "b/base_link"));
    assert_eq!(both.meant("b/lidar").unwrap(), robot("b"));
    let plain = robots(&["a/base_link", "base_link"]);
    assert_eq!(plain.meant("").unwrap(), robot(""));
    assert_eq!(robots(&["base_link"]).meant("a/lidar").unwrap(), robot(""));
    let fault = both.meant("").unwrap_err().to_string();
    assert!(
        fault.contains("found that of a/base_link, b/base_link")
            && fault.contains("vehicle_frame: a/base_link"),
        "{fault}"
    );
    let fault = robots(&["a/base_link"]).meant("c/base_link");
    let fault = fault.unwrap_err().to_string();
    assert!(fault.contains("the odometry of c"), "{fault}");
    assert!(robots(&["a/base_link"]).several().is_empty());
    assert_eq!(both.several(), ["a/base_link", "b/base_link"]);
}

#[test]
fn a_frame_that_is_named_is_moved_by_what_ends_in_it_or_by_the_odometry_it_hangs_off() {
    let chassis = moving(&[("map", "/odom"), ("/odom", "/chassis")]);
    assert_eq!(chassis.meant("").unwrap(), None);
    assert_eq!(chassis.meant("/chassis").unwrap(), frame("odom", "chassis"));
    let drone = moving(&[("world", "drone"), ("odom", "base_link")]);
    assert_eq!(drone.meant("drone").unwrap(), frame("world", "drone"));
    assert_eq!(drone.meant("").unwrap(), robot(""));
    // A joint that publishers repeat is no odometry.
    let joint = moving(&[("base_footprint", "base_link"), ("odom", "base_footprint")]);
    let footprint = frame("odom", "base_footprint");
    assert_eq!(joint.meant("base_link").unwrap(), footprint);
    let circle = moving(&[("a", "b"), ("b", "a")]);
    assert_eq!(circle.meant("a").unwrap(), frame("b", "a"));
    let meant = chassis.meant("chassis").unwrap().unwrap();
    assert!(meant.is("/odom", "chassis") && !meant.is("map", "odom"));
}

#[test]
fn what_moves_the_vehicle_in_another_frame_contradicts_and_its_joints_do_not() {
    let motion = |parent: &str, child: &str| Motion {
        parent: parent.to_owned(),
        child: child.to_owned(),
    };
    let robot = OdometryOf::default();
    let moving = moving(&[("odom", "base_link"), ("map", "odom")]);
    let read = moving.motion_of(&robot).unwrap();
    assert_eq!(read, motion("odom", "base_link"));
    let said = "base_link moves in map, too; odometry is read of odom -> base_link";
    for odometry in [
        &robot,
        &odometry(&("odom".to_owned(), "base_link".to_owned())),
    ] {
        let told = |parent, child| odometry.contradiction(&read, &motion(parent, child));
        assert_eq!(told("map", "base_link").as_deref(), Some(said));
        assert_eq!(told("odom", "base_link"), None);
        assert_eq!(told("base_footprint", "base_link"), None);
        assert_eq!(told("map", "odom"), None);
    }
    let other = OdometryOf::Robot("b".to_owned());
    assert_eq!(moving.motion_of(&other), None);
}

#[test]
fn what_is_missing_is_said_with_the_transforms_that_there_are() {
    for (motions, named, said) in [
        (
            &[("map", "odom"), ("odom", "chassis")][..],
            "",
            "expected a transform from odom to base_link, found map -> odom, odom -> chassis; say which one is the \
             vehicle in a session manifest: `defaults: { vehicle_frame: chassis }`",
        ),
        (
            &[("world", "drone")][..],
            "/body",
            "expected a transform that ends in body, found world -> drone; say which one is the vehicle in a session \
             manifest: `defaults: { vehicle_frame: drone }`",
        ),
        (
            &[("base_link", "wheel")][..],
            "",
            "expected a transform from odom to base_link, found base_link -> wheel; give the role odometry another \
             topic in a session manifest",
        ),
        (
            &[][..],
            "",
            "expected a transform from odom to base_link, found none",
        ),
    ] {
        assert_eq!(moving(motions).missing(named), said);
    }
}

#[test]
fn a_forged_fleet_is_bounded() {
    let frames: Vec<String> = (0..2 * MOST).map(|n| format!("{n}/base_link")).collect();
    let frames: Vec<&str> = frames.iter().map(String::as_str).collect();
    let fleet = robots(&frames);
    assert_eq!(fleet.frames.len(), MOST);
    let fault = fleet.meant("").unwrap_err().to_string();
    assert!(fault.contains("and 992 more"), "{fault}");
}
