//! Frames: images by reference. Range images and label images are roles of their own with the same rows.

use std::collections::BTreeMap;

use crate::roles::cameras::{both_of, is_rectified, topic_camera};
use crate::roles::content::{Content, content_of};
use crate::roles::{
    Choice, FromMessage, Message, Messages, RawFormat, Role, SampleBits, Topic, every,
};
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

/// Images of any meaning.
pub(super) const IMAGES: Messages = Messages {
    choose: |topics| before_rectified(&of_content(topics, Content::Picture)),
    image: Some(IMAGE_MEMBER),
    pictures: true,
    ..Messages::of::<Frame>(&[
        "sensor_msgs/CompressedImage",
        "sensor_msgs/Image",
        "foxglove.CompressedImage",
        "foxglove.CompressedVideo",
        "foxglove.RawImage",
        "ffmpeg_image_transport_msgs/FFMPEGPacket",
    ])
};

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

/// Whether a topic's images are those that are read of a camera, and not of another one that names the same frame, or
/// stands nobody knows where.
///
/// # Errors
/// In words, where they are not and no calibration has told so, as then nobody has counted it.
fn is_first(message: &Message<'_>, camera: &str) -> Result<bool, String> {
    let (cameras, topic) = (message.cameras, message.topic);
    if cameras.is_unplaced(topic, camera) {
        return Ok(false);
    }
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

/// That an image has samples of 16 bits, where a person says how many of them its topic uses.
fn check_bits(bits: Option<SampleBits>, raw: Option<&str>, format: &str) -> Result<(), String> {
    let has_sixteen = raw.is_some_and(|encoding| encoding.contains("16"));
    match bits {
        Some(bits) if !has_sixteen => Err(format!(
            "expected a raw image with samples of 16 bits, as `bits` of the session manifest says {bits} of its topic, found {format}"
        )),
        _ => Ok(()),
    }
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
        // A packet of video names its codec where a raw image names its layout.
        let video = encoding.as_deref().and_then(video_format);
        let raw = encoding.filter(|_| video.is_none());
        let format = match (&raw, video) {
            (Some(encoding), _) => raw_format(encoding, message.bits, is_big),
            (None, Some(codec)) => codec,
            (None, None) => plain_format(&text("format"), &image.magic),
        };
        let camera = message.cameras.name(message.topic, &message.frame());
        if !is_first(message, &camera)? {
            return Ok(Vec::new());
        }
        check_calibrated(message, &camera)?;
        check_bits(message.bits, raw.as_deref(), &format)?;
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

/// How a raw image of this encoding is stored: in which order of bytes is told where its samples have several.
fn raw_format(encoding: &str, bits: Option<SampleBits>, is_big_endian: bool) -> String {
    let is_wide = ["16", "32", "64"]
        .iter()
        .any(|bits| encoding.contains(bits));
    let format = RawFormat {
        encoding,
        bits,
        is_big_endian: is_big_endian && is_wide,
    };
    format.to_string()
}

/// What `compressed_depth_image_transport` says of its PNGs: `16UC1; compressedDepth png`, without `png` in older logs.
fn compressed_depth(text: &str) -> Option<&'static str> {
    let (encoding, transport) = text.split_once(';')?;
    let is_png = transport.contains("compresseddepth") && !transport.contains("rvl");
    match encoding.trim() {
        "16uc1" | "mono16" if is_png => Some("compressedDepth 16UC1"),
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
mod tests;
