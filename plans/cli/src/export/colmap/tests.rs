#![allow(clippy::unwrap_used)]
use super::*;
use evermap_algorithms::geometry::rig::RigCamera;
use evermap_schemas::layers::Observation;
use evermap_schemas::{Stamp, Wkb};

fn fisheye() -> Camera {
    let k = [120.0, 0.0, 199.5, 0.0, 121.0, 149.5, 0.0, 0.0, 1.0];
    Camera::from_calibration("equidistant", 400, 300, &k, &[0.1, 0.02, 0.0, 0.0]).unwrap()
}

fn parts() -> Parts {
    // Looks along the vehicle's x axis from 2 m above its origin.
    let vehicle_from_camera = Pose::from_array([0.0, 0.0, 2.0, -0.5, 0.5, -0.5, 0.5]).unwrap();
    let camera = RigCamera {
        name: "front".into(),
        camera: fisheye(),
        vehicle_from_camera,
    };
    let (site, session) = ("lot".to_owned(), "a".to_owned());
    let features = Features {
        site: site.clone(),
        session: session.clone(),
        stamp: Stamp(7),
        keyframe: 3,
        camera: "front".into(),
        width: 400,
        height: 300,
        u: vec![10.0, 199.5],
        v: vec![20.0, 149.5],
        size_px: vec![1.0, 1.0],
        descriptors: Default::default(),
    };
    let seen = Observation {
        camera: "front".into(),
        feature: 1,
        u: 199.5,
        v: 149.5,
        size_px: 1.0,
        landmark: 0,
        residual_px: 0.1,
        weight: 1.0,
    };
    let pose = AdjustedPose {
        site: site.clone(),
        session: session.clone(),
        stamp: Stamp(7),
        keyframe: 3,
        map_from_vehicle: evermap_schemas::Pose {
            x: 10.0,
            ..evermap_schemas::Pose::IDENTITY
        },
        stretch: 0,
        odom_from_vehicle: evermap_schemas::Pose::IDENTITY,
        observations: vec![seen],
        descriptors: Default::default(),
        images: vec![],
    };
    let landmark = Landmark {
        site,
        landmark: 0,
        x: 15.0,
        y: 0.0,
        z: 2.0,
        sigma_m: 0.1,
        parallax_rad: 0.1,
        rms_px: 0.25,
        view: [-1.0, 0.0, 0.0],
        view_cos: 1.0,
        near_m: 5.0,
        far_m: 5.0,
        descriptors: Default::default(),
        sightings: vec![],
        sources: vec![],
        geometry: Wkb::point([15.0, 0.0, 2.0]),
    };
    Parts {
        poses: vec![pose],
        landmarks: vec![landmark],
        features: vec![features],
        rigs: BTreeMap::from([(
            session,
            Rig {
                cameras: vec![camera],
            },
        )]),
    }
}

fn numbers(line: &str) -> Vec<f64> {
    line.split(' ')
        .filter_map(|word| word.parse().ok())
        .collect()
}

#[test]
fn a_landmark_lies_where_its_image_shows_it() {
    let texts = model(&parts()).unwrap();
    let images: Vec<_> = texts.images.lines().skip(2).collect();
    let head = numbers(images[0]);
    assert!(images[0].ends_with(" 1 a/front/7.jpg"), "{}", images[0]);
    let camera_from_map = Pose::from_array([
        head[5], head[6], head[7], head[2], head[3], head[4], head[1],
    ])
    .unwrap();
    let point = numbers(texts.points.lines().nth(1).unwrap());
    assert_eq!((point[0], &point[8..]), (1.0, &[1.0, 1.0][..]));
    let at = camera_from_map.transform(&nalgebra::Vector3::new(point[1], point[2], point[3]));
    let [u, v] = fisheye().project(&at).unwrap();
    let seen = numbers(images[1]);
    assert_eq!(seen[2], -1.0, "the first feature has no landmark");
    assert_eq!(seen[5], 1.0);
    assert!((seen[3] - 0.5 - u).abs() < 1e-9 && (seen[4] - 0.5 - v).abs() < 1e-9);
}

#[test]
fn names_of_images_lead_nowhere_but_into_their_folder() {
    for (name, expected) in [
        ("front", "front"),
        ("front left", "front_left"),
        ("/rig/front", "rig/front"),
        ("../../etc", "__/__/etc"),
        ("a\n1 2/.", "a_1_2/_"),
        ("..a", "..a"),
    ] {
        assert_eq!(within(name), expected, "{name:?}");
    }
}

#[test]
fn lenses_have_colmaps_names_and_corners() {
    assert_eq!(
        lens(&fisheye()).unwrap(),
        "OPENCV_FISHEYE 400 300 120 121 200 150 0.1 0.02 0 0"
    );
    let pinhole = |d: &[f64]| {
        let k = [100.0, 0.0, 49.5, 0.0, 100.0, 39.5, 0.0, 0.0, 1.0];
        lens(&Camera::from_calibration("rational_polynomial", 100, 80, &k, d).unwrap()).unwrap()
    };
    assert_eq!(pinhole(&[]), "PINHOLE 100 80 100 100 50 40");
    assert_eq!(
        pinhole(&[0.1, 0.0, 0.0, 0.01]),
        "OPENCV 100 80 100 100 50 40 0.1 0 0 0.01"
    );
    assert_eq!(
        pinhole(&[0.1, 0.0, 0.0, 0.01, 0.2, 0.0, 0.0, 0.3]),
        "FULL_OPENCV 100 80 100 100 50 40 0.1 0 0 0.01 0.2 0 0 0.3"
    );
    let k = [160.0, 500.0, 160.0, 160.0];
    let panorama = Camera::from_calibration("equirectangular", 1000, 300, &k, &[]).unwrap();
    assert!(
        lens(&panorama)
            .unwrap_err()
            .to_string()
            .contains("panoramas")
    );
}
