//! References of frames lead to the very bytes that the log holds.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common::{open, rows, shared};
use arrow::array::{Array, AsArray, RecordBatch};
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
