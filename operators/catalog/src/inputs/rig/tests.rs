#![allow(clippy::unwrap_used)]
use evermap_schemas::Pose as Placed;
use evermap_schemas::roles::CameraMount;

use super::*;

/// The fixed transforms of a session, each a metre ahead of its parent.
fn mounts(mounts: &[(&str, &str)]) -> Vec<Transform> {
    let mount = |(parent, child): &(&str, &str)| Transform {
        site: String::new(),
        session: String::new(),
        stamp: Stamp(0),
        parent: (*parent).to_owned(),
        child: (*child).to_owned(),
        parent_from_child: Placed {
            x: 1.0,
            ..Placed::IDENTITY
        },
        fixed: true,
    };
    mounts.iter().map(mount).collect()
}

/// The rig of a session with these fixed transforms, each a metre ahead of its parent.
fn rig(transforms: &[(&str, &str)]) -> Rig {
    let mut rig = Rig::default();
    let all = mounts(transforms).into_iter();
    all.for_each(|row| rig.mount(row));
    rig.settle();
    rig
}

/// How far ahead of the vehicle a camera is.
fn ahead(rig: &Rig, vehicle: &str, camera: &str) -> Option<f64> {
    let found = rig.vehicle_from_frame(vehicle, camera).ok()?;
    Some(found.translation.x)
}

#[test]
fn a_calibration_that_no_lens_has_says_what_is_wrong() {
    let calibration = |focal: f64, k1: f64| Calibration {
        site: String::new(),
        session: String::new(),
        stamp: Stamp(0),
        camera: "front".to_owned(),
        width: 400,
        height: 300,
        model: "equidistant".to_owned(),
        intrinsics: vec![focal, 0.0, 199.5, 0.0, focal, 149.5, 0.0, 0.0, 1.0],
        distortion: vec![k1, 0.0, 0.0, 0.0],
        mount: None,
    };
    let reason = |focal, k1| {
        let made = camera(&calibration(focal, k1), [200, 150]);
        made.err().map(|reason| reason.to_string())
    };
    for (focal, k1, expected) in [
        (1e308, 0.0, "expected focal lengths"),
        (1e-300, 0.0, "expected focal lengths"),
        (128.0, 1e300, "expected a ray"),
    ] {
        let reason = reason(focal, k1).unwrap_or_default();
        let named = reason.starts_with("calibration of camera `front`");
        assert!(named && reason.contains(expected), "{reason}");
    }
    assert_eq!(reason(128.0, -0.01), None);
}

#[test]
fn binned_images_of_a_part_of_a_sensor_have_the_lens_that_it_has() {
    let part = Calibration {
        site: String::new(),
        session: String::new(),
        stamp: Stamp(0),
        camera: "front".to_owned(),
        width: 80,
        height: 60,
        model: "plumb_bob".to_owned(),
        intrinsics: vec![128.0, 0.0, 39.5, 0.0, 120.0, 24.5, 0.0, 0.0, 1.0],
        distortion: Vec::new(),
        mount: None,
    };
    let whole = camera(&part, [80, 60]).ok();
    let binned = camera(&part, [40, 30]).ok();
    for pixel in [[0.0, 0.0], [79.0, 59.0], [39.5, 24.5]] {
        let rays = [
            (&whole, pixel),
            (&binned, pixel.map(|at| (at + 0.5) / 2.0 - 0.5)),
        ];
        let rays = rays.map(|(camera, at)| camera.as_ref()?.unproject(at));
        let angle = rays[0].zip(rays[1]).map(|(one, other)| one.angle(&other));
        assert!(angle.is_some_and(|angle| angle < 1e-6), "{angle:?}");
    }
    // Along one side alone.
    assert!(camera(&part, [40, 60]).is_err());
}

#[test]
fn images_are_larger_than_their_calibration_by_halves_alone() {
    let lens = calibration("front", None);
    let whole = camera(&lens, [200, 150]).unwrap();
    for (size, times) in [
        ([300, 225], 1.5),
        ([400, 300], 2.0),
        // Rounded to whole pixels.
        ([402, 300], 2.0),
        ([800, 600], 4.0),
        ([100, 75], 0.5),
        ([67, 50], 1.0 / 3.0),
    ] {
        let resized = camera(&lens, size).unwrap();
        let at = |pixel: [f64; 2]| pixel.map(|at| (at + 0.5) * times - 0.5);
        for pixel in [[0.0, 0.0], [199.0, 149.0]] {
            let rays = whole.unproject(pixel).zip(resized.unproject(at(pixel)));
            let angle = rays.map(|(one, other)| one.angle(&other));
            assert!(
                angle.is_some_and(|angle| angle < 0.01),
                "{size:?} {angle:?}"
            );
        }
    }
    let larger =
        "image of camera `front` is larger than its calibration, but not 1.5, 2, 2.5 … or 4 times";
    for size in [[240, 180], [360, 270], [900, 675], [8000, 6000]] {
        let reason = camera(&lens, size).err();
        assert_eq!(reason.as_deref(), Some(larger), "{size:?}");
    }
    let shape = camera(&lens, [400, 225]).err().unwrap_or_default();
    assert!(shape.contains("another shape"), "{shape}");
}

#[test]
fn what_a_log_says_is_shown_without_what_moves_a_cursor_and_with_its_quotes() {
    let text = "model \"kannala_v9\" of 'é'";
    assert_eq!(shown(text), text);
    assert_eq!(shown("a\u{1b}[2J\n"), "a\\u{1b}[2J\\n");
    assert_eq!(shown(&"x".repeat(1000)).len(), 120);
}

#[test]
fn a_vehicle_is_found_behind_the_only_prefix() {
    let one = rig(&[("a/base_link", "a/mast"), ("a/mast", "a/front")]);
    assert_eq!(ahead(&one, USUAL_VEHICLE, "a/front"), Some(2.0));
    assert_eq!(ahead(&one, "/a/base_link", "a/front"), Some(2.0));
    assert_eq!(ahead(&one, "b/base_link", "a/front"), None);
    assert_eq!(ahead(&rig(&[]), USUAL_VEHICLE, "a/base_link"), Some(0.0));
}

#[test]
fn what_is_fixed_in_a_circle_is_mounted_nowhere() {
    let why = |rig: &Rig, camera: &str| {
        let found = rig.vehicle_from_frame(USUAL_VEHICLE, camera);
        found.unwrap_err().to_string()
    };
    let through_vehicle = rig(&[
        ("base_link", "x"),
        ("x", "front"),
        ("front", "base_link"),
        ("front", "lens"),
    ]);
    let front = "fixed transforms from frame `front` lead in a circle, through `front`";
    assert_eq!(why(&through_vehicle, "front"), front);
    let lens = "fixed transforms from frame `lens` lead in a circle, through `front`";
    assert_eq!(why(&through_vehicle, "lens"), lens);
    let own = rig(&[("front", "front"), ("base_link", "left")]);
    assert_eq!(why(&own, "front"), front);
    // Others stay where they are.
    let aside = rig(&[("a", "b"), ("b", "a"), ("b", "c"), ("base_link", "left")]);
    assert_eq!(ahead(&aside, USUAL_VEHICLE, "left"), Some(1.0));
    assert_eq!(ahead(&aside, "b", "c"), Some(1.0));
    let circle: BTreeSet<String> = ["a", "b"].map(str::to_owned).into();
    assert_eq!(aside.circles, circle);
    let vehicle = VehicleFrame::default();
    let found = footing(mounts(&[("x", "base_link"), ("base_link", "x")]), &vehicle);
    assert!(found.vehicle_from_root.is_none() && found.root == USUAL_VEHICLE);
}

#[test]
fn what_is_farther_away_than_any_vehicle_is_long_is_not_mounted_on_it() {
    let mut rig = Rig::default();
    for (child, x) in [("front", -499.0), ("far", 1e8)] {
        for mut row in mounts(&[(USUAL_VEHICLE, child)]) {
            row.parent_from_child.x = x;
            rig.mount(row);
        }
    }
    rig.settle();
    assert_eq!(ahead(&rig, USUAL_VEHICLE, "front"), Some(-499.0));
    let why = rig.vehicle_from_frame(USUAL_VEHICLE, "far").unwrap_err();
    let said = "expected frame `far` at most 500 m from `base_link`, found 100000000 m";
    assert_eq!(why.to_string(), said);
}

#[test]
fn what_carries_the_vehicle_is_found_with_where_it_is_on_it() {
    let carried = |transforms: &[(&str, &str)], vehicle: &str| {
        let vehicle = VehicleFrame {
            vehicle_frame: vehicle.to_owned(),
        };
        let found = footing(mounts(transforms), &vehicle);
        let x = found.vehicle_from_root.map(|pose| pose.translation.x);
        (found.vehicle, found.root, x)
    };
    let expected = |vehicle: &str, root: &str, x| (vehicle.to_owned(), root.to_owned(), x);
    let foot = [
        ("foot", "/base_link"),
        ("base_link", "mast"),
        ("mast", "front"),
    ];
    assert_eq!(carried(&foot, "foot"), expected("foot", "foot", None));
    let base = expected("base_link", "foot", Some(-1.0));
    assert_eq!(carried(&foot, "/base_link"), base);
    let mast = expected("mast", "foot", Some(-2.0));
    assert_eq!(carried(&foot, "mast"), mast);
    let prefixed = [("a/foot", "a/base_link"), ("b/foot", "b/front")];
    let base = expected("a/base_link", "a/foot", Some(-1.0));
    assert_eq!(carried(&prefixed, USUAL_VEHICLE), base);
    let alone = expected("chassis", "chassis", None);
    assert_eq!(carried(&foot, "chassis"), alone);
}

#[test]
fn of_several_robots_none_is_taken_unless_it_is_named() {
    let two = rig(&[("a/base_link", "a/front"), ("b/base_link", "b/front")]);
    assert_eq!(ahead(&two, USUAL_VEHICLE, "a/front"), None);
    assert_eq!(ahead(&two, "b/base_link", "b/front"), Some(1.0));
    assert_eq!(ahead(&two, "b/base_link", "a/front"), None);
    let reason = two.vehicle_from_frame(USUAL_VEHICLE, "a/front");
    let reason = reason.err().map(|reason| reason.to_string());
    let expected =
        "fixed transforms from frame `a/front` lead to `a/base_link`, not to `base_link`";
    assert_eq!(reason.as_deref(), Some(expected));
}

/// A calibration of 200 × 150 px with a lens of 100 px, mounted so.
fn calibration(camera: &str, mount: Option<(&str, Placed)>) -> Calibration {
    Calibration {
        site: String::new(),
        session: String::new(),
        stamp: Stamp(0),
        camera: camera.to_owned(),
        width: 200,
        height: 150,
        model: "plumb_bob".to_owned(),
        intrinsics: vec![100.0, 0.0, 99.5, 0.0, 100.0, 74.5, 0.0, 0.0, 1.0],
        distortion: Vec::new(),
        mount: mount.map(|(frame, frame_from_camera)| CameraMount {
            frame: frame.to_owned(),
            frame_from_camera,
        }),
    }
}

#[test]
fn a_camera_is_where_its_calibration_mounts_it_and_its_frame_stays_where_it_is() {
    // Half a right angle about y, the other way about than R, and the second of a pair 0.14 m to the right in its images.
    let half = std::f64::consts::FRAC_PI_8;
    let turned = Placed {
        qy: -half.sin(),
        qw: half.cos(),
        ..Placed::IDENTITY
    };
    let beside = Placed {
        x: 0.1,
        z: 0.1,
        ..turned.clone()
    };
    let calibrations = vec![
        calibration("/left", Some(("/left", turned))),
        calibration("stereo/right", Some(("left", beside))),
        calibration("rear", None),
        calibration("lost", Some(("nowhere", Placed::IDENTITY))),
    ];
    let tree = mounts(&[("base_link", "left"), ("base_link", "rear")]);
    let rigs = rigs(calibrations, tree);
    let found = &rigs[""];
    // Ahead of the first one is what its frame has to the left and ahead alike: R turned its images there.
    let at = |camera: &str, point: [f64; 3]| {
        let placed = found.vehicle_from_image(USUAL_VEHICLE, camera, Stamp(5));
        placed.ok().map(|pose| pose.transform(&point.into()))
    };
    let far = 2.0_f64.sqrt();
    for (camera, point, expected) in [
        // The frames are a metre ahead of the vehicle, and turned as it is.
        ("left", [0.0, 0.0, far], [1.0 - 1.0, 0.0, 1.0]),
        (
            "stereo/right",
            [0.0, 0.0, far],
            [1.0 + 0.1 - 1.0, 0.0, 0.1 + 1.0],
        ),
        ("rear", [0.0, 0.0, 1.0], [1.0, 0.0, 1.0]),
    ] {
        let expected = nalgebra::Vector3::from(expected);
        let point = at(camera, point);
        assert!(
            point.is_some_and(|point| (point - expected).norm() < 1e-12),
            "{camera}: {point:?}"
        );
    }
    assert_eq!(at("lost", [0.0; 3]), None);
    let frame = found.vehicle_from_frame(USUAL_VEHICLE, "left").ok();
    assert_eq!(frame.map(|pose| pose.rotation.angle()), Some(0.0));
    let names: Vec<String> = found
        .cameras(&VehicleFrame::default())
        .cameras
        .into_iter()
        .map(|camera| camera.name)
        .collect();
    assert_eq!(names, ["left", "rear", "stereo/right"]);
}
