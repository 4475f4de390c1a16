//! Cameras as ROS describes them: which part of a sensor is read, which way its bytes lie, which of several topics has its
//! images, which lens those have that were rectified, and whose frame they name.

use std::path::{Path, PathBuf};

use evermap_tests::json_log::JsonLog;
use evermap_tests::{Finished, evermap, rows_of, run, text};
use serde_json::{Value, json};
use tempfile::TempDir;

const IMAGE: &str = "sensor_msgs/Image";
const TRANSFORM: &str = "foxglove.FrameTransform";
const FOXGLOVE: &str = "foxglove.CameraCalibration";

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
        let mut log = JsonLog::new(&path);
        for (topic, schema, messages) in topics {
            let members = match *schema {
                IMAGE => image_members(),
                "sensor_msgs/CameraInfo" => calibration_members(),
                FOXGLOVE => foxglove_members(),
                TRANSFORM => transform_members(),
                _ => json!({"data": {"type": "string", "contentEncoding": "base64"}}),
            };
            let topic = log.topic_of(topic, schema, &members);
            for (second, message) in (1_u64..).zip(messages) {
                log.send(topic, 0, second * 1_000_000_000, message);
            }
        }
        log.finish();
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

fn foxglove_members() -> Value {
    let (number, string) = (json!({"type": "integer"}), json!({"type": "string"}));
    let numbers = json!({"type": "array", "items": {"type": "number"}});
    json!({
        "frame_id": string, "height": number, "width": number, "distortion_model": string, "D": numbers,
        "K": numbers, "R": numbers, "P": numbers,
    })
}

fn transform_members() -> Value {
    let (number, string) = (json!({"type": "number"}), json!({"type": "string"}));
    json!({
        "parent_frame_id": string, "child_frame_id": string,
        "translation": object(json!({"x": number, "y": number, "z": number})),
        "rotation": object(json!({"x": number, "y": number, "z": number, "w": number})),
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

/// Squares of several greys, of 16 bits a pixel whose lower eight are noise.
fn image(is_big_endian: bool) -> Value {
    image_of_bits(16, is_big_endian)
}

/// The same, of which the upper bits are kept, as a camera that has so many sends them.
fn image_of_bits(bits: u32, is_big_endian: bool) -> Value {
    let value = |at: usize| {
        let (x, y) = (at % SIDE, at / SIDE);
        let square = x / 16 + 10 * (y / 16);
        let [high, low] =
            [20 + square * square * 37 % 200, at * at * 73 % 251].map(|value| value as u8);
        let sample = u16::from_be_bytes([high, low]) >> (16 - bits);
        match is_big_endian {
            true => sample.to_be_bytes(),
            false => sample.to_le_bytes(),
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

/// Looks for features in an image, and has what is found where that ends so.
fn features(logs: &Logs, name: &str, image: Value, code: i32) -> (Value, String) {
    features_with(logs, name, image, &[], code)
}

/// The same, with more arguments for the run.
fn features_with(
    logs: &Logs,
    name: &str,
    image: Value,
    more: &[&str],
    code: i32,
) -> (Value, String) {
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
    let log = logs.write(
        &format!("{name}.mcap"),
        &[("/front/image", IMAGE, vec![image])],
    );
    let map = logs.path(name);
    let ended = run(text(&plan), &map, &[&log], more).expect(code);
    let sql = "SELECT u, v, size_px FROM features";
    (rows_of(&map, sql), ended.stderr)
}

#[test]
fn samples_are_read_in_the_order_of_bytes_that_their_message_says() {
    let logs = Logs::new();
    let (little, _) = features(&logs, "little", image(false), 0);
    let (big, _) = features(&logs, "big", image(true), 0);
    let found = little[0]["u"].as_array().unwrap().len();
    assert!((1..=20).contains(&found), "{little}");
    assert_eq!(big, little);
}

/// An image of 16 bits a pixel, of which the upper four are never used: it is counted.
fn faint() -> Value {
    let twelve: Vec<u8> = (0..SIDE * SIDE)
        .flat_map(|at| ((at % 4096) as u16).to_le_bytes())
        .collect();
    let mut faint = image(false);
    faint["data"] = json!(base64(&twelve));
    faint
}

#[test]
fn images_of_fewer_bits_than_their_samples_are_counted() {
    let logs = Logs::new();
    let (found, told) = features(&logs, "faint", faint(), 3);
    assert_eq!(found, json!([]));
    let said = "camera `front` (mono16) does not decode: expected values that fill their 16 bits, found none above 4095";
    assert!(told.contains(said), "{told}");
}

#[test]
fn images_that_several_steps_cannot_read_are_told_once_with_the_steps() {
    let logs = Logs::new();
    let plan = logs.path("twice.yaml");
    let steps = "plan: twice
steps:
  images:
    sql: SELECT site, session, stamp, CAST(0 AS INT UNSIGNED) AS keyframe, camera, image FROM frames
  features:
    op: features
    in: { images: images }
    with: { scale: 1.0, count: 20, octaves: 0 }
  few_features:
    op: features
    in: { images: images }
    with: { scale: 1.0, count: 5, octaves: 0 }
write: [features, few_features]
";
    std::fs::write(&plan, steps).unwrap();
    let images = vec![faint(), image(false), faint()];
    let log = logs.write("twice.mcap", &[("/front/image", IMAGE, images)]);
    let map = logs.path("twice");
    let told = run(text(&plan), &map, &[&log], &[]).expect(3).stderr;
    for said in [
        "finished with loss: 2 skipped or lost",
        "       2  image of camera `front` (mono16) does not decode: expected values that fill their 16 bits",
        "(told by features and few_features; the largest of their counts)",
    ] {
        assert!(told.contains(said), "{said}: {told}");
    }
    assert_eq!(told.matches("does not decode").count(), 1, "{told}");
    // What each step counted is there still.
    let of_steps = rows_of(
        &map,
        "SELECT step, lost FROM runs WHERE lost > 0 ORDER BY step",
    );
    let both = ["features", "few_features"].map(|step| json!({"step": step, "lost": 2}));
    assert_eq!(of_steps, json!(both));
    let of_version = rows_of(&map, "SELECT lost FROM versions");
    assert_eq!(of_version, json!([{"lost": 2}]));
}

/// Range images whose topic does not speak of depth.
#[test]
fn pictures_of_floating_point_are_counted_and_told_with_what_a_manifest_may_say() {
    let logs = Logs::new();
    let metres: Vec<u8> = (0..SIDE * SIDE)
        .flat_map(|at| (at as f32 * 0.001).to_le_bytes())
        .collect();
    let mut ranges = image(false);
    ranges["encoding"] = json!("32FC1");
    ranges["step"] = json!(4 * SIDE);
    ranges["data"] = json!(base64(&metres));
    let (found, told) = features(&logs, "ranges", ranges, 3);
    assert_eq!(found, json!([]));
    for said in [
        "image of camera `front` (32FC1) does not decode: expected a picture, found samples of floating point",
        "give their topic to `depth_frames`, and not to `frames`, by `roles` in a session manifest",
    ] {
        assert!(told.contains(said), "{said}: {told}");
    }
    let log = logs.path("ranges.mcap");
    let inspected = evermap(&["inspect", text(&log)]).expect(0).stdout;
    let checked = check(&logs.path("plan.yaml"), &log).expect(0).stderr;
    for said in [inspected, checked] {
        let note = "expected pictures, found samples of floating point (32FC1) on /front/image;";
        assert!(said.contains(note), "{said}");
    }
    let manifest = logs.path("ranges.yaml");
    std::fs::write(&manifest, "roles: { depth_frames: /front/image }\n").unwrap();
    let depth = TOPICS.replace("FROM frames", "FROM depth_frames");
    let found = query(&log, &["--manifest", text(&manifest)], &depth).expect(0);
    let expected = json!([{"topic": "/front/image", "camera": "front", "format": "32FC1", "n": 1}]);
    assert_eq!(found.json(), expected);
}

/// A camera whose name speaks of depth, and one whose name does so in passing.
#[test]
fn pictures_that_have_the_role_of_range_images_are_told_and_a_camera_of_depth_has_pictures() {
    let logs = Logs::new();
    let jpeg = json!({"data": base64(&[0xff, 0xd8, 0xff, 0xe0, 0, 0])});
    let send = |topic| (topic, "foxglove.CompressedImage", vec![jpeg.clone()]);
    let topics = [
        send("/front/depth/image"),
        send("/depth_camera/image/compressed"),
    ];
    let log = logs.write("depth.mcap", &topics);
    let said = evermap(&["inspect", text(&log)]).expect(0).stdout;
    let note = "expected range images, found JPEG on /front/depth/image; if these are pictures, give their topics to \
                `frames`, and not to `depth_frames`,";
    assert!(said.contains(note), "{said}");
    let found = query(&log, &[], TOPICS).expect(0).json();
    assert_eq!(found[0]["topic"], "/depth_camera/image/compressed");
    assert_eq!(found[1], Value::Null);
}

#[test]
fn a_manifest_says_how_many_bits_samples_have() {
    let logs = Logs::new();
    let (expected, _) = features(&logs, "sixteen", image(false), 0);
    let manifest = |name: &str, bits: &str| {
        let path = logs.path(name);
        std::fs::write(&path, bits).unwrap();
        path
    };
    let right = manifest("right.yaml", "bits: { '/front/*': 12, /fromt/image: 10 }\n");
    let with_right = ["--manifest", text(&right)];
    for is_big_endian in [false, true] {
        let twelve = image_of_bits(12, is_big_endian);
        let name = format!("twelve_{is_big_endian}");
        let (none, told) = features(&logs, &name, twelve.clone(), 3);
        assert_eq!(none, json!([]));
        assert!(told.contains("`bits` in a session manifest"), "{told}");
        // What the manifest says is part of what was done: the map is made anew.
        let (found, told) = features_with(&logs, &name, twelve, &with_right, 0);
        assert_eq!(found, expected);
        let said = "`bits` names `/fromt/image`, which no session has";
        assert!(told.contains(said), "{told}");
        let log = logs.path(&format!("{name}.mcap"));
        let formats = query(&log, &with_right, TOPICS).expect(0).json();
        let format = formats[0]["format"].as_str().unwrap_or_default().to_owned();
        assert!(format.starts_with("mono16 12-bit"), "{format}");
        assert_eq!(format.ends_with(" big-endian"), is_big_endian);
    }
    let fewer = manifest("fewer.yaml", "bits: { /front/image: 10 }\n");
    let with_fewer = ["--manifest", text(&fewer)];
    let (none, told) = features_with(&logs, "fewer", image_of_bits(12, false), &with_fewer, 3);
    assert_eq!(none, json!([]));
    assert!(told.contains("expected samples of 10 bits"), "{told}");
    let wrong = manifest("wrong.yaml", "site: lot\nbits: { /front/image: 11 }\n");
    let log = logs.path("fewer.mcap");
    let refused = query(&log, &["--manifest", text(&wrong)], TOPICS).expect(1);
    let said = "expected 10, 12 or 14 bits for /front/image, found 11";
    assert!(refused.stderr.contains(said), "{}", refused.stderr);
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

/// R, row by row, of a turn about y.
fn about_y(degrees: f64) -> [f64; 9] {
    let (sin, cos) = degrees.to_radians().sin_cos();
    [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos]
}

/// The calibration of a rectified camera of the frame `front`, with the translation of P along x.
fn rectified(r: [f64; 9], tx: f64) -> Value {
    let mut p = P;
    p[3] = tx;
    let mut said = calibration([0; 4], &p);
    said["r"] = json!(r);
    said
}

/// The same as Foxglove spells it.
fn spelt_by_foxglove(said: &Value) -> Value {
    json!({
        "frame_id": "front", "width": 160, "height": 120, "distortion_model": "plumb_bob",
        "D": said["d"], "K": said["k"], "R": said["r"], "P": said["p"],
    })
}

/// Where cameras are mounted in which frame, and the part of their turn about y.
const MOUNTS: &str = "SELECT camera, mount['frame'] AS frame, round(mount['frame_from_camera']['x'], 6) AS x, \
                      round(mount['frame_from_camera']['z'], 6) AS z, \
                      round(mount['frame_from_camera']['qy'], 6) AS qy FROM calibration ORDER BY camera";

#[test]
fn a_pair_of_rectified_cameras_that_name_one_frame_is_two_and_looks_along_the_first_ones_images() {
    let logs = Logs::new();
    let mount = json!({
        "parent_frame_id": "base_link", "child_frame_id": "front",
        "translation": {"x": 1.0, "y": 0.0, "z": 1.5},
        "rotation": {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5},
    });
    // The baseline is 0.12 m. R of the second one is of its own axes, whose frame nobody names.
    let (left, right) = (
        rectified(about_y(5.0), 0.0),
        rectified(about_y(-3.0), -12.0),
    );
    for (name, schema) in [("ros", "sensor_msgs/CameraInfo"), ("foxglove", FOXGLOVE)] {
        let info = |topic, said: &Value| {
            let said = match schema {
                FOXGLOVE => spelt_by_foxglove(said),
                _ => said.clone(),
            };
            (topic, schema, vec![said.clone(), said])
        };
        let images = |topic| (topic, IMAGE, vec![image(false)]);
        let log = logs.write(
            &format!("{name}.mcap"),
            &[
                ("/tf_static", TRANSFORM, vec![mount.clone()]),
                info("/stereo/right/camera_info", &right),
                info("/stereo/left/camera_info", &left),
                images("/stereo/left/image_rect"),
                images("/stereo/right/image_rect"),
            ],
        );
        let of = |camera: &str, topic: &str| json!({"topic": topic, "camera": camera, "format": "mono16", "n": 1});
        let expected = json!([
            of("front", "/stereo/left/image_rect"),
            of("stereo/right", "/stereo/right/image_rect"),
        ]);
        assert_eq!(query(&log, &[], TOPICS).expect(0).json(), expected);
        let expected = json!([
            {"camera": "front", "frame": "front", "x": 0.0, "z": 0.0, "qy": -0.043619},
            {"camera": "stereo/right", "frame": "front", "x": 0.119543, "z": 0.010459, "qy": -0.043619},
        ]);
        assert_eq!(query(&log, &[], MOUNTS).expect(0).json(), expected);
        let said = evermap(&["inspect", text(&log)]).expect(0).stdout;
        let told = "stereo/right (/stereo/right/image_rect): mounted on base_link";
        assert!(said.contains(told), "{said}");
    }
}

#[test]
fn a_rectified_camera_whose_r_turns_nothing_is_counted() {
    let logs = Logs::new();
    let mut mirrored = about_y(5.0);
    mirrored[4] = -1.0;
    let said = vec![rectified(mirrored, 0.0)];
    let info = ("/front/camera_info", "sensor_msgs/CameraInfo", said);
    let rect = ("/front/image_rect", IMAGE, vec![image(false)]);
    let log = logs.write("mirrored.mcap", &[info, rect]);
    let found = query(&log, &[], LENSES).expect(3);
    assert_eq!(found.json(), json!([]));
    let said = "expected R to be a rotation";
    assert!(found.stderr.contains(said), "{}", found.stderr);
}

/// A stereo pair that names one frame, with these calibrations and images of these topics' last part.
fn write_pair(logs: &Logs, name: &str, [left, right]: [&[Value]; 2], kind: &str) -> PathBuf {
    let [left_images, right_images] = ["left", "right"].map(|of| format!("/stereo/{of}/{kind}"));
    let info = "sensor_msgs/CameraInfo";
    logs.write(
        &format!("{name}.mcap"),
        &[
            ("/stereo/right/camera_info", info, right.to_vec()),
            ("/stereo/left/camera_info", info, left.to_vec()),
            (left_images.as_str(), IMAGE, vec![image(false)]),
            (right_images.as_str(), IMAGE, vec![image(false)]),
        ],
    )
}

/// What a pair is told whose second camera is left out.
const SECOND_LEFT_OUT: &str = "cameras that name the frame of another one on /stereo/right/camera_info: /stereo/right names \
                               the frame front of /stereo/left, and nobody knows how the two stand to each other";

#[test]
fn the_second_camera_of_a_pair_is_left_out_and_counted_where_r_or_p_of_either_makes_no_sense() {
    let logs = Logs::new();
    let (left, right) = (
        rectified(about_y(5.0), 0.0),
        rectified(about_y(-3.0), -12.0),
    );
    let no_turn = |tx| rectified([1.0; 9], tx);
    let cases = [
        ("left_r", [no_turn(0.0), right.clone()], "left: expected R"),
        (
            "right_r",
            [left.clone(), no_turn(-12.0)],
            "right: expected R",
        ),
        (
            "right_p",
            [left.clone(), rectified(about_y(-3.0), -1e30)],
            "right: expected P",
        ),
    ];
    for (name, [first, second], why) in cases {
        // Where only the first message is so, as where all are: it says where cameras are mounted.
        let pair = [&[first, left.clone()][..], &[second, right.clone()]];
        let log = write_pair(&logs, name, pair, "image_raw");
        let told = |finished: Finished| {
            let finished = finished.expect(3);
            for said in [
                SECOND_LEFT_OUT,
                why,
                "finished with loss: 1 skipped or lost",
            ] {
                assert!(finished.stderr.contains(said), "{}", finished.stderr);
            }
            finished.json()
        };
        let of_left = json!([{"topic": "/stereo/left/image_raw", "camera": "front", "format": "mono16", "n": 1}]);
        assert_eq!(told(query(&log, &[], TOPICS)), of_left);
        let whole = lens([160, 120], 128.0, [79.5, 59.5], -0.1);
        assert_eq!(told(query(&log, &[], LENSES)), json!([whole]));
    }
    let pair = [&[left][..], &[right]];
    let sound = write_pair(&logs, "sound", pair, "image_raw");
    let mounts = query(&sound, &[], MOUNTS).expect(0).json();
    assert_eq!(mounts[1]["camera"], json!("stereo/right"), "{mounts}");
    assert_eq!(mounts[1]["x"], json!(0.119543), "{mounts}");
}

#[test]
fn the_second_camera_of_a_pair_does_not_take_the_place_of_a_first_one_whose_calibration_is_refused()
{
    let logs = Logs::new();
    let (left, right) = (rectified([1.0; 9], 0.0), rectified(about_y(-3.0), -12.0));
    let pair = [&[left][..], &[right]];
    let log = write_pair(&logs, "refused", pair, "image_rect");
    let told = |finished: Finished| {
        let finished = finished.expect(3);
        for said in [
            SECOND_LEFT_OUT,
            "expected R to be a rotation",
            "finished with loss: 2 skipped or lost",
        ] {
            assert!(finished.stderr.contains(said), "{}", finished.stderr);
        }
        finished.json()
    };
    assert_eq!(told(query(&log, &[], LENSES)), json!([]));
    let of_left = json!([
        {"topic": "/stereo/left/image_rect", "camera": "stereo/left", "format": "mono16", "n": 1},
    ]);
    assert_eq!(told(query(&log, &[], TOPICS)), of_left);
}

/// A plan that reads cameras.
fn write_plan(logs: &Logs) -> PathBuf {
    let plan = logs.path("cameras.yaml");
    let steps = "plan: cameras
steps:
  lenses:
    sql: SELECT site, session, stamp, camera, width FROM calibration
write: [lenses]
";
    std::fs::write(&plan, steps).unwrap();
    plan
}

fn check(plan: &Path, log: &Path) -> Finished {
    evermap(&["check", text(plan), "--sessions", text(log)])
}

#[test]
fn of_two_cameras_that_name_one_frame_the_first_is_read_and_the_other_is_counted_once() {
    let logs = Logs::new();
    let info = |camera: &'static str, part| {
        let said = vec![calibration(part, &P), calibration(part, &P)];
        (camera, "sensor_msgs/CameraInfo", said)
    };
    let images = |topic: &'static str| (topic, IMAGE, vec![image(false), image(false)]);
    // The second of the two comes first in the log, and has another lens.
    let right = info("/camera/front_right/camera_info", [40, 30, 80, 60]);
    let left = info("/camera/front/camera_info", [0; 4]);
    let stereo = [
        right,
        left,
        images("/camera/front_right/image"),
        images("/camera/front/image"),
    ];
    let log = logs.write("stereo.mcap", &stereo);
    let whole = lens([160, 120], 128.0, [79.5, 59.5], -0.1);
    let part = lens([80, 60], 128.0, [39.5, 29.5], -0.1);
    let of = |topic: &str| json!([{"topic": topic, "camera": "front", "format": "mono16", "n": 2}]);
    let said = "cameras that name the frame of another one on /camera/front_right/camera_info: /camera/front and /camera/front_right are both of frame front: only \
                the first is read; choose with `roles: frames`";
    let told = |finished: Finished| {
        let finished = finished.expect(3);
        assert!(finished.stderr.contains(said), "{}", finished.stderr);
        let count = "finished with loss: 1 skipped or lost";
        assert!(finished.stderr.contains(count), "{}", finished.stderr);
        finished
    };
    assert_eq!(
        told(query(&log, &[], TOPICS)).json(),
        of("/camera/front/image")
    );
    assert_eq!(told(query(&log, &[], LENSES)).json(), json!([whole]));
    told(check(&write_plan(&logs), &log));
    told(evermap(&["inspect", text(&log)]));

    let manifest = logs.path("manifest.yaml");
    std::fs::write(&manifest, "roles: { frames: /camera/front_right/image }").unwrap();
    let chosen = ["--manifest", text(&manifest)];
    let found = query(&log, &chosen, TOPICS).expect(0).json();
    assert_eq!(found, of("/camera/front_right/image"));
    assert_eq!(query(&log, &chosen, LENSES).expect(0).json(), json!([part]));
}

#[test]
fn range_images_that_are_aligned_to_a_camera_do_not_take_its_name() {
    let logs = Logs::new();
    let said = |topic| {
        (
            topic,
            "sensor_msgs/CameraInfo",
            vec![calibration([0; 4], &P)],
        )
    };
    let images = |topic| (topic, IMAGE, vec![image(false)]);
    let log = logs.write(
        "aligned.mcap",
        &[
            said("/aligned_depth/camera_info"),
            said("/color/camera_info"),
            images("/aligned_depth/image_raw"),
            images("/color/image_raw"),
        ],
    );
    let of = |topic: &str| json!([{"topic": topic, "camera": "front", "format": "mono16", "n": 1}]);
    let found = query(&log, &[], TOPICS).expect(0).json();
    assert_eq!(found, of("/color/image_raw"));
    let found = query(
        &log,
        &[],
        &TOPICS.replace("FROM frames", "FROM depth_frames"),
    );
    assert_eq!(found.expect(0).json(), of("/aligned_depth/image_raw"));
}

#[test]
fn a_camera_whose_frame_looks_along_x_is_told() {
    let logs = Logs::new();
    let plan = write_plan(&logs);
    let notes = |name: &str, rotation: [f64; 4]| {
        let [x, y, z, w] = rotation;
        let mount = json!({
            "parent_frame_id": "base_link", "child_frame_id": "front",
            "translation": {"x": 1.0, "y": 0.0, "z": 1.5}, "rotation": {"x": x, "y": y, "z": z, "w": w},
        });
        let said = vec![calibration([0; 4], &P)];
        let topics = [
            ("/tf_static", TRANSFORM, vec![mount]),
            ("/front/camera_info", "sensor_msgs/CameraInfo", said),
            ("/front/image", IMAGE, vec![image(false)]),
        ];
        let log = logs.write(&format!("{name}.mcap"), &topics);
        let inspected = evermap(&["inspect", text(&log)]).expect(0).stdout;
        let checked = check(&plan, &log).expect(0).stderr;
        [inspected, checked].map(|said| said.contains("from straight up: front 0°; images"))
    };
    assert_eq!(notes("link", [0.0, 0.0, 0.0, 1.0]), [true, true]);
    assert_eq!(notes("optical", [-0.5, 0.5, -0.5, 0.5]), [false, false]);
}

#[test]
fn a_camera_that_says_that_it_is_uncalibrated_is_told_and_keeps_its_frame() {
    let logs = Logs::new();
    let mount = json!({
        "parent_frame_id": "base_link", "child_frame_id": "front",
        "translation": {"x": 1.0, "y": 0.0, "z": 1.5}, "rotation": {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5},
    });
    let mut uncalibrated = calibration([0; 4], &[0.0; 12]);
    uncalibrated["k"] = json!(vec![0.0; 9]);
    let topics = [
        ("/tf_static", TRANSFORM, vec![mount]),
        (
            "/usb_cam/camera_info",
            "sensor_msgs/CameraInfo",
            vec![uncalibrated],
        ),
        ("/usb_cam/image", IMAGE, vec![image(false)]),
    ];
    let log = logs.write("uncalibrated.mcap", &topics);
    let said = "messages with invalid values on /usb_cam/camera_info: expected a focal length, found K[0] = 0: \
                the calibration says that the camera is uncalibrated";
    let inspected = evermap(&["inspect", text(&log)]).expect(3);
    let checked = check(&write_plan(&logs), &log).expect(3);
    for finished in [&inspected, &checked] {
        assert!(finished.stderr.contains(said), "{}", finished.stderr);
    }
    let mounted = "front (/usb_cam/image): mounted on base_link";
    assert!(inspected.stdout.contains(mounted), "{}", inspected.stdout);
}

/// ROS 1's `static_transform_publisher`, and logs with one topic of transforms, send mounts again and again.
#[test]
fn a_mount_that_is_sent_again_and_again_is_fixed_and_a_camera_that_moves_once_is_told() {
    let logs = Logs::new();
    let plan = write_plan(&logs);
    let sent = |x: f64| {
        json!({
            "parent_frame_id": "base_link", "child_frame_id": "front",
            "translation": {"x": x, "y": 0.0, "z": 1.5},
            "rotation": {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5},
        })
    };
    let odometry = |second: f64| {
        json!({
            "parent_frame_id": "odom", "child_frame_id": "base_link",
            "translation": {"x": second, "y": 0.0, "z": 0.0},
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        })
    };
    let told = |name: &str, mounts: [f64; 3]| {
        let mounts = mounts.map(sent).to_vec();
        let moved = [0.0, 1.0, 2.0].map(odometry).to_vec();
        let topics = [
            ("/tf", TRANSFORM, [mounts, moved].concat()),
            (
                "/front/camera_info",
                "sensor_msgs/CameraInfo",
                vec![calibration([0; 4], &P)],
            ),
            ("/front/image", IMAGE, vec![image(false)]),
        ];
        let log = logs.write(name, &topics);
        let inspected = evermap(&["inspect", text(&log)]).expect(0).stdout;
        let checked = check(&plan, &log).expect(0).stderr;
        let fixed = "SELECT child, parent_from_child['x'] AS x FROM transforms WHERE fixed";
        (inspected, checked, query(&log, &[], fixed).expect(0).json())
    };
    let unmounted = "no fixed transform says where";
    let (inspected, checked, fixed) = told("repeated.mcap", [1.0; 3]);
    assert!(
        inspected.contains("front (/front/image): mounted on base_link"),
        "{inspected}"
    );
    assert!(!inspected.contains(unmounted), "{inspected}");
    assert!(!checked.contains("transforms move"), "{checked}");
    assert_eq!(fixed, json!([{"child": "front", "x": 1.0}]));
    let (inspected, checked, fixed) = told("steered.mcap", [1.0, 1.0, 1.1]);
    for said in [
        "no fixed transform says where it is mounted: it moves in base_link",
        "lacks transforms (step mounts): no fixed transform says where a camera is mounted",
    ] {
        assert!(inspected.contains(said), "{said}: {inspected}");
    }
    for said in [&inspected, &checked] {
        assert!(
            said.contains("found some that transforms move: front in base_link"),
            "{said}"
        );
    }
    assert_eq!(fixed, json!([]));
}

const MASKED: &str = "plan: masked
steps:
  keyframes: { op: keyframes, in: { frames: frames }, with: { baseline_m: 0.5 } }
  images:
    sql: >
      SELECT site, session, stamp, keyframe, image['camera'] AS camera, image['image'] AS image
      FROM (SELECT site, session, stamp, keyframe, unnest(images) AS image FROM keyframes)
  body_masks: { op: body_masks, in: { images: images } }
  features:
    op: features
    in: { images: images, body_masks: body_masks }
    with: { scale: 1.0, count: 40, octaves: 0 }
write: [body_masks, features]
";

/// A PGM of the images' size that is not 0 on this side of its middle.
fn half(is_right: bool, value: u8) -> Vec<u8> {
    let pixel = |at: usize| ((at % SIDE >= SIDE / 2) == is_right).then_some(value);
    let pixels = (0..SIDE * SIDE).map(|at| pixel(at).unwrap_or(0));
    let head = format!("P5\n{SIDE} {SIDE}\n255\n").into_bytes();
    head.into_iter().chain(pixels).collect()
}

#[test]
fn an_image_in_a_manifest_says_where_a_camera_shows_its_vehicle() {
    let logs = Logs::new();
    let plan = logs.path("masked.yaml");
    std::fs::write(&plan, MASKED).unwrap();
    let odometry = |second: f64| {
        json!({
            "parent_frame_id": "odom", "child_frame_id": "base_link",
            "translation": {"x": second, "y": 0.0, "z": 0.0},
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        })
    };
    let topics = [
        ("/tf", TRANSFORM, [0.0, 1.0, 2.0].map(odometry).to_vec()),
        ("/front/image", IMAGE, vec![image(false); 3]),
    ];
    let log = logs.write("masked.mcap", &topics);
    let manifest = logs.path("lot.yaml");
    let named = "defaults:\n  mask:\n    front: body.pgm\n";
    std::fs::write(&manifest, named).unwrap();
    let (map, body) = (logs.path("masked"), logs.path("body.pgm"));
    let ended = || run(text(&plan), &map, &[&log], &["--manifest", text(&manifest)]);
    // Features left of the middle and right of it, and the versions there are.
    let sides = || {
        let sides = "SELECT count(*) FILTER (WHERE u < 79.5) AS l, count(*) FILTER (WHERE u > 79.5) AS r \
                     FROM (SELECT unnest(u) AS u FROM features)";
        let [sides, versions] =
            [sides, "SELECT count(*) AS n FROM versions"].map(|sql| rows_of(&map, sql)[0].clone());
        let of = |side: &str| sides[side].as_u64().unwrap();
        ([of("l"), of("r")], versions["n"].as_u64().unwrap())
    };
    std::fs::write(&body, half(true, 255)).unwrap();
    ended().expect(0);
    let ([left, right], _) = sides();
    assert!(left > 0 && right == 0, "{left} and {right}");
    let masks = rows_of(&map, "SELECT camera, width, images, share FROM body_masks");
    let given = json!([{"camera": "front", "width": SIDE, "images": 0, "share": 0.5}]);
    assert_eq!(masks, given);
    // The same mask in other bytes is the same; another one in the same file is not.
    std::fs::write(&body, half(true, 1)).unwrap();
    ended().expect(0);
    assert_eq!(sides().1, 1);
    std::fs::write(&body, half(false, 255)).unwrap();
    ended().expect(0);
    let ([left, right], versions) = sides();
    assert!(left == 0 && right > 0, "{left} and {right}");
    assert_eq!(versions, 2);

    // The plan as composed names the file, and nobody reads what changed pixel by pixel.
    let explain = ["explain", text(&plan), "--manifest", text(&manifest)];
    let composed = evermap(&explain).expect(0).stdout;
    assert!(composed.contains(text(&body)), "{composed}");
    assert!(!composed.contains("hex"), "{composed}");
    let mut other = half(false, 255);
    *other.last_mut().unwrap() = 255;
    std::fs::write(&body, other).unwrap();
    let more = [
        "--sessions",
        text(&log),
        "--map",
        text(&map),
        "--format",
        "json",
    ];
    let forecast = evermap(&[&explain[..], &more].concat()).expect(0).stdout;
    assert!(
        forecast.contains("body_masks.mask has changed"),
        "{forecast}"
    );

    let refused = |at_once: bool, said: &str| {
        let told = ended().expect(1).stderr;
        assert!(told.contains(said), "{said}: {told}");
        let place = format!("{}:3:12", text(&manifest));
        assert_eq!(told.contains(&place), at_once, "{told}");
        assert_eq!(sides().1, 2);
    };
    std::fs::write(&body, b"P5\n99999 99999\n255\n").unwrap();
    refused(true, "/body.pgm: expected 1 to ");
    std::fs::write(&body, "body").unwrap();
    refused(true, "/body.pgm: expected a png or pgm with one value");
    std::fs::remove_file(&body).unwrap();
    refused(true, "expected a file for `front`, found nothing at ");
    let pipe = std::process::Command::new("mkfifo").arg(&body).status();
    assert!(pipe.unwrap().success());
    refused(
        true,
        "expected a file for `front`, found a named pipe, and no file at ",
    );
    std::fs::remove_file(&body).unwrap();
    std::fs::write(&body, b"P5\n2 1\n255\n\0\x01").unwrap();
    refused(
        false,
        "expected a mask of camera `front` of 160 x 160 pixels",
    );
}
