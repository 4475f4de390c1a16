#![allow(clippy::unwrap_used)]
use evermap_schemas::roles::ALL;

use super::*;

/// The topics that a manifest gives to roles, and those that are inferred for the others.
fn resolve(
    given: &BTreeMap<String, Vec<String>>,
    topics: &[Topic],
) -> Result<(Roles, Vec<String>), Fault> {
    let mut roles = Roles::named(ALL, given, topics)?;
    let notes = roles.infer(ALL, |role| role.infer(topics));
    Ok((roles, notes))
}

#[test]
fn a_manifest_overrules_and_refuses_unknown_keys() {
    let manifest = Manifest::parse("roles: {frames: ['/x/*'], odometry: }\nsite: here").unwrap();
    let topics = [
        Topic::new("/odom", "nav_msgs/msg/Odometry", 1),
        Topic::new("/x/1", "any", 1),
        Topic::new("/y", "sensor_msgs/msg/Image", 1),
    ];
    let (roles, _) = resolve(&manifest.roles, &topics).unwrap();
    assert_eq!(roles.topics("frames"), ["/x/1"]);
    assert_eq!(roles.topics("odometry"), ["/odom"]);
    let fault = Manifest::parse("sights: here").unwrap_err();
    assert!(fault.to_string().contains("sights"), "{fault}");
    let fault = Manifest::parse("roles: {frames: {a: b}}").unwrap_err();
    assert!(fault.to_string().contains("a list of topics"), "{fault}");
}

#[test]
fn a_topic_of_a_type_that_other_roles_have_plays_none_but_theirs() {
    let topics = [
        Topic::new("/front/camera_info", "sensor_msgs/msg/CameraInfo", 1),
        Topic::new("/front/image", "sensor_msgs/msg/Image", 1),
        Topic::new("/front/raw", "our_msgs/msg/Bayer", 1),
    ];
    let resolved = |role: &str, topic: &str| {
        let given = BTreeMap::from([(role.to_owned(), vec![topic.to_owned()])]);
        let (roles, _) = resolve(&given, &topics)?;
        Ok::<_, Fault>(roles.topics(role).to_vec())
    };
    let all = resolved("frames", "/front/*").unwrap();
    assert_eq!(all, ["/front/image", "/front/raw"]);
    let fault = resolved("frames", "/front/camera_*").unwrap_err();
    let said = "for the role frames, found /front/camera_info of sensor_msgs/CameraInfo";
    assert!(fault.message.ends_with(said), "{fault}");
    assert_eq!(faulty_role(&fault), Some("frames"));
    assert!(resolved("frames", "/nowhere").unwrap().is_empty());
}

#[test]
fn a_topic_without_fields_plays_what_is_read_without_them_and_is_refused_for_the_rest() {
    let untyped = |name: &str, schema: &str| Topic {
        untyped: true,
        ..Topic::new(name, schema, 1)
    };
    let nav = "nav_msgs/msg/Odometry";
    let topics = [
        untyped("/image", "foxglove.CompressedImage"),
        untyped("/odom", nav),
        Topic::new("/tf_static", "tf2_msgs/msg/TFMessage", 1),
        untyped("/tf_static_too", "tf2_msgs/msg/TFMessage"),
    ];
    let resolved = |role: &str, topic: &str| {
        let given = BTreeMap::from([(role.to_owned(), vec![topic.to_owned()])]);
        let (roles, _) = resolve(&given, &topics)?;
        Ok::<_, Fault>(roles.topics(role).to_vec())
    };
    assert_eq!(resolved("frames", "/image").unwrap(), ["/image"]);
    let fault = resolved("odometry", "/odom").unwrap_err();
    let said = "expected a topic for the role odometry whose messages have fields, found /odom: \
                JSON whose schema names no fields";
    assert_eq!(fault.message, said);
    assert_eq!(faulty_role(&fault), Some("odometry"));
    let both = resolved("transforms", "/tf_static*").unwrap();
    assert_eq!(both, ["/tf_static", "/tf_static_too"]);
}

#[test]
fn a_choice_is_told_unless_a_manifest_made_it() {
    let nav = "nav_msgs/msg/Odometry";
    let topics = [Topic::new("/a", nav, 5), Topic::new("/b", nav, 9)];
    let (roles, notes) = resolve(&BTreeMap::new(), &topics).unwrap();
    assert_eq!(roles.topics("odometry"), ["/b"]);
    assert!(notes[0].contains("/a"), "{notes:?}");
    let again = resolve(&roles.to_manifest(), &topics).unwrap();
    assert_eq!(again, (roles, Vec::new()));
    let both = BTreeMap::from([("odometry".to_owned(), vec!["/*".to_owned()])]);
    let fault = resolve(&both, &topics).unwrap_err();
    assert!(fault.to_string().contains("expected one topic"), "{fault}");
}
