//! Frames: images by reference. Pixels are located, never copied.

use evermap_messages::MessageType;
use evermap_schemas::ImageRef;
use evermap_schemas::Stamp;
use evermap_schemas::roles::Frame;

use crate::roles::rows::{Decoded, FromMessages};
use crate::scan::MessageAt;

/// Where an image lies, and its first bytes where its format must be guessed from them.
pub(crate) struct Place {
    part: u32,
    chunk: Option<u64>,
    chunk_length: u64,
    chunk_size: u64,
    compression: String,
    offset: u64,
    length: u64,
    magic: [u8; 8],
}

impl FromMessages for Frame {
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
    type Note = Place;

    fn note(message_type: &MessageType, message: &MessageAt<'_>) -> Result<Place, String> {
        if !message.block.addressable {
            return Err(
                "an image that is compressed inside a compressed chunk cannot be referred to: \
                        record with either chunk or message compression"
                    .to_owned(),
            );
        }
        let located = message_type
            .locate(message.payload, &["data"])
            .map_err(|error| error.to_string())?
            .ok_or("expected image bytes in the field data")?;
        let bytes = message.payload.get(located.range.clone());
        let bytes = bytes.ok_or("image bytes outside the payload")?;
        if bytes.is_empty() {
            return Err("an image without bytes".to_owned());
        }
        let mut magic = [0; 8];
        let known = bytes.len().min(magic.len());
        magic[..known].copy_from_slice(&bytes[..known]);
        let block = message.block;
        let within = (message.start + located.range.start) as u64;
        Ok(match &block.packing {
            Some(packing) => Place {
                part: message.part.part,
                chunk: Some(block.file_offset),
                chunk_length: packing.compressed_size,
                chunk_size: block.bytes.len() as u64,
                compression: packing.compression.clone(),
                offset: within,
                length: bytes.len() as u64,
                magic,
            },
            None => Place {
                part: message.part.part,
                chunk: None,
                chunk_length: 0,
                chunk_size: 0,
                compression: String::new(),
                offset: block.file_offset + within,
                length: bytes.len() as u64,
                magic,
            },
        })
    }

    fn rows(message: Decoded<'_>, place: Place) -> Result<Vec<Self>, String> {
        let (columns, row) = (message.columns, message.row);
        let encoding = columns.text(&["encoding"], row);
        let size = |name: &str| {
            let number = encoding.as_ref().and_then(|_| columns.number(&[name], row));
            number.map(|number| number as u32)
        };
        let format = match &encoding {
            Some(encoding) => encoding.clone(),
            None => {
                let format = columns.text(&["format"], row).unwrap_or_default();
                plain_format(&format, &place.magic)
            }
        };
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp(),
            camera: message.cameras.name(message.topic, &message.frame()),
            topic: message.topic.to_owned(),
            log_time: Stamp(message.log_time.0),
            image: ImageRef {
                session: message.session.to_owned(),
                part: place.part,
                chunk: place.chunk,
                chunk_length: place.chunk_length,
                chunk_size: place.chunk_size,
                compression: place.compression,
                offset: place.offset,
                length: place.length,
                format,
                width: size("width"),
                height: size("height"),
                step: size("step"),
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
