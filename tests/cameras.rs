//! Cameras as ROS describes them: which part of a sensor is read, which way its bytes lie, which of several topics has its
//! images, and which lens those have that were rectified.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::{Path, PathBuf};

use evermap_tests::{Finished, evermap, text};
use serde_json::{Value, json};
use tempfile::TempDir;

const IMAGE: &str = "sensor_msgs/Image";

/// Sizes of the images: px.
const SIDE: usize = 160;

/// Logs of one camera, `front`, in a folder.
struct Logs(TempDir);

impl Logs {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a log of these topics, each with the name of its schema and messages, one a second.
    fn write(&self, name: &str, topics: &[(&str, &str, Vec<Value>)]) -> PathBuf {
        let path = self.path(name);
        let mut log = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
        for (topic, schema, messages) in topics {
            let members = match *schema {
                IMAGE => image_members(),
                "sensor_msgs/CameraInfo" => calibration_members(),
                _ => json!({"data": {"type": "string", "contentEncoding": "base64"}}),
            };
            let members = json!({"type": "object", "properties": members}).to_string();
            let schema = log.add_schema(schema, "jsonschema", members.as_bytes());
            let channel = log.add_channel(schema.unwrap(), topic, "json", &Default::default());
            let channel_id = channel.unwrap();
            for (second, message) in (1_u64..).zip(messages) {
                let header = mcap::records::MessageHeader {
                    channel_id,
                    sequence: 0,
                    log_time: second * 1_000_000_000,
                    publish_time: second * 1_000_000_000,
                };
                let payload = message.to_string();
                log.write_to_known_channel(&header, payload.as_bytes())
                    .unwrap();
            }
        }
        log.finish().unwrap();
        path
    }
}

fn object(members: Value) -> Value {
    json!({"type": "object", "properties": members})
}

fn header() -> Value {
    object(json!({"frame_id": {"type": "string"}}))
}

fn image_members() -> Value {
    let number = json!({"type": "integer"});
    json!({
        "header": header(), "height": number, "width": number, "encoding": {"type": "string"},
        "is_bigendian": number, "step": number, "data": {"type": "string", "contentEncoding": "base64"},
    })
}

fn calibration_members() -> Value {
    let number = json!({"type": "integer"});
    let numbers = json!({"type": "array", "items": {"type": "number"}});
    let roi = json!({"x_offset": number, "y_offset": number, "height": number, "width": number});
    json!({
        "header": header(), "height": number, "width": number, "distortion_model": {"type": "string"},
        "d": numbers, "k": numbers, "r": numbers, "p": numbers, "roi": object(roi),
    })
}

/// A calibration of a camera of 160 × 120 px, of which this part is read (offsets and size), with a P or without.
fn calibration([x, y, width, height]: [u32; 4], p: &[f64]) -> Value {
    json!({
        "header": {"frame_id": "front"}, "width": 160, "height": 120, "distortion_model": "plumb_bob",
        "d": [-0.1, 0.0, 0.0, 0.0, 0.0],
        "k": [128.0, 0.0, 79.5, 0.0, 128.0, 59.5, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": p,
        "roi": {"x_offset": x, "y_offset": y, "height": height, "width": width},
    })
}

const P: [f64; 12] = [
    100.0, 0.0, 80.0, 0.0, 0.0, 100.0, 60.0, 0.0, 0.0, 0.0, 1.0, 0.0,
];

/// A light rectangle on dark ground, of 16 bits a pixel whose lower eight are noise.
fn image(is_big_endian: bool) -> Value {
    let value = |at: usize| {
        let (x, y) = (at % SIDE, at / SIDE);
        let light = (60..100).contains(&x) && (70..90).contains(&y);
        let (high, low) = (if light { 200_u8 } else { 20 }, (at * at * 73 % 251) as u8);
        match is_big_endian {
            true => [high, low],
            false => [low, high],
        }
    };
    let bytes: Vec<u8> = (0..SIDE * SIDE).flat_map(value).collect();
    json!({
        "header": {"frame_id": "front"}, "height": SIDE, "width": SIDE, "encoding": "mono16",
        "is_bigendian": u8::from(is_big_endian), "step": 2 * SIDE, "data": base64(&bytes),
    })
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut letters = String::new();
    for three in bytes.chunks(3) {
        let at = |index: usize| u32::from(three.get(index).copied().unwrap_or(0));
        let bits = (at(0) << 16) | (at(1) << 8) | at(2);
        for (place, shift) in [18, 12, 6, 0].into_iter().enumerate() {
            let letter = LETTERS[((bits >> shift) & 63) as usize];
            letters.push(if place <= three.len() {
                letter.into()
            } else {
                '='
            });
        }
    }
    letters
}

fn query(log: &Path, more: &[&str], sql: &str) -> Finished {
    let mut arguments = vec!["sql", "--sessions", text(log), "--format", "json"];
    arguments.extend(more);
    arguments.extend(["--query", sql]);
    evermap(&arguments)
}

const LENSES: &str = "SELECT camera, width, height, intrinsics[1] AS fx, intrinsics[3] AS cx, intrinsics[6] AS cy, \
                      COALESCE(distortion[1], 0.0) AS k1 FROM calibration ORDER BY stamp";

const TOPICS: &str = "SELECT topic, camera, image['format'] AS format, count(*) AS n FROM frames \
                      GROUP BY 1, 2, 3 ORDER BY 1";

fn lens(size: [u32; 2], fx: f64, centre: [f64; 2], k1: f64) -> Value {
    json!({
        "camera": "front", "width": size[0], "height": size[1], "fx": fx, "cx": centre[0], "cy": centre[1],
        "k1": k1,
    })
}

#[test]
fn calibrations_are_of_the_part_of_the_sensor_that_is_read() {
    let logs = Logs::new();
    let parts = [
        [0, 0, 0, 0],
        [40, 30, 80, 60],
        [0, 0, 160, 120],
        [100, 0, 80, 60],
    ];
    let messages = parts.map(|part| calibration(part, &P)).to_vec();
    let info = ("/front/camera_info", "sensor_msgs/CameraInfo", messages);
    let log = logs.write("roi.mcap", &[info]);
    let found = query(&log, &[], LENSES).expect(3);
    let whole = lens([160, 120], 128.0, [79.5, 59.5], -0.1);
    let part = lens([80, 60], 128.0, [39.5, 29.5], -0.1);
    assert_eq!(found.json(), json!([whole, part, whole]));
    let said = "within the 160 × 120 px of the calibration, found 80 × 60 px from (100, 0) on";
    assert!(found.stderr.contains(said), "{}", found.stderr);
}

#[test]
fn a_twin_without_messages_hides_no_images() {
    let logs = Logs::new();
    let images = vec![image(false), image(false)];
    let silent = (
        "/front/image/compressed",
        "sensor_msgs/CompressedImage",
        Vec::new(),
    );
    let log = logs.write("twin.mcap", &[("/front/image", IMAGE, images), silent]);
    let found = query(&log, &[], TOPICS).expect(0).json();
    let expected =
        json!([{"topic": "/front/image", "camera": "front", "format": "mono16", "n": 2}]);
    assert_eq!(found, expected);
}

#[test]
fn samples_are_read_in_the_order_of_bytes_that_their_message_says() {
    let logs = Logs::new();
    let plan = logs.path("plan.yaml");
    let steps = "plan: seen
steps:
  images:
    sql: SELECT site, session, stamp, CAST(0 AS INT UNSIGNED) AS keyframe, camera, image FROM frames
  features:
    op: features
    in: { images: images }
    with: { scale: 1.0, count: 20, octaves: 0 }
write: [features]
";
    std::fs::write(&plan, steps).unwrap();
    let features = |name: &str, is_big_endian: bool| {
        let images = ("/front/image", IMAGE, vec![image(is_big_endian)]);
        let log = logs.write(&format!("{name}.mcap"), &[images]);
        let map = logs.path(name);
        let run = [
            "run",
            text(&plan),
            "--map",
            text(&map),
            "--progress",
            "none",
        ];
        evermap(&[&run[..], &["--sessions", text(&log)]].concat()).expect(0);
        let sql = "SELECT u, v, size_px FROM features";
        let found = evermap(&["sql", "--map", text(&map), "--format", "json", sql]);
        found.expect(0).json()
    };
    let (little, big) = (features("little", false), features("big", true));
    let found = little[0]["u"].as_array().unwrap().len();
    assert!((1..=8).contains(&found), "{little}");
    assert_eq!(big, little);
}

#[test]
fn rectified_images_have_the_lens_of_p_and_others_go_before_them() {
    let logs = Logs::new();
    let info = |p: &[f64]| {
        let said = vec![calibration([0; 4], p)];
        ("/front/camera_info", "sensor_msgs/CameraInfo", said)
    };
    let raw = ("/front/image_raw", IMAGE, vec![image(false)]);
    let rect = ("/front/image_rect", IMAGE, vec![image(false)]);
    let of = |topic: &str| json!([{"topic": topic, "camera": "front", "format": "mono16", "n": 1}]);

    let both = logs.write("both.mcap", &[info(&P), raw, rect.clone()]);
    let found = query(&both, &[], TOPICS).expect(0);
    assert_eq!(found.json(), of("/front/image_raw"));
    let note = "frames is read from /front/image_raw, as the calibration is of images that are not rectified; \
                /front/image_rect would do too";
    assert!(found.stderr.contains(note), "{}", found.stderr);
    let as_seen = json!([lens([160, 120], 128.0, [79.5, 59.5], -0.1)]);
    assert_eq!(query(&both, &[], LENSES).expect(0).json(), as_seen);

    // Whoever takes both has those that the calibration is of.
    let manifest = logs.path("manifest.yaml");
    std::fs::write(&manifest, "roles: { frames: '/front/image*' }").unwrap();
    let chosen = ["--manifest", text(&manifest)];
    let found = query(&both, &chosen, TOPICS).expect(3);
    assert_eq!(found.json(), of("/front/image_raw"));
    let said = "found one of a rectified topic";
    assert!(found.stderr.contains(said), "{}", found.stderr);

    let pinhole = json!([lens([160, 120], 100.0, [80.0, 60.0], 0.0)]);
    std::fs::write(&manifest, "roles: { frames: /front/image_rect }").unwrap();
    assert_eq!(query(&both, &chosen, LENSES).expect(0).json(), pinhole);
    let alone = logs.write("alone.mcap", &[info(&P), rect.clone()]);
    let found = query(&alone, &[], TOPICS).expect(0).json();
    assert_eq!(found, of("/front/image_rect"));
    assert_eq!(query(&alone, &[], LENSES).expect(0).json(), pinhole);

    let without = logs.write("without.mcap", &[info(&[]), rect]);
    let found = query(&without, &[], LENSES).expect(3);
    assert_eq!(found.json(), json!([]));
    assert!(found.stderr.contains("expected P"), "{}", found.stderr);
}
