//! Which topics play which role where nobody says.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, StructArray};
use arrow::datatypes::Field;

use super::*;

/// The members of messages, a column each.
pub(super) fn members(named: Vec<(&str, ArrayRef)>) -> StructArray {
    let member = |(name, array): (&str, ArrayRef)| {
        let field = Field::new(name, array.data_type().clone(), true);
        (Arc::new(field), array)
    };
    StructArray::from(named.into_iter().map(member).collect::<Vec<_>>())
}

/// The topics that are inferred for a role, and those passed over.
fn inferred(role: &Role, topics: &[(&str, &str, u64)]) -> (Vec<String>, Vec<String>) {
    let topics: Vec<Topic> = topics
        .iter()
        .map(|(name, schema, messages)| Topic::new(name, schema, *messages))
        .collect();
    let choices = role.infer(&topics).into_iter();
    let (chosen, passed_over): (Vec<_>, Vec<_>) = choices
        .map(|choice| (choice.topic, choice.passed_over))
        .unzip();
    (chosen, passed_over.concat())
}

#[test]
fn the_list_is_sorted() {
    assert!(ALL.is_sorted_by(|a, b| a.name < b.name));
}

#[test]
fn roles_follow_from_types_in_every_spelling() {
    for (odometry, image, tf) in [
        (
            "nav_msgs/msg/Odometry",
            "sensor_msgs/msg/Image",
            "tf2_msgs/msg/TFMessage",
        ),
        (
            "nav_msgs/Odometry",
            "sensor_msgs/CompressedImage",
            "tf/tfMessage",
        ),
        (
            "foxglove.PoseInFrame",
            "foxglove.RawImage",
            "foxglove.FrameTransforms",
        ),
    ] {
        let topics = [
            ("/my_odometry", odometry, 1),
            ("/cam", image, 1),
            ("/tf", tf, 1),
            ("/goal_pose", "geometry_msgs/msg/PoseStamped", 9),
        ];
        for (role, topic) in [
            (&odometry::ROLE, "/my_odometry"),
            (&frames::ROLE, "/cam"),
            (&transforms::ROLE, "/tf"),
        ] {
            let (chosen, passed_over) = inferred(role, &topics);
            assert_eq!(chosen, [topic]);
            assert!(passed_over.is_empty());
        }
    }
}

#[test]
fn range_and_label_images_are_no_pictures() {
    let image = "sensor_msgs/msg/CompressedImage";
    let topics = [
        ("/front/semantic_segmentation/image", image, 1),
        ("/pano/depth", image, 1),
        ("/pano/image/compressed", image, 1),
        ("/pano/labels", image, 1),
        ("/pano/labels_noisy", image, 1),
    ];
    assert_eq!(
        inferred(&frames::ROLE, &topics).0,
        ["/pano/image/compressed"]
    );
    assert_eq!(inferred(&depth_frames::ROLE, &topics).0, ["/pano/depth"]);
    let (labels, passed_over) = inferred(&label_frames::ROLE, &topics);
    assert_eq!(
        labels,
        ["/front/semantic_segmentation/image", "/pano/labels"]
    );
    assert_eq!(passed_over, ["/pano/labels_noisy"]);
}

#[test]
fn one_odometry_topic_is_chosen_and_told() {
    let nav = "nav_msgs/msg/Odometry";
    let (chosen, passed_over) = inferred(&odometry::ROLE, &[("/a", nav, 5), ("/b", nav, 9)]);
    assert_eq!(
        (chosen, passed_over),
        (vec!["/b".into()], vec!["/a".into()])
    );
    let (chosen, _) = inferred(&odometry::ROLE, &[("/b", nav, 9), ("/odom", nav, 1)]);
    assert_eq!(chosen, ["/odom"]);
}

#[test]
fn without_odometry_and_poses_the_moving_transforms_are_chosen() {
    let tf = "tf2_msgs/msg/TFMessage";
    let transforms = [("/tf_static", tf, 9), ("/robot/tf", tf, 9), ("/tf", tf, 5)];
    let (chosen, passed_over) = inferred(&odometry::ROLE, &transforms);
    assert_eq!(
        (chosen, passed_over),
        (vec!["/tf".into()], vec!["/robot/tf".into()])
    );
    assert!(inferred(&odometry::ROLE, &transforms[..1]).0.is_empty());
    let pose = ("/odom_pose", "geometry_msgs/msg/PoseStamped", 1);
    let with_pose = [transforms[2], pose];
    assert_eq!(inferred(&odometry::ROLE, &with_pose).0, ["/odom_pose"]);
}

#[test]
fn other_poses_are_odometry_where_there_is_nothing_else_and_goals_never() {
    let pose = ("/ego", "geometry_msgs/msg/PoseWithCovarianceStamped", 9);
    let goal = ("/goal_pose", "geometry_msgs/msg/PoseStamped", 99);
    assert_eq!(inferred(&odometry::ROLE, &[goal, pose]).0, ["/ego"]);
    assert!(inferred(&odometry::ROLE, &[goal]).0.is_empty());
    let tf = ("/tf", "tf2_msgs/msg/TFMessage", 5);
    assert_eq!(inferred(&odometry::ROLE, &[pose, tf]).0, ["/tf"]);
}

#[test]
fn a_compressed_twin_is_preferred() {
    let compressed = "sensor_msgs/msg/CompressedImage";
    let topics = [
        ("/c/image", "sensor_msgs/msg/Image", 1),
        ("/c/image/compressed", compressed, 1),
        ("/c/image/compressedDepth", compressed, 1),
    ];
    assert_eq!(inferred(&frames::ROLE, &topics).0, ["/c/image/compressed"]);
    assert!(inferred(&depth_frames::ROLE, &topics).0.is_empty());
    let depth = [("/c/depth/compressedDepth", compressed, 1)];
    assert_eq!(
        inferred(&depth_frames::ROLE, &depth).0,
        ["/c/depth/compressedDepth"]
    );
}

#[test]
fn a_twin_without_messages_hides_none_and_is_hidden() {
    let (image, compressed) = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage");
    let twins = |plain: u64, twin: u64| {
        let topics = [
            ("/c/image", image, plain),
            ("/c/image/compressed", compressed, twin),
        ];
        inferred(&frames::ROLE, &topics).0
    };
    assert_eq!(twins(9, 0), ["/c/image"]);
    for (plain, twin) in [(9, 1), (0, 9), (0, 0)] {
        assert_eq!(twins(plain, twin), ["/c/image/compressed"]);
    }
    let video = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket";
    let sent = |plain: u64| {
        let topics = [("/c/image", image, plain), ("/c/image/ffmpeg", video, 9)];
        inferred(&frames::ROLE, &topics).0
    };
    assert_eq!(sent(0), ["/c/image/ffmpeg"]);
    assert_eq!(sent(1), ["/c/image"]);
    for (role, name) in [
        (&depth_frames::ROLE, "/c/depth"),
        (&label_frames::ROLE, "/c/labels"),
    ] {
        let twin = format!("{name}/compressed");
        let topics = [(name, image, 9), (twin.as_str(), compressed, 0)];
        assert_eq!(inferred(role, &topics).0, [name]);
    }
    let range = [
        ("/c/depth", image, 0),
        ("/c/depth/compressedDepth", compressed, 9),
    ];
    let (chosen, _) = inferred(&depth_frames::ROLE, &range);
    assert_eq!(chosen, ["/c/depth/compressedDepth"]);
}

#[test]
fn rectified_images_are_read_where_a_camera_has_no_others() {
    let image = "sensor_msgs/msg/Image";
    let topics = [
        ("/left/image_raw", image, 9),
        ("/left/image_rect", image, 9),
        ("/left/image_rect_color", image, 9),
        ("/right/image_rect", image, 9),
        ("/rear/image_raw", image, 0),
        ("/rear/image_rect", image, 9),
    ];
    let (chosen, passed_over) = inferred(&frames::ROLE, &topics);
    let expected = [
        "/left/image_raw",
        "/rear/image_raw",
        "/rear/image_rect",
        "/right/image_rect",
    ];
    assert_eq!(chosen, expected);
    assert_eq!(passed_over, ["/left/image_rect", "/left/image_rect_color"]);
    let range = [
        ("/left/depth/image_raw", image, 1),
        ("/left/depth/image_rect", image, 1),
    ];
    assert_eq!(
        inferred(&depth_frames::ROLE, &range).0,
        ["/left/depth/image_raw"]
    );
}
