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

/// Images of any meaning.
pub(super) const IMAGES: Messages = Messages {
    choose: |topics| every(&of_content(topics, Content::Picture)),
    image: Some("data"),
    ..Messages::of::<Frame>(&[
        "sensor_msgs/CompressedImage",
        "sensor_msgs/Image",
        "foxglove.CompressedImage",
        "foxglove.RawImage",
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
/// compressed one counts; `/compressedDepth` never does.
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
        let twin = format!("{}/compressed", topic.name);
        let has_twin = topics.iter().any(|other| other.name == twin);
        !has_twin && !topic.name.ends_with("/compressedDepth") && found(topic) == content
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
        let format = encoding.unwrap_or_else(|| {
            let format = fields.text(&["format"]).unwrap_or_default();
            plain_format(&format, &image.magic)
        });
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
    } else if text.contains("png") {
        "png".to_owned()
    } else {
        text.trim().to_owned()
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
    }
}
