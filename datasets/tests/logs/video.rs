//! Frames of video come out as pictures, whichever are asked for, together or alone; what is broken is told.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use bytes::Bytes;
use datafusion::prelude::SessionContext;
use evermap_datasets::{Dataset, ImageReader, Manifest};
use evermap_ffmpeg::{Encoder, Samples, Style};
use evermap_schemas::roles::Frame;
use evermap_schemas::{Fault, ImageRef};
use evermap_video::Codec;

use crate::common::{context, open, rows};

const FRAMES: usize = 12;
const KEY_EVERY: usize = 5;

/// How a log spells a frame.
#[derive(Debug, Clone, Copy)]
enum Spelling {
    /// `foxglove_msgs/msg/CompressedVideo`.
    Foxglove,
    /// `foxglove.CompressedVideo` as JSON.
    Json,
    /// `foxglove.CompressedVideo` as protobuf.
    Protobuf,
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
    fn schema(self) -> (&'static str, &'static str, &'static str, Vec<u8>) {
        let ros = |name, fields: &str| {
            let definition = format!("{fields}{STAMPS}");
            ("cdr", "ros2msg", name, definition.into_bytes())
        };
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
                    .as_bytes()
                    .to_vec(),
            ),
            Self::Protobuf => (
                "protobuf",
                "protobuf",
                "foxglove.CompressedVideo",
                protobuf_schema(),
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
            Self::Protobuf => {
                return [
                    member(1, &[&[8][..], &varint(time as usize)].concat()),
                    member(2, b"camera"),
                    member(3, data),
                    member(4, codec.name().as_bytes()),
                ]
                .concat();
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

fn varint(mut value: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value > 0x7f {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

/// A member of a protobuf message that has a length.
fn member(number: usize, bytes: &[u8]) -> Vec<u8> {
    [varint(number << 3 | 2), varint(bytes.len()), bytes.to_vec()].concat()
}

/// The descriptors (descriptor.proto) of `foxglove.CompressedVideo` and `google.protobuf.Timestamp`.
fn protobuf_schema() -> Vec<u8> {
    const INT32: usize = 5;
    const INT64: usize = 3;
    const STRING: usize = 9;
    const MESSAGE: usize = 11;
    const BYTES: usize = 12;
    let field = |name: &str, number: usize, kind: usize, of: &str| {
        let kinds = [
            vec![0x18],
            varint(number),
            vec![0x20, 1, 0x28],
            varint(kind),
        ];
        let of = match of {
            "" => Vec::new(),
            of => member(6, of.as_bytes()),
        };
        member(
            2,
            &[member(1, name.as_bytes()), kinds.concat(), of].concat(),
        )
    };
    let file = |name: &str, package: &str, message: &str, fields: &[Vec<u8>]| {
        let message = [member(1, message.as_bytes()), fields.concat()].concat();
        let parts = [
            member(1, name.as_bytes()),
            member(2, package.as_bytes()),
            member(4, &message),
            member(12, b"proto3"),
        ];
        parts.concat()
    };
    let stamp = file(
        "google/protobuf/timestamp.proto",
        "google.protobuf",
        "Timestamp",
        &[field("seconds", 1, INT64, ""), field("nanos", 2, INT32, "")],
    );
    let video = file(
        "foxglove/CompressedVideo.proto",
        "foxglove",
        "CompressedVideo",
        &[
            field("timestamp", 1, MESSAGE, ".google.protobuf.Timestamp"),
            field("frame_id", 2, STRING, ""),
            field("data", 3, BYTES, ""),
            field("format", 4, STRING, ""),
        ],
    );
    let needs = member(3, b"google/protobuf/timestamp.proto");
    [member(1, &stamp), member(1, &[video, needs].concat())].concat()
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
    styled(codec, Style::usual(KEY_EVERY as u32, 10))
}

/// In the order in which the frames decode, which is that of recording.
fn styled(codec: Codec, style: Style) -> Vec<Vec<u8>> {
    let mut encoder = Encoder::new(codec, [64, 48], style).unwrap();
    let pictures = (0..FRAMES).map(|time| {
        let pixels = (0..48).flat_map(|y| (0..64).map(move |x| (x, y)));
        let rgb = pixels.flat_map(|(x, y)| match (time..time + 16).contains(&x) && y < 24 {
            true => [200, 60, 40],
            false => [2 * x as u8, 3 * y as u8, 90],
        });
        rgb.collect::<Vec<u8>>()
    });
    let mut frames: Vec<Vec<u8>> = pictures
        .filter_map(|picture| encoder.encode(&picture).unwrap())
        .collect();
    frames.extend(encoder.finish().unwrap());
    frames
}

/// Writes a log with one frame a second, in chunks of two kilobytes or without chunks.
fn write(
    path: &std::path::Path,
    spelling: Spelling,
    codec: Codec,
    frames: &[Vec<u8>],
    chunks: bool,
) {
    write_from(path, spelling, codec, frames, chunks, 0);
}

/// As [`write`], from this second on.
fn write_from(
    path: &std::path::Path,
    spelling: Spelling,
    codec: Codec,
    frames: &[Vec<u8>],
    chunks: bool,
    second: usize,
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
            data: Cow::Owned(schema),
        })),
        message_encoding: encoding.to_owned(),
        metadata: BTreeMap::new(),
    });
    for (time, frame) in (second..).zip(frames) {
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
    let images = images(&context).await;
    (dataset, images)
}

async fn images(context: &SessionContext) -> Vec<ImageRef> {
    let batches = rows(context, "SELECT * FROM frames ORDER BY log_time").await;
    let frames = batches
        .iter()
        .flat_map(|batch| evermap_schemas::rows::<Frame>(batch).unwrap());
    frames.map(|frame| frame.image).collect()
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
            (Spelling::Protobuf, true),
            (Spelling::Protobuf, false),
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

#[tokio::test(flavor = "multi_thread")]
async fn a_message_that_is_lost_takes_the_frames_up_to_the_next_key_frame_along() {
    const LOST: &str = "video frame refers to one that did not come";
    const AFTER: &str = "video frame after one that refers to one that did not come";
    let folder = tempfile::tempdir().unwrap();
    for codec in [Codec::H264, Codec::H265] {
        let mut frames = stream(codec);
        frames.remove(2);
        // Now the key frames are numbers 0, 4 and 9.
        let path = folder.path().join(format!("lost-{}.mcap", codec.name()));
        write(&path, Spelling::Foxglove, codec, &frames, true);
        let (dataset, images) = references(&path).await;
        for asked in [&images[..], &images[3..]] {
            let reader = ImageReader::new(&dataset, 1 << 20);
            let skipped = images.len() - asked.len();
            for (at, found) in resolved(&reader, asked).await.iter().enumerate() {
                let expected = match at + skipped {
                    2 => Some(LOST),
                    3 => Some(AFTER),
                    _ => None,
                };
                let told = found.as_ref().err().map(|fault| fault.message.as_str());
                assert_eq!(told, expected, "{codec:?}, {at}");
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_of_a_split_recording_is_decoded_from_the_file_before() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole.mcap");
    let frames = stream(Codec::H264);
    write(&whole, Spelling::Foxglove, Codec::H264, &frames, true);
    let (dataset, images) = references(&whole).await;
    let expected = resolved(&ImageReader::new(&dataset, 1 << 20), &images).await;
    // Key frames are numbers 0, 5 and 10: the second and the third file begin in the middle of a group.
    let mut manifest = String::from("sessions: [{name: split, files: [");
    for (number, (from, to)) in [(0, 3), (3, 8), (8, FRAMES)].into_iter().enumerate() {
        let path = folder.path().join(format!("split_{number}.mcap"));
        let (foxglove, part) = (Spelling::Foxglove, &frames[from..to]);
        write_from(&path, foxglove, Codec::H264, part, number != 1, from);
        manifest += &format!("{},", path.display());
    }
    let manifest = Manifest::parse(&format!("{manifest}]}}]")).unwrap();
    let context = context(1);
    let runtime = context.runtime_env();
    let dataset = Dataset::open(&runtime, &[], Some(&manifest));
    let dataset = dataset.await.unwrap();
    dataset.register(&context).unwrap();
    let images = self::images(&context).await;
    let parts: Vec<u32> = images.iter().map(|image| image.part).collect();
    assert_eq!(parts, [0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2]);
    let same = |at: usize, found: &Result<Bytes, Fault>| {
        let expected = expected[at].as_ref().unwrap();
        assert_eq!(found.as_ref().unwrap(), expected, "frame {at}");
    };
    let together = resolved(&ImageReader::new(&dataset, 1 << 20), &images).await;
    together
        .iter()
        .enumerate()
        .for_each(|(at, found)| same(at, found));
    for at in (0..FRAMES).rev() {
        let alone = ImageReader::new(&dataset, 1 << 20);
        same(at, &resolved(&alone, &images[at..=at]).await[0]);
    }
}

/// Frames that refer to later ones, and samples of ten bits, are lost with their reason, never a picture of another
/// frame; which ones, does not depend on how they are asked for.
#[tokio::test(flavor = "multi_thread")]
async fn what_foxglove_forbids_and_what_nobody_here_reads_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let usual = Style::usual(KEY_EVERY as u32, 10);
    let (b_frames, samples) = (2, Samples::Ten);
    for codec in [Codec::H264, Codec::H265] {
        for (name, style, reason) in [
            ("later", Style { b_frames, ..usual }, "waits for later ones"),
            ("ten", Style { samples, ..usual }, "8 bits, found YUV420P10"),
        ] {
            let path = folder.path().join(format!("{name}-{}.mcap", codec.name()));
            write(
                &path,
                Spelling::Foxglove,
                codec,
                &styled(codec, style),
                true,
            );
            let (dataset, images) = references(&path).await;
            assert_eq!(images.len(), FRAMES);
            let reader = ImageReader::new(&dataset, 1 << 20);
            let together = resolved(&reader, &images).await;
            let lost = together.iter().filter_map(|found| found.as_ref().err());
            let reasons: Vec<String> = lost.map(|fault| fault.message.clone()).collect();
            assert!(!reasons.is_empty(), "{codec:?}: {name}");
            let told = reasons.iter().all(|found| found.contains(reason));
            assert!(told, "{codec:?}: {reasons:?}");
            for at in 0..FRAMES {
                let alone = ImageReader::new(&dataset, 1 << 20);
                let alone = resolved(&alone, &images[at..=at]).await.remove(0);
                let [alone, same] = [&alone, &together[at]].map(|found| found.as_ref().ok());
                assert_eq!(alone, same, "{codec:?}: {name}, frame {at}");
            }
            let topic = reader.topic(&images[0]).await;
            assert_eq!(topic.as_deref(), Some("/camera/video"));
        }
    }
}
