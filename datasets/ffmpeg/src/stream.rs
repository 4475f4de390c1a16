//! From frames to pictures.

use evermap_video::{Codec, Colours, Continuity, Matrix, Scale};
use ffmpeg_next::color::{Range, Space};
use ffmpeg_next::format::Pixel;
use ffmpeg_next::util::error::EAGAIN;
use ffmpeg_next::{Dictionary, Error, Packet, codec, decoder, frame};

use crate::{id, prepare};

/// Pixels of the largest picture that is decoded: the most that any level of H.264 and H.265 allows (6.2).
const LARGEST_PICTURE: u64 = 35_651_584;

/// Decodes the frames of one stream in order, from a key frame on, in the caller's thread: equal bytes give equal
/// pictures.
pub struct Stream {
    opened: decoder::Video,
    continuity: Continuity,
}

impl std::fmt::Debug for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Stream")
    }
}

/// A decoded frame.
pub struct Picture {
    /// The number that its frame was given.
    pub index: i64,
    frame: frame::Video,
}

impl Stream {
    /// A stream of which nothing has come.
    ///
    /// # Errors
    /// In words, where the FFmpeg that is installed has no such decoder.
    pub fn new(codec: Codec) -> Result<Self, String> {
        Self::up_to(codec, LARGEST_PICTURE)
    }

    fn up_to(codec: Codec, pixels: u64) -> Result<Self, String> {
        prepare()?;
        let name = codec.name();
        let found = decoder::find(id(codec))
            .ok_or_else(|| format!("the FFmpeg that is installed decodes no {name}"))?;
        let mut options = Dictionary::new();
        options.set("threads", "1");
        options.set("max_pixels", &pixels.to_string());
        options.set("err_detect", "explode");
        let context = codec::Context::new_with_codec(found);
        let opened = context.decoder().open_as_with(found, options);
        let opened = opened.and_then(|opened| opened.video());
        Ok(Self {
            opened: opened.map_err(|error| format!("cannot decode {name}: {error}"))?,
            continuity: Continuity::new(codec),
        })
    }

    /// Decodes a frame: its picture, and others that waited for it; none for one that is there twice.
    ///
    /// # Errors
    /// In words, when the frame does not decode, or needs one that did not come: FFmpeg would go on without. What comes
    /// after it, up to the next key frame, cannot be believed.
    pub fn push(&mut self, index: i64, bytes: &[u8]) -> Result<Vec<Picture>, String> {
        if !self.continuity.follow(bytes)? {
            return Ok(Vec::new());
        }
        let mut packet = Packet::copy(bytes);
        packet.set_pts(Some(index));
        packet.set_dts(Some(index));
        let sent = self.opened.send_packet(&packet);
        sent.map_err(|error| format!("does not decode: {error}"))?;
        self.pictures()
    }

    /// The pictures that waited for further frames. The decoder takes no frame any more.
    ///
    /// # Errors
    /// In words, when one does not decode.
    pub fn drain(mut self) -> Result<Vec<Picture>, String> {
        let sent = self.opened.send_eof();
        sent.map_err(|error| format!("does not decode: {error}"))?;
        self.pictures()
    }

    fn pictures(&mut self) -> Result<Vec<Picture>, String> {
        let mut pictures = Vec::new();
        loop {
            let mut frame = frame::Video::empty();
            match self.opened.receive_frame(&mut frame) {
                Ok(()) if frame.is_corrupt() || frame.has_decode_errors() => {
                    return Err("does not decode: parts of the picture are missing".to_owned());
                }
                Ok(()) => pictures.push(Picture {
                    index: frame.pts().unwrap_or(i64::MIN),
                    frame,
                }),
                Err(Error::Eof) | Err(Error::Other { errno: EAGAIN }) => return Ok(pictures),
                Err(error) => return Err(format!("does not decode: {error}")),
            }
        }
    }
}

impl Picture {
    /// The picture as a netpbm file, red, green and blue of 8 bits.
    ///
    /// # Errors
    /// In words, for samples of more than 8 bits and other layouts that no camera's video has.
    pub fn file(&self) -> Result<Vec<u8>, String> {
        let format = self.frame.format();
        let (narrow, low) = match format {
            Pixel::YUV420P | Pixel::YUVJ420P => (1, 1),
            Pixel::YUV422P | Pixel::YUVJ422P => (1, 0),
            Pixel::YUV444P | Pixel::YUVJ444P => (0, 0),
            Pixel::GRAY8 => return self.grey(),
            _ => {
                return Err(format!(
                    "expected luma and chroma of 8 bits, found {format:?}"
                ));
            }
        };
        let (width, height) = (self.frame.width() as usize, self.frame.height() as usize);
        let colours = self.colours(format);
        let row = |plane: usize, y: usize| self.row(plane, y);
        let mut file = format!("P6\n{width} {height}\n255\n").into_bytes();
        file.reserve(3 * width * height);
        for y in 0..height {
            let (luma, u, v) = (row(0, y)?, row(1, y >> low)?, row(2, y >> low)?);
            let chroma = (0..width).map(|x| x >> narrow);
            for (luma, x) in luma.iter().zip(chroma) {
                file.extend(colours.rgb([*luma, u[x], v[x]]));
            }
        }
        Ok(file)
    }

    fn grey(&self) -> Result<Vec<u8>, String> {
        let (width, height) = (self.frame.width(), self.frame.height());
        let mut file = format!("P5\n{width} {height}\n255\n").into_bytes();
        for y in 0..height as usize {
            file.extend_from_slice(&self.row(0, y)?[..width as usize]);
        }
        Ok(file)
    }

    fn row(&self, plane: usize, y: usize) -> Result<&[u8], String> {
        let step = self.frame.stride(plane);
        let data = self.frame.data(plane);
        data.get(y * step..(y + 1) * step)
            .ok_or_else(|| "a picture without all of its rows".to_owned())
    }

    fn colours(&self, format: Pixel) -> Colours {
        let as_jpeg = [Pixel::YUVJ420P, Pixel::YUVJ422P, Pixel::YUVJ444P].contains(&format);
        Colours {
            matrix: match self.frame.color_space() {
                Space::BT709 => Matrix::Bt709,
                _ => Matrix::Bt601,
            },
            scale: match self.frame.color_range() {
                _ if as_jpeg => Scale::Full,
                Range::JPEG => Scale::Full,
                Range::MPEG | Range::Unspecified => Scale::Limited,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::{Encoder, Style};

    #[test]
    fn a_picture_beyond_the_limit_is_refused_whatever_its_frame_claims() {
        for codec in [Codec::H264, Codec::H265] {
            let mut encoder = Encoder::new(codec, [320, 320], Style::usual(5, 20)).unwrap();
            let frame = encoder.encode(&[90; 3 * 320 * 320]).unwrap().unwrap();
            let pictures = |pixels| Stream::up_to(codec, pixels).unwrap().push(0, &frame);
            assert_eq!(pictures(200_000).unwrap().len(), 1, "{codec:?}");
            assert!(pictures(100_000).is_err(), "{codec:?}");
        }
    }
}
