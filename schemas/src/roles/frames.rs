//! Frames: images by reference. Range images and label images are roles of their own with the same rows.

use crate::roles::{FromMessage, Message, Messages, Role, Topic, every, in_words};
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
        /// Camera: the header's frame name where a calibration has the same one, else the topic without its last parts.
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
    choose: |topics| every(&of_content(topics, Content::Picture)),
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

/// The image topics whose names speak of this content. Where a topic and its `/compressed` twin are both there, the
/// compressed one counts; a `/ffmpeg` or `/compressedDepth` twin counts where it is alone.
pub(super) fn of_content(topics: &[Topic], content: Content) -> Vec<Topic> {
    let found = |topic: &Topic| {
        if in_words(&topic.name, &LABELS) {
            Content::Labels
        } else if in_words(&topic.name, &["depth"]) {
            Content::Depth
        } else {
            Content::Picture
        }
    };
    let counts = |topic: &&Topic| {
        let has = |name: &str| topics.iter().any(|other| other.name == name);
        let compressed = |name: &str| format!("{name}/compressed");
        let mut plain = ["/ffmpeg", "/compressedDepth"]
            .iter()
            .filter_map(|suffix| topic.name.strip_suffix(suffix));
        let has_twin = has(&compressed(&topic.name))
            || plain.any(|name| has(name) || has(&compressed(name)));
        !has_twin && found(topic) == content
    };
    topics.iter().filter(counts).cloned().collect()
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
        let format = match encoding {
            // A packet of video names its codec where a raw image names its layout.
            Some(encoding) => video_format(&encoding).unwrap_or(encoding),
            None => plain_format(&text("format"), &image.magic),
        };
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp(),
            camera: message.cameras.name(message.topic, &message.frame()),
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
    use super::*;

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
}
