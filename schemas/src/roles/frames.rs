//! Frames: images by reference. Range images and label images are roles of their own with the same rows.

use std::collections::BTreeMap;

use crate::roles::cameras::{both_of, is_rectified, topic_camera};
use crate::roles::{Choice, FromMessage, Message, Messages, Role, Topic, every, in_words};
use crate::{ImageRef, Stamp, record};

record! {
    /// One image of one camera, by reference.
    #[layer("frames", key(site, session, stamp, camera))]
    pub struct Frame {
        /// Site that the session belongs to.
        site: String,
        /// Session that the image belongs to.
        session: String,
        /// Exposure instant, from the message header; the log time where the message has no header.
        stamp: Stamp ["ns"],
        /// Camera: the header's frame name where a calibration has the same one; else, and for a camera of a pair that names
        /// the frame of the first one, the topic without its last parts.
        camera: String,
        /// Topic that the image was recorded on.
        topic: String,
        /// When it was recorded.
        log_time: Stamp ["ns"],
        /// Where the pixels are.
        image: ImageRef,
    }
}

/// Topics with pictures.
pub const ROLE: Role = Role::of::<Frame>(IMAGES);

/// The member of every message with an image that holds its bytes.
pub const IMAGE_MEMBER: &str = "data";

/// What stands behind the encoding of a raw image whose samples of several bytes begin with the highest.
pub const BIG_ENDIAN: &str = " big-endian";

/// Images of any meaning.
pub(super) const IMAGES: Messages = Messages {
    choose: |topics| before_rectified(&of_content(topics, Content::Picture)),
    image: Some(IMAGE_MEMBER),
    ..Messages::of::<Frame>(&[
        "sensor_msgs/CompressedImage",
        "sensor_msgs/Image",
        "foxglove.CompressedImage",
        "foxglove.CompressedVideo",
        "foxglove.RawImage",
        "ffmpeg_image_transport_msgs/FFMPEGPacket",
    ])
};

/// What the values of an image mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    Picture,
    Depth,
    Labels,
}

/// Parts of a topic's name that tell label images from pictures.
pub(super) const LABELS: [&str; 3] = ["label", "segmentation", "semantic"];

/// What the name of an image topic speaks of.
pub(super) fn content_of(topic: &str) -> Content {
    if in_words(topic, &LABELS) {
        Content::Labels
    } else if in_words(topic, &["depth"]) {
        Content::Depth
    } else {
        Content::Picture
    }
}

/// A topic without the part that says how its images are sent, and which of several such it is that counts: the lowest.
fn twins(topic: &str) -> (&str, u8) {
    let sent = [("/compressed", 0), ("/ffmpeg", 2), ("/compressedDepth", 2)];
    let found = sent.iter().find_map(|(suffix, rank)| {
        let plain = topic.strip_suffix(suffix)?;
        Some((plain, *rank))
    });
    found.unwrap_or((topic, 1))
}

/// The image topics whose names speak of this content. Of a topic and its twins those with messages count; of these the
/// `/compressed` one, then the plain one, and a `/ffmpeg` or `/compressedDepth` twin where it is alone.
pub(super) fn of_content(topics: &[Topic], content: Content) -> Vec<Topic> {
    let place = |topic: &Topic| (topic.messages == 0, twins(&topic.name).1);
    let mut first = BTreeMap::<&str, (bool, u8)>::new();
    for topic in topics {
        let known = first.entry(twins(&topic.name).0).or_insert(place(topic));
        *known = place(topic).min(*known);
    }
    let counts = |topic: &&Topic| {
        let hidden = first.get(twins(&topic.name).0) < Some(&place(topic));
        !hidden && content_of(&topic.name) == content
    };
    topics.iter().filter(counts).cloned().collect()
}

/// Why images of a lens go before those that were rectified.
const WHY_BEFORE: &str = "as the calibration is of images that are not rectified";

/// Of one content, the topics of each camera as its lens sees; rectified ones where no others have messages.
pub(super) fn before_rectified(topics: &[Topic]) -> Vec<Choice> {
    let is_rect = |topic: &Topic| is_rectified(&topic.name);
    let (rectified, others): (Vec<_>, Vec<_>) = topics.iter().cloned().partition(is_rect);
    let mut by_camera = BTreeMap::<String, (usize, bool)>::new();
    for (place, topic) in others.iter().enumerate() {
        let found = (place, topic.messages > 0);
        let known = by_camera.entry(topic_camera(&topic.name)).or_insert(found);
        if !known.1 {
            *known = found;
        }
    }
    let mut choices = every(&others);
    for topic in &rectified {
        let other = by_camera.get(&topic_camera(&topic.name));
        let other = other.filter(|(_, speaks)| *speaks || topic.messages == 0);
        match other.and_then(|(place, _)| choices.get_mut(*place)) {
            Some(choice) => {
                choice.passed_over.push(topic.name.clone());
                choice.why = Some(WHY_BEFORE);
            }
            None => choices.extend(Choice::first_of([topic])),
        }
    }
    choices
}

/// Whether a topic's images are those that are read of a camera, and not of another one that names the same frame.
///
/// # Errors
/// In words, where they are not and no calibration has told so, as then nobody has counted it.
fn is_first(message: &Message<'_>, camera: &str) -> Result<bool, String> {
    let (cameras, topic) = (message.cameras, message.topic);
    match cameras.pictured_by(topic, camera) {
        None => Ok(true),
        Some(_) if cameras.is_calibrated_as(topic, camera) => Ok(false),
        Some(first) => Err(both_of(first, topic, camera)),
    }
}

/// That an image is one that the calibration of its camera is read for. Pictures of a topic that does not say so are not
/// rectified; range and label images of such a topic may be.
fn check_calibrated(message: &Message<'_>, camera: &str) -> Result<(), String> {
    let rectified = is_rectified(message.topic);
    let said = match (message.cameras.is_rectified(camera), rectified) {
        (Some(false), true) => {
            "one that is not rectified, as the calibration of its camera is read for such, found one of a rectified topic"
        }
        (Some(true), false) if content_of(message.topic) == Content::Picture => {
            "a rectified one, as the calibration of its camera is read for such, found one of a topic that is not"
        }
        _ => return Ok(()),
    };
    Err(format!(
        "expected {said}: choose by roles in a session manifest"
    ))
}

impl FromMessage for Frame {
    const MEMBERS: &'static [&'static str] = &[
        "header",
        "timestamp",
        "frame_id",
        "format",
        "encoding",
        "width",
        "height",
        "step",
        "is_bigendian",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let fields = &message.fields;
        let image = message.image.ok_or("expected an image")?;
        let encoding = fields.text(&["encoding"]);
        let size = |name: &str| {
            let number = encoding.as_ref().and_then(|_| fields.number(&[name]));
            number.map(|number| number as u32)
        };
        let (width, height, step) = (size("width"), size("height"), size("step"));
        let text = |name: &str| fields.text(&[name]).unwrap_or_default();
        let is_big = fields.number(&["is_bigendian"]).unwrap_or(0.0) != 0.0;
        let format = match encoding {
            // A packet of video names its codec where a raw image names its layout.
            Some(encoding) => {
                video_format(&encoding).unwrap_or_else(|| raw_format(encoding, is_big))
            }
            None => plain_format(&text("format"), &image.magic),
        };
        let camera = message.cameras.name(message.topic, &message.frame());
        if !is_first(message, &camera)? {
            return Ok(Vec::new());
        }
        check_calibrated(message, &camera)?;
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp()?,
            camera,
            topic: message.topic.to_owned(),
            log_time: message.log_time,
            image: ImageRef {
                format,
                width,
                height,
                step,
                ..image.place.clone()
            },
        }])
    }
}

/// `jpeg` or `png` where the message says so in one of many ways (`mono8; jpeg compressed `, `image/png`) or the bytes
/// do; else what the message says.
fn plain_format(format: &str, magic: &[u8; 8]) -> String {
    let text = format.to_lowercase();
    let starts =
        |plain: &[u8], base64: &[u8]| magic.starts_with(plain) || magic.starts_with(base64);
    if starts(b"\xff\xd8\xff", b"/9j/") {
        "jpeg".to_owned()
    } else if starts(b"\x89PNG", b"iVBOR") {
        "png".to_owned()
    } else if text.contains("jpeg") || text.contains("jpg") {
        "jpeg".to_owned()
    } else if let Some(depth) = compressed_depth(&text) {
        depth.to_owned()
    } else if text.contains("png") {
        "png".to_owned()
    } else {
        video_format(&text).unwrap_or_else(|| text.trim().to_owned())
    }
}

/// An encoding, with the order of the bytes where its samples have several: `mono16`, `bayer_rggb16`, `32FC1`.
fn raw_format(encoding: String, is_big_endian: bool) -> String {
    let is_wide = ["16", "32", "64"]
        .iter()
        .any(|bits| encoding.contains(bits));
    match is_big_endian && is_wide {
        true => encoding + BIG_ENDIAN,
        false => encoding,
    }
}

/// What `compressed_depth_image_transport` says of its PNGs: `16UC1; compressedDepth png`, without `png` in older logs.
fn compressed_depth(text: &str) -> Option<&'static str> {
    let (encoding, transport) = text.split_once(';')?;
    let is_png = transport.contains("compresseddepth") && !transport.contains("rvl");
    match encoding.trim() {
        "16uc1" if is_png => Some("compressedDepth 16UC1"),
        "32fc1" if is_png => Some("compressedDepth 32FC1"),
        _ => None,
    }
}

/// `h264` or `h265` where a format or an encoder's name says so: `video/h264`, `hevc`, `libx264;yuv420p`, `hevc_nvenc`.
fn video_format(text: &str) -> Option<String> {
    let text = text.to_lowercase();
    let found = |names: &[&str]| names.iter().any(|name| text.contains(name));
    if found(&["h264", "h.264", "x264", "avc"]) {
        Some("h264".to_owned())
    } else if found(&["h265", "h.265", "x265", "hevc"]) {
        Some("h265".to_owned())
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use std::cell::OnceCell;
    use std::sync::Arc;

    use arrow::array::{ArrayRef, StringArray, UInt8Array};

    use super::*;
    use crate::Pose;
    use crate::roles::tests::members;
    use crate::roles::{CalibratedCamera, CameraNames, Fields, FoundImage, OdometryOf};

    fn camera(frame: &str) -> CalibratedCamera {
        CalibratedCamera {
            frame: frame.to_owned(),
            pair_from_camera: Pose::IDENTITY,
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
            part: 0,
            chunk: None,
            chunk_length: 0,
            chunk_size: 0,
            compression: String::new(),
            offset: 0,
            length: 1,
            format: String::new(),
            width: None,
            height: None,
            step: None,
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
            robot: &OdometryOf::default(),
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
}
