//! References of frames lead to the very bytes that the log holds.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common::by_hand::{channel, file, message, schema};
use crate::common::{in_memory, open, open_in, rows, shared};
use arrow::array::{Array, AsArray, RecordBatch};
use base64::Engine;
use base64::prelude::BASE64_STANDARD_NO_PAD;
use evermap_datasets::ImageReader;
use evermap_schemas::roles::Frame;

/// Frames of a log, in order, with their bytes.
async fn frames(log: &str) -> Vec<(Frame, bytes::Bytes)> {
    let (context, dataset) = open(&[log.to_owned()], 2).await;
    let batches = rows(&context, "SELECT * FROM frames ORDER BY log_time, topic").await;
    let frames: Vec<Frame> = batches
        .iter()
        .flat_map(|batch| evermap_schemas::rows(batch).unwrap())
        .collect();
    let reader = ImageReader::new(&dataset, 16 << 20);
    let images: Vec<_> = frames.iter().map(|frame| frame.image.clone()).collect();
    let bytes = reader.resolve(&images).await.unwrap();
    let bytes: Vec<_> = bytes.into_iter().map(Result::unwrap).collect();
    // A chunk that is larger than what is kept is gone through, forwards and anew.
    let small = ImageReader::new(&dataset, 1);
    for (image, bytes) in images
        .iter()
        .zip(&bytes)
        .take(3)
        .chain(images.iter().zip(&bytes).skip(1).take(2))
    {
        let again = small.resolve(std::slice::from_ref(image)).await.unwrap();
        assert_eq!(again[0].as_ref().unwrap(), bytes);
    }
    let again = small.resolve(&images).await.unwrap();
    let again: Vec<_> = again.into_iter().map(Result::unwrap).collect();
    assert!(again == bytes, "{log}");
    frames.into_iter().zip(bytes).collect()
}

/// The column `data` of a topic.
async fn column(log: &str, topic: &str) -> Vec<Vec<u8>> {
    let (context, _) = open(&[log.to_owned()], 1).await;
    let sql = format!("SELECT data FROM \"{topic}\" ORDER BY log_time");
    let cells = |batch: &RecordBatch| -> Vec<Vec<u8>> {
        let column = batch.column(0).as_binary_view();
        (0..column.len())
            .map(|row| column.value(row).to_vec())
            .collect()
    };
    rows(&context, &sql).await.iter().flat_map(cells).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn references_lead_to_the_decoded_bytes() {
    for log in [
        "data/mcap_real/amber/soccer_goal_12.mcap",
        "data/mcap_real/lichtblick/custom-camera-model.mcap",
        "data/mcap_real/mcap_explorer/demo.mcap",
        "data/mcap_real/foxglove_tutorials/foxglove_eip_bridge_2025-07-04_17-53-27.mcap",
    ] {
        let Some(path) = shared(log) else { return };
        let path = path.display().to_string();
        let found = frames(&path).await;
        let topics: std::collections::BTreeSet<_> =
            found.iter().map(|(frame, _)| frame.topic.clone()).collect();
        for topic in topics {
            let decoded = column(&path, &topic).await;
            let of_topic: Vec<_> = found
                .iter()
                .filter(|(frame, _)| frame.topic == topic)
                .collect();
            assert_eq!(decoded.len(), of_topic.len(), "{log} {topic}");
            for ((frame, bytes), decoded) in of_topic.into_iter().zip(decoded) {
                assert_eq!(*bytes, decoded, "{log} {frame:?}");
                assert!(!frame.camera.is_empty());
                match frame.image.format.as_str() {
                    "jpeg" => assert!(bytes.starts_with(&[0xff, 0xd8])),
                    "png" => assert!(bytes.starts_with(b"\x89PNG")),
                    _ => {
                        let size = frame.image.step.unwrap() * frame.image.height.unwrap();
                        assert_eq!(bytes.len(), size as usize, "{frame:?}");
                    }
                }
            }
        }
    }
}

/// The bytes of the frames of a log.
async fn images(log: &[Vec<u8>]) -> Vec<bytes::Bytes> {
    let log = in_memory(&file(log, &[])).await;
    let (context, dataset) = open_in(log, 1).await.unwrap();
    let batches = rows(&context, "SELECT * FROM frames ORDER BY log_time").await;
    let frames = batches
        .iter()
        .flat_map(|batch| evermap_schemas::rows::<Frame>(batch).unwrap());
    let images: Vec<_> = frames.map(|frame| frame.image).collect();
    let bytes = ImageReader::new(&dataset, 16 << 20).resolve(&images).await;
    bytes.unwrap().into_iter().map(Result::unwrap).collect()
}

const RAW: &str = r#"{"type":"object","properties":{"height":{"type":"integer"},"width":{"type":"integer"},
    "encoding":{"type":"string"},"step":{"type":"integer"},"data":{"type":"string","contentEncoding":"base64"}}}"#;

/// A raw image of 8 × 8 px, in JSON, without padding.
fn raw_json(bytes: &[u8]) -> String {
    let data = BASE64_STANDARD_NO_PAD.encode(bytes);
    format!(r#"{{"height":8,"width":8,"encoding":"mono8","step":8,"data":"{data}"}}"#)
}

/// Bytes that might be letters, and more of them than rows need.
#[tokio::test(flavor = "multi_thread")]
async fn raw_images_are_base64_where_their_log_has_such_in_json_and_not_where_they_look_like_it() {
    let fields = b"uint32 height\nuint32 width\nstring encoding\nuint32 step\nuint8[] data\n";
    let text = |bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes(), bytes].concat();
    let number = 8_u32.to_le_bytes();
    let letters = [b'F'; 72];
    let parts = [
        &[0, 1, 0, 0][..],
        &number,
        &number,
        &text(b"mono8\0"),
        &[0; 2],
        &number,
        &text(&letters),
    ];
    let binary = [
        schema(1, "sensor_msgs/msg/Image", "ros2msg", fields),
        channel(1, 1, "/front/image_raw", "cdr"),
        schema(
            2,
            "our.Status",
            "jsonschema",
            br#"{"type":"object","properties":{"data":{"type":"string"}}}"#,
        ),
        channel(2, 2, "/status", "json"),
        message(1, 0, &parts.concat()),
    ];
    assert_eq!(images(&binary).await, [&letters[..]]);
    let json = |bytes: &[u8]| {
        [
            schema(1, "foxglove.RawImage", "jsonschema", RAW.as_bytes()),
            channel(1, 1, "/front/image_raw", "json"),
            message(1, 0, raw_json(bytes).as_bytes()),
        ]
    };
    for length in [64, 65, 66] {
        let bytes = vec![0x15; length];
        assert_eq!(images(&json(&bytes)).await, [bytes], "{length}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn base64_needs_no_padding() {
    let fields = r#"{"type":"object","properties":{"data":{"type":"string","contentEncoding":"base64"},
        "format":{"type":"string"}}}"#;
    for length in [9, 10, 11] {
        let mut jpeg = vec![7; length];
        jpeg[..3].copy_from_slice(&[0xff, 0xd8, 0xff]);
        let data = BASE64_STANDARD_NO_PAD.encode(&jpeg);
        let said = format!(r#"{{"format":"jpeg","data":"{data}"}}"#);
        let log = [
            schema(
                1,
                "foxglove.CompressedImage",
                "jsonschema",
                fields.as_bytes(),
            ),
            channel(1, 1, "/front/image", "json"),
            message(1, 0, said.as_bytes()),
        ];
        assert_eq!(images(&log).await, [jpeg], "{length}");
    }
}
