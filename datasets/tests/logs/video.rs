//! Frames of video come out as pictures, whichever are asked for, together or alone; what is broken is told.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use bytes::Bytes;
use evermap_datasets::{Dataset, ImageReader};
use evermap_schemas::roles::Frame;
use evermap_schemas::{Fault, ImageRef};
use evermap_video::{Codec, Encoder};

use crate::common::{open, rows};

const FRAMES: usize = 12;
const KEY_EVERY: usize = 5;

/// How a log spells a frame.
#[derive(Debug, Clone, Copy)]
enum Spelling {
    /// `foxglove_msgs/msg/CompressedVideo`.
    Foxglove,
    /// `foxglove.CompressedVideo` as JSON.
    Json,
    /// `sensor_msgs/msg/CompressedImage`.
    Compressed,
    /// `ffmpeg_image_transport_msgs/msg/FFMPEGPacket`.
    Packet,
}

const HEADER: &str = "std_msgs/Header header\n";
const STAMPS: &str = "
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

impl Spelling {
    /// Encoding of the messages and of the schema, its name, and the schema.
    fn schema(self) -> (&'static str, &'static str, &'static str, String) {
        let ros = |name, fields: &str| ("cdr", "ros2msg", name, format!("{fields}{STAMPS}"));
        match self {
            Self::Foxglove => ros(
                "foxglove_msgs/msg/CompressedVideo",
                "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n",
            ),
            Self::Compressed => ros(
                "sensor_msgs/msg/CompressedImage",
                &format!("{HEADER}string format\nuint8[] data\n"),
            ),
            Self::Packet => ros(
                "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
                &format!(
                    "{HEADER}int32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\nbool is_bigendian\nuint8[] data\n"
                ),
            ),
            Self::Json => (
                "json",
                "jsonschema",
                "foxglove.CompressedVideo",
                r#"{"type":"object","properties":{
                    "timestamp":{"type":"object","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},
                    "frame_id":{"type":"string"},
                    "data":{"type":"string","contentEncoding":"base64"},
                    "format":{"type":"string"}}}"#
                    .to_owned(),
            ),
        }
    }

    fn message(self, codec: Codec, time: u32, data: &[u8]) -> Vec<u8> {
        let mut cdr = Cdr(vec![0, 1, 0, 0]);
        cdr.number(&time.to_le_bytes())
            .number(&[0; 4])
            .text("camera");
        match self {
            Self::Json => {
                let data = BASE64_STANDARD.encode(data);
                let name = codec.name();
                return format!(
                    r#"{{"timestamp":{{"sec":{time},"nsec":0}},"frame_id":"camera","data":"{data}","format":"{name}"}}"#
                )
                .into_bytes();
            }
            Self::Foxglove => cdr.bytes(data).text(codec.name()),
            Self::Compressed => cdr.text(&format!("video/{}", codec.name())).bytes(data),
            Self::Packet => {
                let encoding = match codec {
                    Codec::H264 => "libx264;yuv420p",
                    Codec::H265 => "hevc_nvenc",
                };
                let sized = cdr
                    .number(&64i32.to_le_bytes())
                    .number(&48i32.to_le_bytes());
                let sized = sized
                    .text(encoding)
                    .number(&[0; 8])
                    .number(&[0])
                    .number(&[0]);
                sized.bytes(data)
            }
        };
        cdr.0
    }
}

/// Writes ROS 2 payloads.
struct Cdr(Vec<u8>);

impl Cdr {
    fn number(&mut self, bytes: &[u8]) -> &mut Self {
        while !(self.0.len() - 4).is_multiple_of(bytes.len()) {
            self.0.push(0);
        }
        self.0.extend(bytes);
        self
    }

    fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.number(&(bytes.len() as u32).to_le_bytes());
        self.0.extend(bytes);
        self
    }

    fn text(&mut self, text: &str) -> &mut Self {
        self.bytes(&[text.as_bytes(), &[0]].concat())
    }
}

/// A square that moves over a slope, as video.
fn stream(codec: Codec) -> Vec<Vec<u8>> {
    let mut encoder = Encoder::new(codec, [64, 48], KEY_EVERY as u32, 10).unwrap();
    let frames = (0..FRAMES).map(|time| {
        let pixels = (0..48).flat_map(|y| (0..64).map(move |x| (x, y)));
        let rgb = pixels.flat_map(|(x, y)| match (time..time + 16).contains(&x) && y < 24 {
            true => [200, 60, 40],
            false => [2 * x as u8, 3 * y as u8, 90],
        });
        encoder.encode(&rgb.collect::<Vec<u8>>()).unwrap()
    });
    frames.collect()
}

/// Writes a log with one frame a second, in chunks of two kilobytes or without chunks.
fn write(
    path: &std::path::Path,
    spelling: Spelling,
    codec: Codec,
    frames: &[Vec<u8>],
    chunks: bool,
) {
    let (encoding, schema_encoding, name, schema) = spelling.schema();
    let options = mcap::WriteOptions::new()
        .use_chunks(chunks)
        .chunk_size(Some(2048))
        .compression(Some(mcap::Compression::Zstd));
    let mut log = options
        .create(std::fs::File::create(path).unwrap())
        .unwrap();
    let channel = Arc::new(mcap::Channel {
        id: 1,
        topic: "/camera/video".to_owned(),
        schema: Some(Arc::new(mcap::Schema {
            id: 1,
            name: name.to_owned(),
            encoding: schema_encoding.to_owned(),
            data: Cow::Owned(schema.into_bytes()),
        })),
        message_encoding: encoding.to_owned(),
        metadata: BTreeMap::new(),
    });
    for (time, frame) in frames.iter().enumerate() {
        let stamp = time as u64 * 1_000_000_000;
        log.write(&mcap::Message {
            channel: channel.clone(),
            sequence: 0,
            log_time: stamp,
            publish_time: stamp,
            data: Cow::Owned(spelling.message(codec, time as u32, frame)),
        })
        .unwrap();
    }
    log.finish().unwrap();
}

async fn references(path: &std::path::Path) -> (Dataset, Vec<ImageRef>) {
    let (context, dataset) = open(&[path.display().to_string()], 1).await;
    let batches = rows(&context, "SELECT * FROM frames ORDER BY log_time").await;
    let frames = batches
        .iter()
        .flat_map(|batch| evermap_schemas::rows::<Frame>(batch).unwrap());
    let images = frames.map(|frame| frame.image).collect();
    (dataset, images)
}

async fn resolved(reader: &ImageReader, images: &[ImageRef]) -> Vec<Result<Bytes, Fault>> {
    reader.resolve(images).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_frame_is_the_same_picture_however_it_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    for codec in [Codec::H264, Codec::H265] {
        let frames = stream(codec);
        let mut pictures: Option<Vec<Bytes>> = None;
        for (spelling, chunks) in [
            (Spelling::Foxglove, true),
            (Spelling::Foxglove, false),
            (Spelling::Json, true),
            (Spelling::Compressed, true),
            (Spelling::Packet, true),
        ] {
            let path = folder
                .path()
                .join(format!("{}-{spelling:?}-{chunks}.mcap", codec.name()));
            write(&path, spelling, codec, &frames, chunks);
            let (dataset, images) = references(&path).await;
            assert_eq!(images.len(), FRAMES, "{spelling:?}");
            let reader = ImageReader::new(&dataset, 1 << 20);
            let all = resolved(&reader, &images).await;
            let all: Vec<Bytes> = all.into_iter().map(Result::unwrap).collect();
            assert!(all.iter().all(|file| file.starts_with(b"P6\n64 48\n255\n")));
            assert!(
                all.windows(2).all(|pair| pair[0] != pair[1]),
                "nothing moves"
            );
            assert_eq!(
                *pictures.get_or_insert_with(|| all.clone()),
                all,
                "{spelling:?}"
            );
            // Alone and from the end, in pairs and every third, with the decoders that wait and with none.
            for at in (0..FRAMES).rev() {
                let alone = resolved(&reader, &images[at..=at]).await;
                assert_eq!(
                    *alone[0].as_ref().unwrap(),
                    all[at],
                    "{spelling:?}, frame {at}"
                );
            }
            let fresh = ImageReader::new(&dataset, 1);
            let third: Vec<usize> = (0..FRAMES).step_by(3).collect();
            for pair in third.chunks(2) {
                let asked: Vec<ImageRef> = pair.iter().map(|at| images[*at].clone()).collect();
                for (at, file) in pair.iter().zip(resolved(&fresh, &asked).await) {
                    assert_eq!(file.unwrap(), all[*at], "{spelling:?}, frame {at}");
                }
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_cannot_be_decoded_takes_those_up_to_the_next_key_frame_along() {
    let folder = tempfile::tempdir().unwrap();
    let mut frames = stream(Codec::H264).split_off(3);
    // Now the key frames are numbers 2 and 7.
    let half = frames[3].len() / 2;
    frames[3].truncate(half);
    let path = folder.path().join("broken.mcap");
    write(&path, Spelling::Foxglove, Codec::H264, &frames, true);
    let (dataset, mut images) = references(&path).await;
    let expected = |at: usize| match at {
        0 | 1 => Some("without a key frame before it"),
        3 => Some("does not decode"),
        4..=6 => Some("after one that does not decode"),
        _ => None,
    };
    let check = |at: usize, found: &Result<Bytes, Fault>| match (expected(at), found) {
        (Some(reason), Err(fault)) => assert!(fault.message.contains(reason), "{at}: {fault}"),
        (None, Ok(_)) => {}
        _ => panic!("frame {at}: {found:?}"),
    };
    let reader = ImageReader::new(&dataset, 1 << 20);
    let together = resolved(&reader, &images).await;
    together
        .iter()
        .enumerate()
        .for_each(|(at, found)| check(at, found));
    for at in 0..images.len() {
        let alone = ImageReader::new(&dataset, 1 << 20);
        check(at, &resolved(&alone, &images[at..=at]).await[0]);
    }
    // References that lead nowhere.
    images[2].offset += 1;
    images[7].chunk = Some(u64::MAX);
    images[8].chunk = None;
    images[8].offset = 3;
    let lost = [2, 7, 8].map(|at| images[at].clone());
    for found in resolved(&reader, &lost).await {
        assert!(found.unwrap_err().message.contains("found none"));
    }
}
