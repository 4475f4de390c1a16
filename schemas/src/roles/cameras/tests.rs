use super::*;

/// A camera of this frame that stands so far beside the first of its pair, m.
fn beside(frame: &str, x: f64) -> CalibratedCamera {
    CalibratedCamera {
        frame: frame.to_owned(),
        pair_from_camera: Some(Pose {
            x,
            ..Pose::IDENTITY
        }),
        unplaced: None,
        is_beside: Some(x != 0.0),
    }
}

/// A camera of the frame `optical` with this wrong in its R or P.
fn unplaced(why: &str, is_beside: Option<bool>) -> CalibratedCamera {
    CalibratedCamera {
        frame: "optical".to_owned(),
        pair_from_camera: None,
        unplaced: Some(why.to_owned()),
        is_beside,
    }
}

/// Names of the cameras of `/left` and `/right`, which have pictures.
fn of_two() -> CameraNames {
    CameraNames::of_images(|role| match role.name {
        "frames" => vec!["/left/image_raw", "/right/image_raw"],
        _ => Vec::new(),
    })
}

const LEFT: &str = "/left/camera_info";
const RIGHT: &str = "/right/camera_info";

/// That one of the two is left out for this reason, and the other one is called by the frame that both name.
fn assert_left_out(names: &CameraNames, out: &str, why: &str) {
    let other = match out {
        LEFT => RIGHT,
        _ => LEFT,
    };
    let said = names.left_out(out).unwrap_or_default();
    assert!(said.contains(why), "{said}");
    let camera = names.calibrated(out, "optical");
    assert_eq!(camera, topic_camera(out));
    assert!(names.is_unplaced(out, &camera));
    assert_eq!(names.first_of_pair(out, "optical"), None);
    assert_eq!(names.left_out(other), None);
    assert_eq!(names.calibrated(other, "optical"), "optical");
    assert!(!names.is_unplaced(other, "optical"));
    assert_eq!(names.mounts(), BTreeMap::new());
}

#[test]
fn a_camera_is_named_by_its_calibration_or_by_its_topic() {
    let mut names = CameraNames::default();
    names.add("/front/camera_info", beside("front_optical", 0.0));
    assert!(names.knows("/front/calibration") && !names.knows("/left/camera_info"));
    assert_eq!(
        names.name("/front/image_raw", "front_optical"),
        "front_optical"
    );
    assert_eq!(
        names.name("/front/image_raw/compressed", ""),
        "front_optical"
    );
    assert_eq!(names.name("/left/image_raw", "left_optical"), "left");
    assert_eq!(names.name("/image", ""), "image");
    assert_eq!(names.name("/left/image_rect_mono/ffmpeg", ""), "left");
    assert_eq!(names.name("/front_rect/image", ""), "front_rect");
}

#[test]
fn a_topic_says_that_its_images_are_rectified_by_a_word_of_its_own() {
    for topic in [
        "/l/image_rect",
        "/l/image_rect_color/compressed",
        "/rect/l",
        "/l/Image_Rectified",
    ] {
        assert!(is_rectified(topic), "{topic}");
    }
    for topic in ["/l/image_raw", "/direct/image", "/l/rectangles"] {
        assert!(!is_rectified(topic), "{topic}");
    }
}

#[test]
fn calibrations_are_of_the_images_that_are_read_and_pictures_decide() {
    let topics = |role: &Role| match role.name {
        "frames" => vec!["/left/image_rect", "/right/image_raw", "/right/image_rect"],
        "depth_frames" => vec![
            "/left/depth/image",
            "/range/image_rect_raw",
            "/right/depth/image_rect",
        ],
        _ => Vec::new(),
    };
    let mut names = CameraNames::of_images(topics);
    let expected = [
        ("left", true),
        ("right", false),
        ("range", true),
        ("rear", false),
    ];
    for (camera, rectified) in expected {
        let topic = format!("/{camera}/camera_info");
        assert_eq!(names.calibrates_rectified(&topic), rectified, "{camera}");
        assert_eq!(names.is_rectified(camera), None);
        names.add(&topic, beside(camera, 0.0));
        assert_eq!(names.is_rectified(camera), Some(rectified));
    }
    names.add("/rear/camera_info", beside("left", 0.0));
    assert_eq!(names.is_rectified("left"), None);
}

#[test]
fn of_two_prefixes_with_pictures_under_one_name_the_first_is_read() {
    let topics = |role: &Role| match role.name {
        "frames" => vec![
            "/left/image_raw",
            "/left/image/compressed",
            "/right/image_raw",
        ],
        "depth_frames" => vec!["/aligned/image_raw", "/right/depth"],
        _ => Vec::new(),
    };
    let mut names = CameraNames::of_images(topics);
    for prefix in ["right", "aligned", "left"] {
        let topic = format!("/{prefix}/camera_info");
        names.add(&topic, beside("optical", 0.0));
    }
    for (topic, instead) in [
        ("/left/image_raw", None),
        ("/left/image_rect_color/compressed", None),
        ("/left/depth", None),
        ("/right/image_raw", Some("left")),
        ("/right/depth", Some("left")),
        ("/aligned/image_raw", None),
    ] {
        assert_eq!(names.pictured_by(topic, "optical"), instead, "{topic}");
        assert_eq!(names.pictured_by(topic, "other"), None);
    }
    // The lens of a camera is that of its pictures.
    let info = |prefix: &str| format!("/{prefix}/camera_info");
    let calibrated = |prefix| names.calibrated_by(&info(prefix), "optical");
    assert_eq!(calibrated("left"), None);
    assert_eq!(calibrated("right"), Some("left"));
    assert_eq!(calibrated("aligned"), Some("left"));
    let said = "/left and /right are both of frame optical: only the first is read; choose with `roles: frames` in \
                a session manifest";
    assert_eq!(names.left_out(&info("right")).as_deref(), Some(said));
    assert_eq!(names.left_out(&info("left")), None);
    assert_eq!(names.left_out(&info("aligned")), None);
}

#[test]
fn cameras_of_a_pair_that_name_one_frame_are_two() {
    let topics = |role: &Role| match role.name {
        "frames" => vec!["/left/image_rect", "/right/image_rect", "/third/image_rect"],
        _ => Vec::new(),
    };
    let of = |calibrated: [(&str, f64); 3]| {
        let mut names = CameraNames::of_images(topics);
        for (prefix, x) in calibrated {
            names.add(&format!("/{prefix}/camera_info"), beside("optical", x));
        }
        names
    };
    // In whatever order their calibrations are known.
    for calibrated in [
        [("left", 0.0), ("right", 0.1), ("projector", 0.05)],
        [("projector", 0.05), ("right", 0.1), ("left", 0.0)],
    ] {
        let names = of(calibrated);
        assert_eq!(names.name("/left/image_rect", "optical"), "optical");
        for frame in ["optical", "", "of_images_alone"] {
            assert_eq!(names.name("/right/image_rect", frame), "right");
        }
        // Range images that are aligned to the first one.
        assert_eq!(names.name("/aligned/depth", "optical"), "optical");
        let info = |prefix: &str| format!("/{prefix}/camera_info");
        assert_eq!(names.calibrated(&info("right"), "optical"), "right");
        assert_eq!(names.calibrated(&info("right"), "another"), "another");
        for (prefix, camera, instead) in [
            ("left", "optical", None),
            ("right", "right", None),
            ("projector", "optical", Some("left")),
        ] {
            assert_eq!(names.calibrated_by(&info(prefix), camera), instead);
            assert_eq!(names.left_out(&info(prefix)), None);
        }
        let mounts = names.mounts().into_iter();
        let mounts = mounts.map(|(camera, mount)| {
            let [x, y, z, ..] = mount.frame_from_camera.to_array();
            (camera, mount.frame, [x, y, z])
        });
        let right = ("right".to_owned(), "optical".to_owned(), [0.1, 0.0, 0.0]);
        assert_eq!(mounts.collect::<Vec<_>>(), [right]);
    }
    // Range images that are aligned to the second one, which names its own frame.
    let aligned = of([("right", 0.1), ("aligned_depth", 0.0), ("third", 0.2)]);
    assert_eq!(aligned.name("/right/image_rect", "optical"), "optical");
    // Of two that stand beside one of which nothing is known, or at one place, the first is read.
    for x in [0.0, 0.1] {
        let names = of([("left", x), ("right", x), ("third", x)]);
        assert_eq!(names.name("/right/image_rect", "optical"), "optical");
        let said = names.left_out("/right/camera_info").unwrap_or_default();
        assert!(
            said.contains("/left and /right are both of frame optical"),
            "{said}"
        );
    }
}

#[test]
fn a_second_camera_is_left_out_where_r_or_p_of_either_does_not_say_how_they_stand() {
    let (no_turn, nowhere) = ("expected R to be a rotation", "expected P to say where");
    for (left, right, why) in [
        // R of the first one, R and P of the second one.
        (
            unplaced(no_turn, Some(false)),
            beside("optical", 0.1),
            "of /left: expected R",
        ),
        (
            beside("optical", 0.0),
            unplaced(no_turn, Some(true)),
            "of /right: expected R",
        ),
        (
            beside("optical", 0.0),
            unplaced(nowhere, None),
            "of /right: expected P",
        ),
        // P of the one that must be the first, as the other one is not.
        (
            unplaced(nowhere, None),
            beside("optical", 0.1),
            "of /left: expected P",
        ),
    ] {
        // Whichever is known first, and whichever is the first by name.
        for is_left_known_first in [true, false] {
            let mut names = of_two();
            let mut known = [(LEFT, left.clone()), (RIGHT, right.clone())];
            if !is_left_known_first {
                known.reverse();
            }
            for (topic, said) in known {
                names.add(topic, said);
            }
            assert_left_out(&names, RIGHT, why);
        }
        let mut names = of_two();
        names.add(RIGHT, left);
        names.add(LEFT, right);
        let why = match why.strip_prefix("of /left") {
            Some(why) => format!("of /right{why}"),
            None => why.replace("/right", "/left"),
        };
        assert_left_out(&names, LEFT, &why);
    }
}

#[test]
fn cameras_that_are_no_pair_need_no_r_and_no_p() {
    for alone in [
        unplaced("expected R", Some(false)),
        unplaced("expected R", Some(true)),
        unplaced("expected P", None),
    ] {
        let mut names = of_two();
        names.add(LEFT, alone);
        assert_eq!(names.left_out(LEFT), None);
        assert_eq!(names.name("/left/image_raw", "optical"), "optical");
        assert_eq!(names.mounts(), BTreeMap::new());
        // Nor does one that stands beside a camera of another frame.
        names.add(RIGHT, beside("another", 0.1));
        assert_eq!(
            [LEFT, RIGHT].map(|topic| names.left_out(topic)),
            [None, None]
        );
    }
    // Of two at one place the first is read, whatever its R is.
    let mut names = of_two();
    names.add(LEFT, unplaced("expected R", Some(false)));
    names.add(RIGHT, beside("optical", 0.0));
    let said = names.left_out(RIGHT).unwrap_or_default();
    assert!(said.contains("only the first is read"), "{said}");
    assert_eq!(names.left_out(LEFT), None);
}

#[test]
fn a_second_camera_does_not_take_the_place_of_a_first_one_without_calibration() {
    let unread = |frame: &str| {
        let mut names = of_two();
        names.add(RIGHT, beside("optical", 0.1));
        names.add_unread(LEFT, frame.to_owned());
        names
    };
    let mut names = unread("optical");
    let said = names.left_out(RIGHT).unwrap_or_default();
    assert!(
        said.contains("of /left: expected one with a lens"),
        "{said}"
    );
    assert_eq!(names.name("/left/image_raw", "optical"), "left");
    assert_eq!(names.name("/right/image_raw", "optical"), "right");
    assert!(names.is_unplaced(RIGHT, "right") && !names.knows(LEFT));
    assert_eq!(names.mounts(), BTreeMap::new());
    // Until a later file has one that is read.
    names.add(LEFT, beside("optical", 0.0));
    names.add_unread(LEFT, "optical".to_owned());
    assert_eq!(names.left_out(RIGHT), None);
    assert_eq!(names.first_of_pair(RIGHT, "optical"), Some(&Pose::IDENTITY));
    let mut names = unread("optical");
    names.add(LEFT, beside("another", 0.0));
    assert_eq!(names.left_out(RIGHT), None);
    assert_eq!(names.calibrated(RIGHT, "optical"), "optical");

    // One of another frame, or without pictures, is none of its pair; and one at the frame's place stays there.
    let mut others = [unread("another"), unread("optical"), of_two()];
    others[1].add(RIGHT, beside("optical", 0.0));
    others[2].add(RIGHT, beside("optical", 0.1));
    others[2].add_unread("/projector/camera_info", "optical".to_owned());
    for names in others {
        assert_eq!(names.left_out(RIGHT), None);
        assert_eq!(names.name("/right/image_raw", "optical"), "optical");
    }
}

#[test]
fn a_camera_whose_calibration_is_not_read_keeps_the_name_of_its_frame() {
    let mut names = of_two();
    names.add_unread(LEFT, "optical".to_owned());
    assert_eq!(names.name("/left/image_raw", "optical"), "optical");
    assert_eq!(names.name("/left/image_raw", "another"), "left");
    assert_eq!(names.name("/right/image_raw", "optical"), "right");
    // Drivers call the frames of all cameras the same.
    names.add_unread(RIGHT, "optical".to_owned());
    assert_eq!(names.name("/left/image_raw", "optical"), "left");
    assert_eq!(names.name("/right/image_raw", "optical"), "right");
}
