use super::*;

/// A camera of this frame that stands so far beside the first of its pair, m.
fn beside(frame: &str, x: f64) -> CalibratedCamera {
    CalibratedCamera {
        frame: frame.to_owned(),
        pair_from_camera: Pose {
            x,
            ..Pose::IDENTITY
        },
    }
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
    assert_eq!(names.doubled(&info("right")).as_deref(), Some(said));
    assert_eq!(names.doubled(&info("left")), None);
    assert_eq!(names.doubled(&info("aligned")), None);
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
            assert_eq!(names.doubled(&info(prefix)), None);
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
        let said = names.doubled("/right/camera_info").unwrap_or_default();
        assert!(
            said.contains("/left and /right are both of frame optical"),
            "{said}"
        );
    }
}
