//! A drive whose cameras record video maps as its JPEG twin does; frames that are lost say where and why.
//!
//! Figures are printed with `-- --nocapture`.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use evermap_ffmpeg::{Encoder, Style};
use evermap_messages::ros2::{CompressedImage, Header, Message};
use evermap_tests::park::{FEWER, Park, finished};
use evermap_tests::trajectories::{map_error, poses, rows};
use evermap_tests::{Finished, plan_command, program, text};
use evermap_video::Codec;
use evermap_vision::{Rgb, decode_colour};

/// A camera's frames, from JPEG to video.
struct Camera {
    encoder: Encoder,
    frames: usize,
}

/// `sensor_msgs/msg/CompressedImage`, read from its CDR.
fn compressed_image(cdr: &[u8]) -> CompressedImage<'_> {
    let number = |at: usize| u32::from_le_bytes(cdr[at..at + 4].try_into().unwrap()) as usize;
    let (stamp_ns, at) = (number(4) as u64 * 1_000_000_000 + number(8) as u64, 12);
    // A text has its length, with a zero byte at its end, and what comes next begins at a multiple of four.
    let string = |at: usize| {
        let end = at + 4 + number(at);
        let string = std::str::from_utf8(&cdr[at + 4..end - 1]).unwrap();
        (string, end.next_multiple_of(4))
    };
    let (frame_id, at) = string(at);
    let (format, at) = string(at);
    CompressedImage {
        header: Header { stamp_ns, frame_id },
        format,
        data: &cdr[at + 4..][..number(at)],
    }
}

/// Writes a log that says what another one says, its images as video with a key frame every 25. Frames of which
/// `lost` is true, by topic and number, are left out. Gives the number of frames of each camera.
fn as_video(
    source: &Path,
    target: &Path,
    codec: Codec,
    lost: impl Fn(&str, usize) -> bool,
) -> Vec<usize> {
    let bytes = std::fs::read(source).expect("a log can be read");
    let file = std::fs::File::create(target).expect("a log can be made");
    let mut log = mcap::Writer::new(std::io::BufWriter::new(file)).expect("a log begins");
    let mut cameras = BTreeMap::<String, Camera>::new();
    let mut rgb = Rgb::default();
    for message in mcap::MessageStream::new(&bytes).expect("a log is MCAP") {
        let mut message = message.expect("a log is whole");
        let schema = message.channel.schema.as_ref();
        if schema.is_some_and(|schema| schema.name == CompressedImage::NAME) {
            let topic = message.channel.topic.clone();
            let image = compressed_image(&message.data);
            decode_colour(image.data, &mut rgb).expect("a simulated image decodes");
            let camera = cameras.entry(topic.clone()).or_insert_with(|| Camera {
                encoder: Encoder::new(codec, [rgb.width, rgb.height], Style::usual(25, 12))
                    .unwrap(),
                frames: 0,
            });
            let data = camera.encoder.encode(&rgb.data).unwrap().expect("a frame");
            camera.frames += 1;
            if lost(&topic, camera.frames - 1) {
                continue;
            }
            let (format, data) = (codec.name(), &data);
            let video = CompressedImage {
                format,
                data,
                ..image
            };
            message.data = Cow::Owned(video.encode());
        }
        log.write(&message).expect("a message fits");
    }
    log.finish().expect("a log ends");
    cameras.values().map(|camera| camera.frames).collect()
}

#[test]
fn video_maps_as_its_jpeg_twin_does() {
    let folder = tempfile::tempdir().unwrap();
    let (jpeg, _) = Park::new(folder.path(), 14).drive(0, "drive", &["loops=0.25"]);
    let twin = folder.path().join("twin");
    std::fs::create_dir(&twin).unwrap();
    let video = twin.join("drive.mcap");
    let frames = as_video(&jpeg, &video, Codec::H264, |_, _| false);
    assert!(frames.iter().sum::<usize>() >= 200, "{frames:?}");
    let size = |path: &Path| std::fs::metadata(path).unwrap().len();
    let maps = [("jpeg", &jpeg), ("video", &video)].map(|(name, session)| {
        let map = folder.path().join(name);
        finished("metric_map", &map, &[session], &FEWER).expect(0);
        poses(&map, None, "poses", "map_from_vehicle")
    });
    let counts = maps.each_ref().map(|map| map["drive"].len());
    assert_eq!(counts[0], counts[1]);
    let apart = map_error(&maps[1], &maps[0]);
    eprintln!(
        "{frames:?} frames, {} kB of JPEG, {} kB of video: {} poses, rmse {:.2} cm, max {:.2} cm, {:.3} deg",
        size(&jpeg) / 1000,
        size(&video) / 1000,
        counts[0],
        100.0 * apart.position_m.rmse,
        100.0 * apart.position_m.max,
        apart.rotation_rad.rmse.to_degrees(),
    );
    assert!(apart.position_m.rmse <= 0.01);
}

const SEEN: &str = "
plan: seen
steps:
  keyframes: { op: keyframes, in: { frames: frames } }
  images:
    sql: >
      SELECT site, session, stamp, keyframe, image['camera'] AS camera, image['image'] AS image
      FROM (SELECT site, session, stamp, keyframe, unnest(images) AS image FROM keyframes)
  features: { op: features, in: { images: images }, with: { count: 50 } }
write: [features]
";

#[test]
fn lost_frames_say_topic_encoding_and_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (jpeg, _) = Park::new(folder.path(), 15).drive(0, "drive", &["loops=0.05"]);
    let video = folder.path().join("headless.mcap");
    // One camera begins without its first key frame.
    let topic = "/camera/front/image/compressed";
    as_video(&jpeg, &video, Codec::H265, |name, at| {
        name == topic && at == 0
    });
    let map = folder.path().join("map");
    let plan = folder.path().join("seen.yaml");
    std::fs::write(&plan, SEEN).unwrap();
    let ended = finished(text(&plan), &map, &[&video], &[]).expect(3);
    let told = format!(
        "image of {topic} (h265) in session headless: video frame without a key frame before it"
    );
    assert!(ended.stderr.contains(&told), "{}", ended.stderr);
}

/// A program that decodes the first bytes that come, and then ends as one that a frame has crashed.
fn write_fragile(path: &Path) {
    use std::os::unix::fs::PermissionsExt;
    let sound = program().with_file_name("evermap-video");
    let script = format!(
        "#!/bin/sh\ndd bs=1 count=60000 status=none | {} 2>/dev/null\nkill -s SEGV $$\n",
        text(&sound)
    );
    std::fs::write(path, script).unwrap();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn a_frame_that_crashes_the_decoder_is_lost_and_without_a_decoder_nothing_is() {
    let folder = tempfile::tempdir().unwrap();
    let (jpeg, _) = Park::new(folder.path(), 16).drive(0, "drive", &["loops=0.05"]);
    let video = folder.path().join("video.mcap");
    as_video(&jpeg, &video, Codec::H264, |_, _| false);
    let plan = folder.path().join("seen.yaml");
    std::fs::write(&plan, SEEN).unwrap();
    let fragile = folder.path().join("fragile");
    write_fragile(&fragile);
    let map = folder.path().join("map");
    let run = |decoder: &Path| {
        let mut run = plan_command(text(&plan), &map, "park", &["--sessions", text(&video)]);
        Finished::from(run.env("EVERMAP_VIDEO", decoder).output().unwrap())
    };

    let missing = run(&folder.path().join("nowhere")).expect(1).stderr;
    assert!(missing.contains("which decodes video"), "{missing}");
    assert!(missing.contains("EVERMAP_VIDEO"), "{missing}");

    let crashed = run(&fragile).expect(3);
    let told = "does not decode: evermap-video crashed (signal: 11 (SIGSEGV)";
    assert!(crashed.stderr.contains(told), "{}", crashed.stderr);
    let query = "SELECT count(DISTINCT (stamp, camera)) AS images FROM features";
    let seen = rows(&map, None, query);
    let images = seen[0]["images"].as_u64().unwrap();
    assert!(images > 0, "all frames before the crash are there");
}

#[test]
fn the_program_itself_links_no_ffmpeg() {
    let links = |name: &str| {
        let bytes = std::fs::read(program().with_file_name(name)).unwrap();
        bytes.windows(13).any(|found| found == b"libavcodec.so")
    };
    assert!(links("evermap-video"));
    assert!(!links("evermap"));
}

#[test]
fn the_decoder_that_a_person_starts_says_whose_it_is() {
    let by_hand =
        "evermap-video decodes video for evermap, which starts it itself where a log has video\n";
    let started = |arguments: &[&str], sent: &[u8]| {
        let mut decoder = Command::new(program().with_file_name("evermap-video"));
        decoder.args(arguments).stdin(Stdio::piped());
        decoder.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut decoder = decoder.spawn().unwrap();
        // It may have ended without reading any.
        let _ = decoder.stdin.take().unwrap().write_all(sent);
        Finished::from(decoder.wait_with_output().unwrap())
    };
    let helped = started(&["--help"], b"").expect(2);
    assert_eq!(
        (helped.stdout.as_str(), helped.stderr.as_str()),
        ("", by_hand)
    );
    let sent = started(&[], b"drive.mcap\n").expect(2).stderr;
    let other = format!("expected requests of evermap, found something else: {by_hand}");
    assert_eq!(sent, other);
    let quiet = started(&[], b"").expect(0);
    assert_eq!((quiet.stdout.as_str(), quiet.stderr.as_str()), ("", ""));
}
