#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::*;
use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::ground::floor::Floor;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// A 180° fisheye on the bonnet, looking forward and 40° down.
fn rig() -> (Camera, Pose) {
    let k = [127.0, 0.0, 199.7, 0.0, 127.2, 149.2, 0.0, 0.0, 1.0];
    let d = [0.012, -0.006, 0.002, -0.0004];
    let camera = Camera::from_calibration("equidistant", 400, 300, &k, &d).unwrap();
    let camera = camera.with_max_angle(96f64.to_radians());
    // Columns: right, down and forward of the camera in the vehicle frame.
    let level = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(
        0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0,
    ));
    let down = Rotation3::from_axis_angle(&Vector3::x_axis(), -40f64.to_radians());
    let rotation = UnitQuaternion::from_rotation_matrix(&(level * down));
    (camera, Pose::new(Vector3::new(3.6, 0.02, 0.95), rotation))
}

/// A smooth picture, so that sampling errors show as grey differences.
fn picture(camera: &Camera) -> Vec<u8> {
    let at = |u: u32, v: u32| {
        127.0 + 60.0 * (f64::from(u) / 18.0).sin() + 60.0 * (f64::from(v) / 14.0).cos()
    };
    let rows = 0..camera.height;
    rows.flat_map(|v| (0..camera.width).map(move |u| at(u, v) as u8))
        .collect()
}

/// What the cell shows according to the lens itself, in floating point.
fn naive(
    camera: &Camera,
    map_from_camera: &Pose,
    map_from_vehicle: &Pose,
    pixels: &[u8],
    x: f64,
    y: f64,
) -> Option<f64> {
    let normal = map_from_vehicle.rotate(&Vector3::z());
    let origin = map_from_vehicle.translation;
    let z = origin.z - (normal.x * (x - origin.x) + normal.y * (y - origin.y)) / normal.z;
    let [u, v] = camera.project(&map_from_camera.inverse().transform(&Vector3::new(x, y, z)))?;
    let (right, bottom) = (f64::from(camera.width - 1), f64::from(camera.height - 1));
    if !(0.0..=right).contains(&u) || !(0.0..=bottom).contains(&v) {
        return None;
    }
    let (left, top) = (u.floor().min(right - 1.0), v.floor().min(bottom - 1.0));
    let pixel = |c: f64, r: f64| f64::from(pixels[r as usize * camera.width as usize + c as usize]);
    let (fu, fv) = (u - left, v - top);
    let north = pixel(left, top) * (1.0 - fu) + pixel(left + 1.0, top) * fu;
    let south = pixel(left, top + 1.0) * (1.0 - fu) + pixel(left + 1.0, top + 1.0) * fu;
    Some(north * (1.0 - fv) + south * fv)
}

fn cells(
    lut: &GroundLut,
    image: &GrayView<'_>,
    pose: &Pose,
    cell_m: f64,
) -> BTreeMap<(i64, i64), (u8, u8)> {
    cells_on(None, lut, image, pose, cell_m)
}

fn cells_on(
    floor: Option<&Floor>,
    lut: &GroundLut,
    image: &GrayView<'_>,
    pose: &Pose,
    cell_m: f64,
) -> BTreeMap<(i64, i64), (u8, u8)> {
    let mut cells = BTreeMap::new();
    lut.splat(image, pose, floor, cell_m, |row| {
        for (k, (value, weight)) in row.values.iter().zip(row.weights).enumerate() {
            if *weight > 0 {
                let twice = cells.insert((row.i + k as i64, row.j), (*value, *weight));
                assert!(twice.is_none());
            }
        }
    });
    cells
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn agrees_with_the_lens(
        x in -500.0..500.0f64, y in -500.0..500.0f64, yaw in -3.2..3.2f64,
        roll in -0.05..0.05f64, pitch in -0.05..0.05f64
    ) {
        let (camera, vehicle_from_camera) = rig();
        let params = GroundParams { reach_m: 5.0, ..GroundParams::default() };
        let lut = GroundLut::new(&camera, &vehicle_from_camera, &params, None).unwrap();
        let pixels = picture(&camera);
        let image = GrayView::new(400, 300, &pixels).unwrap();
        let pose = Pose::new(Vector3::new(x, y, 1.3), UnitQuaternion::from_euler_angles(roll, pitch, yaw));
        let map_from_camera = pose.compose(&vehicle_from_camera);
        let seen = cells(&lut, &image, &pose, 0.1);
        prop_assert!(seen.len() > 2000, "{}", seen.len());
        let (mut total, mut worst) = (0.0, 0.0f64);
        for (&(i, j), &(value, weight)) in &seen {
            let at = [(i as f64 + 0.5) * 0.1, (j as f64 + 0.5) * 0.1];
            let expected = naive(&camera, &map_from_camera, &pose, &pixels, at[0], at[1]).unwrap();
            let error = (expected - f64::from(value)).abs();
            total += error;
            worst = worst.max(error);
            let spot = pose.inverse().transform(&Vector3::new(at[0], at[1], 1.3));
            let away = (spot.x - 3.6).hypot(spot.y - 0.02);
            prop_assert!(away <= 5.2);
            let cos = 0.95 / away.hypot(0.95);
            prop_assert!((f64::from(weight) - (255.0 * cos * cos).max(1.0)).abs() < 20.0);
        }
        prop_assert!(worst < 4.0, "worst {worst}");
        prop_assert!(total / (seen.len() as f64) < 0.5);
    }
}

#[test]
fn what_is_not_seen_weighs_nothing() {
    let (camera, vehicle_from_camera) = rig();
    let params = GroundParams {
        reach_m: 4.0,
        ..GroundParams::default()
    };
    let pixels = picture(&camera);
    let image = GrayView::new(400, 300, &pixels).unwrap();
    let lut = GroundLut::new(&camera, &vehicle_from_camera, &params, None).unwrap();
    let seen = cells(&lut, &image, &Pose::identity(), 0.05);
    // Nothing far behind the camera: the image circle ends at 96° from an axis 40° down.
    assert!(
        seen.keys().all(|(i, _)| *i as f64 * 0.05 > 1.9),
        "{:?}",
        seen.keys().next()
    );
    assert!(seen.len() > 8000);
    // A mask over the left half of the image hides what lies to the left (y > 0).
    let mask: Vec<u8> = (0..300)
        .flat_map(|_| (0..400).map(|u| u8::from(u < 200)))
        .collect();
    let masked = GroundLut::new(&camera, &vehicle_from_camera, &params, Some(&mask)).unwrap();
    let right = cells(&masked, &image, &Pose::identity(), 0.05);
    assert!(right.keys().all(|(_, j)| *j <= 1) && right.len() * 2 < seen.len() + 200);
    assert!(right.iter().all(|(cell, look)| seen[cell] == *look));
}

#[test]
fn a_patch_holds_just_the_cells_that_are_seen() {
    let (camera, vehicle_from_camera) = rig();
    let params = GroundParams::default();
    let pixels = picture(&camera);
    let image = GrayView::new(400, 300, &pixels).unwrap();
    let lut = GroundLut::new(&camera, &vehicle_from_camera, &params, None).unwrap();
    let pose = Pose::from_yaw(-2.0, 1.0, 0.7);
    let seen = cells(&lut, &image, &pose, 0.1);
    let patch = lut.patch(&image, &pose, None, 0.1).unwrap();
    assert!(patch.is_sound());
    let looks = patch.values.iter().zip(&patch.weights).enumerate();
    let shown: BTreeMap<_, _> = looks
        .filter(|(_, (_, weight))| **weight > 0)
        .map(|(at, (value, weight))| {
            let (i, j) = ((at % patch.width) as i64, (at / patch.width) as i64);
            ((patch.column + i, patch.row + j), (*value, *weight))
        })
        .collect();
    assert_eq!(shown, seen);
    let nowhere = Pose::new(Vector3::repeat(f64::NAN), UnitQuaternion::identity());
    assert_eq!(lut.patch(&image, &nowhere, None, 0.1), None);
}

/// Cells of half and a whole node, and of so many that spans are short: each compiled loop.
#[test]
fn each_colour_lies_where_grey_does() {
    let (camera, vehicle_from_camera) = rig();
    let params = GroundParams::default();
    let lut = GroundLut::new(&camera, &vehicle_from_camera, &params, None).unwrap();
    let grey = picture(&camera);
    let channels: [Vec<u8>; 3] = [
        grey.clone(),
        grey.iter().map(|grey| 255 - grey).collect(),
        grey.iter().rev().copied().collect(),
    ];
    let pixels = 0..grey.len();
    let pixels = pixels.flat_map(|pixel| channels.each_ref().map(|channel| channel[pixel]));
    let pixels: Vec<u8> = pixels.collect();
    let image = ImageView::of_colours(400, 300, &pixels).unwrap();
    let pose = Pose::from_yaw(-2.0, 1.0, 0.7);
    for cell_m in [0.025, 0.1, 0.2, 0.5] {
        let patch = lut.patch(image, &pose, None, cell_m).unwrap();
        assert!(patch.is_sound());
        assert_eq!(patch.channels(), Channels::Colour);
        for (at, channel) in channels.iter().enumerate() {
            let alone = GrayView::new(400, 300, channel).unwrap();
            let alone = lut.patch(&alone, &pose, None, cell_m).unwrap();
            let values: Vec<u8> = patch.values.iter().skip(at).step_by(3).copied().collect();
            assert_eq!((values, &patch.weights), (alone.values, &alone.weights));
            assert_eq!([patch.column, patch.row], [alone.column, alone.row]);
        }
    }
    assert!(ImageView::of_colours(400, 300, &pixels[3..]).is_none());
}

#[test]
fn an_image_without_a_colour_makes_a_grey_patch() {
    let (camera, vehicle_from_camera) = rig();
    let params = GroundParams::default();
    let lut = GroundLut::new(&camera, &vehicle_from_camera, &params, None).unwrap();
    let grey = picture(&camera);
    let pixels: Vec<u8> = grey.iter().flat_map(|grey| [*grey; 3]).collect();
    let pose = Pose::from_yaw(-2.0, 1.0, 0.7);
    let image = ImageView::of_colours(400, 300, &pixels).unwrap();
    let alone = GrayView::new(400, 300, &grey).unwrap();
    let [patch, expected] = [
        lut.patch(image, &pose, None, 0.1),
        lut.patch(&alone, &pose, None, 0.1),
    ];
    assert!(patch.is_some());
    assert_eq!(patch, expected);
}

#[test]
fn senseless_input_is_refused_or_gives_nothing() {
    let (camera, vehicle_from_camera) = rig();
    let params = GroundParams::default();
    let build = |pose: &Pose, params: &GroundParams, mask: Option<&[u8]>| {
        GroundLut::new(&camera, pose, params, mask)
    };
    assert!(build(&Pose::identity(), &params, None).is_err());
    assert!(
        build(
            &vehicle_from_camera,
            &GroundParams {
                cell_m: 0.0,
                ..params
            },
            None
        )
        .is_err()
    );
    assert!(
        build(
            &vehicle_from_camera,
            &GroundParams {
                reach_m: 1e9,
                ..params
            },
            None
        )
        .is_err()
    );
    assert!(build(&vehicle_from_camera, &params, Some(&[0])).is_err());
    let lut = build(&vehicle_from_camera, &params, None).unwrap();
    let pixels = picture(&camera);
    let image = GrayView::new(400, 300, &pixels).unwrap();
    let on_its_side = Pose::new(
        Vector3::zeros(),
        UnitQuaternion::from_euler_angles(1.6, 0.0, 0.0),
    );
    let nowhere = Pose::new(Vector3::repeat(f64::NAN), UnitQuaternion::identity());
    for pose in [on_its_side, nowhere] {
        assert!(cells(&lut, &image, &pose, 0.05).is_empty());
    }
    assert!(cells(&lut, &image, &Pose::identity(), f64::NAN).is_empty());
    let small = GrayView::new(2, 2, &pixels[..4]).unwrap();
    assert!(cells(&lut, &small, &Pose::identity(), 0.05).is_empty());
}

#[test]
fn the_frame_of_an_axle_stands_above_the_ground() {
    let (camera, vehicle_from_camera) = rig();
    let params = GroundParams::default();
    let axle = GroundParams {
        plane_m: -0.25,
        ..params
    };
    let height = Pose::new(Vector3::z() * 0.25, UnitQuaternion::identity());
    let axle_from_camera = height.inverse().compose(&vehicle_from_camera);
    let pixels = picture(&camera);
    let image = GrayView::new(400, 300, &pixels).unwrap();
    let of_ground = GroundLut::new(&camera, &vehicle_from_camera, &params, None).unwrap();
    let of_axle = GroundLut::new(&camera, &axle_from_camera, &axle, None).unwrap();
    // On a slope, so that the two frames stand above different cells.
    let rotation = UnitQuaternion::from_euler_angles(0.1, 0.2, 0.7);
    let pose = Pose::new(Vector3::new(-2.0, 1.0, 0.5), rotation);
    let expected = cells(&of_ground, &image, &pose, 0.1);
    let found = cells(&of_axle, &image, &pose.compose(&height), 0.1);
    let both = expected.keys().filter(|cell| found.contains_key(cell));
    let both: Vec<_> = both.collect();
    assert!(both.len() + 20 > expected.len().max(found.len()));
    for cell in both {
        assert!(expected[cell].0.abs_diff(found[cell].0) <= 1, "{cell:?}");
    }
}

/// A floor that rises by 5 % beyond x = 6 m, seen from before and from behind the bend.
#[test]
fn a_floor_that_bends_is_seen_where_it_is() {
    let (camera, vehicle_from_camera) = rig();
    let params = GroundParams {
        reach_m: 5.0,
        ..GroundParams::default()
    };
    let lut = GroundLut::new(&camera, &vehicle_from_camera, &params, None).unwrap();
    let pixels = picture(&camera);
    let image = GrayView::new(400, 300, &pixels).unwrap();
    let rise = |x: f64| 0.05 * (x - 6.0).max(0.0);
    let slope = |x: f64| if x > 6.0 { -(0.05_f64.atan()) } else { 0.0 };
    let poses: Vec<_> = (-20..100)
        .map(|at| 0.2 * f64::from(at))
        .map(|x| {
            let attitude = UnitQuaternion::from_euler_angles(0.0, slope(x), 0.0);
            Pose::new(Vector3::new(x, 0.1, rise(x)), attitude)
        })
        .collect();
    let floor = Floor::under(&poses, 0.0, 10.0);
    let mut counted = 0;
    for pose in [&poses[25], &poses[45], &poses[70]] {
        let map_from_camera = pose.compose(&vehicle_from_camera);
        let error = |floor: Option<&Floor>| {
            let seen = cells_on(floor, &lut, &image, pose, 0.1);
            let off = seen.iter().filter_map(|((i, j), (value, _))| {
                let [x, y] = [*i, *j].map(|cell| (cell as f64 + 0.5) * 0.1);
                let spot = Pose::new(Vector3::z() * rise(x), UnitQuaternion::identity());
                let there = naive(
                    &camera,
                    &spot.inverse().compose(&map_from_camera),
                    &Pose::identity(),
                    &pixels,
                    x,
                    y,
                );
                Some((there? - f64::from(*value)).abs())
            });
            let off: Vec<f64> = off.collect();
            (off.iter().sum::<f64>() / off.len() as f64, off.len())
        };
        let ((flat, _), (bent, seen)) = (error(None), error(Some(&floor)));
        assert!(seen > 1500 && bent < 2.0, "{flat} {bent} {seen}");
        counted += usize::from(flat > 2.0 * bent);
    }
    // On the slope far from the bend the vehicle's own plane does as well.
    assert!(counted >= 2);
}
