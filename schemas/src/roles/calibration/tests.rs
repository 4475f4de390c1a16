use std::cell::OnceCell;
use std::sync::Arc;

use arrow::array::{ArrayRef, ListArray, UInt32Array};
use arrow::datatypes::Float64Type;

use super::*;
use crate::Stamp;
use crate::roles::tests::members;
use crate::roles::{CameraNames, OdometryOf};

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
        cameras: &CameraNames::of_images(|_| vec![images]),
        bits: None,
        robot: &OdometryOf::default(),
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
fn a_camera_without_focal_length_is_not_calibrated() {
    assert_eq!(
        read(&[0.0; 9], &ONE, &P, [0; 4], RAW).map(|rows| rows.len()),
        Ok(0)
    );
}
