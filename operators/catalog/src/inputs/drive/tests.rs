#![allow(clippy::unwrap_used)]
use nalgebra::{UnitQuaternion, Vector3};

use super::*;

#[test]
fn a_camera_that_is_turned_otherwise_has_its_pixels_elsewhere() {
    let k = [100.0, 0.0, 99.5, 0.0, 100.0, 74.5, 0.0, 0.0, 1.0];
    let lens = Camera::from_calibration("plumb_bob", 200, 150, &k, &[]).unwrap();
    let turned = |angle_rad: f64| {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle_rad);
        (lens.clone(), Pose::new(Vector3::zeros(), rotation))
    };
    // In the corners, twice as many pixels to an angle as in the middle.
    assert!(!moves(&turned(0.05), &turned(0.05)));
    assert!(!moves(&turned(0.0), &turned(0.002)));
    assert!(moves(&turned(0.0), &turned(0.01)));
}

#[test]
fn images_of_another_size_than_most_are_none_of_their_camera() {
    let front = Calibration {
        site: "s".into(),
        session: "a".into(),
        stamp: Stamp(0),
        camera: "front".into(),
        width: 200,
        height: 150,
        model: "plumb_bob".into(),
        intrinsics: vec![100.0, 0.0, 99.5, 0.0, 100.0, 74.5, 0.0, 0.0, 1.0],
        distortion: Vec::new(),
        mount: None,
    };
    let mount = Transform {
        site: "s".into(),
        session: "a".into(),
        stamp: Stamp(0),
        parent: "base_link".into(),
        child: "front".into(),
        parent_from_child: evermap_schemas::Pose::IDENTITY,
        fixed: true,
    };
    let mounted = rig::rigs(vec![front], vec![mount]);
    let sizes = [[1, 1], [200, 150], [100, 75], [200, 150]];
    let shots: Vec<Shot<'_>> = sizes
        .iter()
        .zip(1..)
        .map(|(size, stamp)| Shot {
            camera: "front",
            stamp: Stamp(stamp),
            size: *size,
        })
        .collect();
    let mut said = Vec::new();
    let mut skip = |reason: Reason, images| said.push((reason.to_string(), images));
    let rig = rig(
        mounted.get("a"),
        &shots,
        &VehicleFrame::default(),
        &mut skip,
    );
    let reason = "image of camera `front` has another size than most of its session, 200 × 150";
    assert_eq!(said, [(reason.to_owned(), 2)]);
    let drive = FeaturedDrive {
        rig,
        keyframes: Vec::from([1, 2, 3, 4].map(|stamp| FeaturedKeyframe {
            stamp: Stamp(stamp),
            number: 0,
            stretch: 0,
            odom_from_vehicle: Pose::identity(),
            features: (),
        })),
    };
    let places = shots.iter().map(|shot| drive.image(shot));
    assert_eq!(
        places.collect::<Vec<_>>(),
        [None, Some((1, 0)), None, Some((3, 0))]
    );
}
