use std::cell::OnceCell;
use std::sync::Arc;

use arrow::array::{ArrayRef, StringArray, UInt8Array};

use super::*;
use crate::Pose;
use crate::roles::tests::members;
use crate::roles::{BIG_ENDIAN, CalibratedCamera, CameraNames, Fields, FoundImage, OdometryOf};

fn camera(frame: &str) -> CalibratedCamera {
    CalibratedCamera {
        frame: frame.to_owned(),
        pair_from_camera: Some(Pose::IDENTITY),
        unplaced: None,
        is_beside: Some(false),
    }
}

#[test]
fn formats_are_named_alike() {
    assert_eq!(plain_format("mono8; jpeg compressed ", &[0; 8]), "jpeg");
    assert_eq!(plain_format("image/png", &[0; 8]), "png");
    assert_eq!(plain_format("", b"\xff\xd8\xff\xe0\0\0\0\0"), "jpeg");
    assert_eq!(plain_format("webp", b"RIFF\0\0\0\0"), "webp");
    for (said, plain) in [
        ("16UC1; compressedDepth png", "compressedDepth 16UC1"),
        ("mono16; compressedDepth png", "compressedDepth 16UC1"),
        ("32FC1; compressedDepth", "compressedDepth 32FC1"),
        ("16UC1; compressedDepth rvl", "16uc1; compresseddepth rvl"),
    ] {
        assert_eq!(plain_format(said, &[0; 8]), plain);
    }
    for (said, plain) in [("H264", "h264"), ("video/h.264", "h264"), ("hevc", "h265")] {
        assert_eq!(plain_format(said, b"\0\0\0\x01\x67\0\0\0"), plain);
    }
    assert_eq!(video_format("libx264;yuv420p").as_deref(), Some("h264"));
    assert_eq!(video_format("hevc_nvenc").as_deref(), Some("h265"));
    assert_eq!(video_format("bayer_rggb8"), None);
}

/// The format of an image of 1 × 1 px, or why there is none.
fn read(topic: &str, encoding: &str, big: u8, cameras: &CameraNames) -> Result<String, String> {
    read_with_bits(topic, encoding, big, cameras, None)
}

fn read_with_bits(
    topic: &str,
    encoding: &str,
    big: u8,
    cameras: &CameraNames,
    bits: Option<SampleBits>,
) -> Result<String, String> {
    let members = members(vec![
        (
            "encoding",
            Arc::new(StringArray::from(vec![encoding])) as ArrayRef,
        ),
        (
            "is_bigendian",
            Arc::new(UInt8Array::from(vec![big])) as ArrayRef,
        ),
    ]);
    let place = ImageRef {
        session: "a".to_owned(),
        length: 1,
        ..ImageRef::default()
    };
    let frames = Frame::from_message(&Message {
        site: "lot",
        session: "a",
        topic,
        log_time: Stamp(1),
        fields: Fields::new(&members, 0),
        zero: &OnceCell::new(),
        image: Some(&FoundImage {
            place,
            magic: [0; 8],
        }),
        cameras,
        bits,
        robot: &OdometryOf::default(),
        still: None,
    });
    let formats = frames?.into_iter().map(|frame| frame.image.format);
    Ok(formats.collect())
}

#[test]
fn the_order_of_bytes_is_told_of_samples_that_have_several() {
    let names = CameraNames::default();
    let read = |encoding, big| read("/front/image_raw", encoding, big, &names);
    for wide in ["mono16", "16UC1", "32FC1", "bayer_rggb16", "rgba16"] {
        assert_eq!(read(wide, 0), Ok(wide.to_owned()));
        assert_eq!(read(wide, 1), Ok(format!("{wide}{BIG_ENDIAN}")));
    }
    for narrow in ["mono8", "bayer_rggb8", "8UC3", "yuv422_yuy2", "nv12"] {
        assert_eq!(read(narrow, 1), Ok(narrow.to_owned()));
    }
    // Packets of video have a member of that name as well.
    assert_eq!(read("libx264;yuv420p", 1), Ok("h264".to_owned()));
}

#[test]
fn bits_that_a_person_says_are_told_of_samples_of_16() {
    let names = CameraNames::default();
    let read = |encoding, big| {
        read_with_bits(
            "/front/image_raw",
            encoding,
            big,
            &names,
            SampleBits::new(12),
        )
    };
    for wide in ["mono16", "16UC1", "bayer_rggb16", "rgba16"] {
        assert_eq!(read(wide, 0), Ok(format!("{wide} 12-bit")));
    }
    let big = "mono16 12-bit big-endian".to_owned();
    assert_eq!(read("mono16", 1), Ok(big));
    for other in ["mono8", "32FC1", "nv12", "h264"] {
        let said = read(other, 0).err().unwrap_or_default();
        assert!(said.contains("says 12 of its topic"), "{other}: {said}");
    }
}

#[test]
fn images_that_their_calibration_is_not_read_for_are_refused() {
    let names = |images: &str| {
        let mut names = CameraNames::of_images(|_| vec![images]);
        names.add("/front/camera_info", camera("front"));
        names
    };
    let (raw, rect) = (names("/front/image_raw"), names("/front/image_rect"));
    let read = |topic: &str, names| read(topic, "mono8", 0, names);
    for (topic, of_raw, of_rect) in [
        ("/front/image_raw", true, false),
        ("/front/image_rect", false, true),
        ("/front/depth", true, true),
        ("/front/labels", true, true),
        ("/front/depth/image_rect", false, true),
        ("/rear/image_rect", true, true),
    ] {
        for (names, is_read) in [(&raw, of_raw), (&rect, of_rect)] {
            assert_eq!(read(topic, names).is_ok(), is_read, "{topic}");
        }
    }
}

#[test]
fn images_of_a_second_camera_are_not_read_where_nobody_knows_how_it_stands_to_the_first() {
    let mut names = CameraNames::of_images(|_| vec!["/left/image", "/right/image"]);
    let second = CalibratedCamera {
        is_beside: Some(true),
        ..camera("optical")
    };
    names.add("/right/camera_info", second);
    assert_eq!(
        read("/right/image", "mono8", 0, &names),
        Ok("mono8".to_owned())
    );
    names.add_unread("/left/camera_info", "optical".to_owned());
    for (topic, format) in [
        ("/left/image", "mono8"),
        ("/right/image", ""),
        ("/right/labels", ""),
    ] {
        assert_eq!(
            read(topic, "mono8", 0, &names),
            Ok(format.to_owned()),
            "{topic}"
        );
    }
}

#[test]
fn images_of_a_second_camera_that_names_the_frame_of_a_first_are_not_read() {
    let pictures = vec!["/left/image", "/right/image"];
    let read = |topic: &str, names: &CameraNames| read(topic, "mono8", 0, names);
    for calibrated in [
        ["/left/camera_info"].as_slice(),
        &["/right/camera_info", "/left/camera_info"],
    ] {
        let mut names = CameraNames::of_images(|_| pictures.clone());
        calibrated
            .iter()
            .for_each(|topic| names.add(topic, camera("right")));
        // The images of this test name no frame; a prefix stands for it.
        assert_eq!(read("/left/image", &names), Ok("mono8".to_owned()));
        let other = read("/right/image", &names);
        match calibrated.len() {
            1 => assert!(other.is_err_and(|said| said.contains("/left and /right"))),
            _ => assert_eq!(other, Ok(String::new())),
        }
    }
}
