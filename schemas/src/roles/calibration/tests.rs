use std::cell::OnceCell;
use std::sync::Arc;

use arrow::array::{ArrayRef, ListArray, UInt32Array};
use arrow::datatypes::Float64Type;

use super::*;
use crate::Stamp;
use crate::roles::tests::members;
use crate::roles::{CalibratedCamera, CameraNames, OdometryOf};

fn list(numbers: &[f64]) -> ArrayRef {
    let items = numbers.iter().copied().map(Some);
    Arc::new(ListArray::from_iter_primitive::<Float64Type, _, _>([Some(
        items,
    )]))
}

fn number(number: u32) -> ArrayRef {
    Arc::new(UInt32Array::from(vec![number]))
}

const K: [f64; 9] = [128.0, 0.0, 79.5, 0.0, 128.0, 59.5, 0.0, 0.0, 1.0];
const P: [f64; 12] = [
    100.0, 0.0, 80.0, -7.0, 0.0, 100.0, 60.0, 0.0, 0.0, 0.0, 1.0, 0.0,
];
const ONE: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// What an image of 160 × 120 px is calibrated as, by its K, R, P and region of interest (offsets and size).
fn read(
    k: &[f64],
    r: &[f64],
    p: &[f64],
    roi: [u32; 4],
    images: &str,
) -> Result<Vec<Calibration>, String> {
    let cameras = CameraNames::of_images(|_| vec![images]);
    read_as(&cameras, k, r, p, roi)
}

/// The same, of a camera beside others.
fn read_as(
    cameras: &CameraNames,
    k: &[f64],
    r: &[f64],
    p: &[f64],
    roi: [u32; 4],
) -> Result<Vec<Calibration>, String> {
    let names = ["x_offset", "y_offset", "width", "height"];
    let roi = members(names.into_iter().zip(roi.map(number)).collect());
    let members = members(vec![
        ("width", number(160)),
        ("height", number(120)),
        ("d", list(&[-0.3, 0.1, 0.0, 0.0, 0.0])),
        ("k", list(k)),
        ("r", list(r)),
        ("p", list(p)),
        ("roi", Arc::new(roi) as ArrayRef),
    ]);
    Calibration::from_message(&Message {
        site: "lot",
        session: "a",
        topic: "/front/camera_info",
        log_time: Stamp(1),
        fields: Fields::new(&members, 0),
        zero: &OnceCell::new(),
        image: None,
        cameras,
        bits: None,
        robot: &OdometryOf::default(),
        still: None,
    })
}

/// Size, K and number of distortion coefficients.
fn lens(found: Result<Vec<Calibration>, String>) -> Result<([u32; 2], Vec<f64>, usize), String> {
    let rows = found?.into_iter();
    let mut rows = rows.map(|row| {
        (
            [row.width, row.height],
            row.intrinsics,
            row.distortion.len(),
        )
    });
    rows.next().ok_or_else(|| "no row".to_owned())
}

const RAW: &str = "/front/image_raw";
const RECT: &str = "/front/image_rect";

#[test]
fn a_calibration_is_of_the_part_of_the_sensor_that_is_read() {
    let read = |k: &[f64], roi| lens(read(k, &ONE, &P, roi, RAW));
    for whole in [[0; 4], [0, 0, 160, 120]] {
        assert_eq!(read(&K, whole), Ok(([160, 120], K.to_vec(), 5)));
    }
    let middle = [128.0, 0.0, 39.5, 0.0, 128.0, 29.5, 0.0, 0.0, 1.0];
    let part = read(&K, [40, 30, 80, 60]);
    assert_eq!(part, Ok(([80, 60], middle.to_vec(), 5)));
    // Of a corner, only the size is another one.
    let corner = read(&K, [0, 0, 80, 60]);
    assert_eq!(corner, Ok(([80, 60], K.to_vec(), 5)));
    let four = read(&[128.0, 79.5, 128.0, 59.5], [40, 30, 80, 60]);
    assert_eq!(four, Ok(([80, 60], vec![128.0, 39.5, 128.0, 29.5], 5)));
    for outside in [
        [81, 0, 80, 60],
        [0, 0, 80, 121],
        [40, 30, 0, 0],
        [u32::MAX, 0, 1, 1],
    ] {
        let said = read(&K, outside).err().unwrap_or_default();
        assert!(said.contains("within the 160 × 120 px"), "{said}");
    }
}

/// R of 5° about y.
fn turned() -> [f64; 9] {
    let (sin, cos) = 5.0_f64.to_radians().sin_cos();
    [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos]
}

#[test]
fn rectified_images_have_the_lens_of_p_or_none() {
    let rect = |r: &[f64], p: &[f64], roi| lens(read(&K, r, p, roi, RECT));
    let k = [100.0, 0.0, 80.0, 0.0, 100.0, 60.0, 0.0, 0.0, 1.0];
    for r in [&ONE[..], &[0.0; 9], &[]] {
        assert_eq!(rect(r, &P, [0; 4]), Ok(([160, 120], k.to_vec(), 0)));
    }
    let turned = turned();
    assert_eq!(rect(&turned, &P, [0; 4]), Ok(([160, 120], k.to_vec(), 0)));
    let no_number = [f64::NAN; 12];
    let mirrored = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0];
    for (r, p, roi, expected) in [
        (&ONE[..], &P[..0], [0; 4], "expected P"),
        (&ONE, &[0.0; 12], [0; 4], "expected P"),
        (&ONE, &no_number, [0; 4], "finite"),
        (&mirrored, &P, [0; 4], "expected R to be a rotation"),
        (&ONE[..4], &P, [0; 4], "expected 9 numbers as R, found 4"),
        (&ONE, &P, [40, 30, 80, 60], "region of interest"),
    ] {
        let said = rect(r, p, roi).err().unwrap_or_default();
        assert!(said.contains(expected), "{said}");
    }
    // Beside others nobody asks for R and P.
    let raw = lens(read(&K, &turned, &[], [0; 4], RAW));
    assert_eq!(raw, Ok(([160, 120], K.to_vec(), 5)));
}

#[test]
fn images_that_are_turned_say_where_they_look_and_others_stay_in_their_frame() {
    let mount = |r: &[f64], images| {
        let rows = read(&K, r, &P, [0; 4], images).unwrap_or_default();
        rows.into_iter().next().and_then(|row| row.mount)
    };
    for r in [&ONE[..], &[0.0; 9], &[]] {
        assert_eq!(mount(r, RECT), None);
    }
    assert_eq!(mount(&turned(), RAW), None);
    // The other way about than R turns. Alone, a camera stands in its own frame, whatever P says.
    let half = 2.5_f64.to_radians();
    let found = mount(&turned(), RECT);
    let parts = found
        .as_ref()
        .map(|found| found.frame_from_camera.to_array());
    let [x, y, z, qx, qy, qz, qw] = parts.unwrap_or_default();
    assert_eq!([x, y, z, qx, qz], [0.0; 5]);
    assert_eq!(found.map(|found| found.frame).as_deref(), Some("front"));
    assert!((qy + half.sin()).abs() < 1e-12 && (qw - half.cos()).abs() < 1e-12);
}

#[test]
fn the_second_camera_of_a_pair_needs_r_and_p_in_every_message() {
    let said = |frame: &str, x: f64| CalibratedCamera {
        frame: frame.to_owned(),
        pair_from_camera: Some(Pose {
            x,
            ..Pose::IDENTITY
        }),
        unplaced: None,
        is_beside: Some(x != 0.0),
    };
    let mut cameras = CameraNames::of_images(|_| vec!["/front/image_raw", "/left/image_raw"]);
    cameras.add("/front/camera_info", said("front", 0.07));
    let read = |cameras: &CameraNames, r: &[f64], p: &[f64]| {
        let rows = read_as(cameras, &K, r, p, [0; 4])?.into_iter();
        let mounts = rows.map(|row| row.mount.map(|mount| mount.frame_from_camera.x));
        Ok::<_, String>(mounts.collect::<Vec<_>>())
    };
    let mut nowhere = P;
    nowhere[3] = -1e30;
    let bad = [(&[1.0; 9], &P), (&[f64::NAN; 9], &P), (&ONE, &nowhere)];
    // Alone in its frame it needs neither.
    for (r, p) in bad {
        assert_eq!(read(&cameras, r, p), Ok(vec![None]));
    }
    cameras.add("/left/camera_info", said("front", 0.0));
    assert_eq!(read(&cameras, &ONE, &P), Ok(vec![Some(0.07)]));
    for (r, p) in bad {
        let said = read(&cameras, r, p).err().unwrap_or_default();
        assert!(
            said.contains("expected R") || said.contains("expected P"),
            "{said}"
        );
    }
    // It is counted once, where cameras are named, if its first message does not say how it stands to the other one.
    let unplaced = CalibratedCamera {
        pair_from_camera: None,
        unplaced: Some("expected R".to_owned()),
        ..said("front", 0.07)
    };
    cameras.add("/front/camera_info", unplaced);
    assert_eq!(read(&cameras, &ONE, &P), Ok(Vec::new()));
}

#[test]
fn a_camera_without_focal_length_is_not_calibrated_and_one_without_k_is_told_so() {
    for (k, is_told) in [
        (&[0.0; 9][..], "the camera is uncalibrated"),
        (&[], "expected K, 9 numbers, found none"),
    ] {
        let said = read(k, &ONE, &P, [0; 4], RAW).err().unwrap_or_default();
        assert!(said.contains(is_told), "{said}");
    }
}
