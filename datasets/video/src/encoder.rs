//! From pictures to frames: what simulated cameras record, with the rules of `foxglove.CompressedVideo`.

use ffmpeg_next::format::Pixel;
use ffmpeg_next::{Dictionary, Packet, Rational, codec, encoder, frame};

use crate::{Codec, Colours, prepare};

/// Encodes pictures of one size in order: each gives one frame, no frame refers to a later one, and parameter sets
/// stand before each key frame.
pub struct Encoder {
    opened: encoder::video::Encoder,
    size: [u32; 2],
    next: i64,
}

impl Encoder {
    /// An encoder of pictures of `size` (width, height; even) with a key frame every so many frames, at a constant
    /// quality (`crf`: 0 without loss, 51 worst).
    ///
    /// # Errors
    /// In words, where the FFmpeg that is installed has no x264 or x265.
    pub fn new(codec: Codec, size: [u32; 2], key_every: u32, crf: u32) -> Result<Self, String> {
        prepare()?;
        let (name, own) = match codec {
            Codec::H264 => ("libx264", "x264-params"),
            Codec::H265 => ("libx265", "x265-params"),
        };
        let found = encoder::find_by_name(name)
            .ok_or_else(|| format!("the FFmpeg that is installed has no {name}"))?;
        let context = codec::Context::new_with_codec(found);
        let failed = |error| format!("cannot encode with {name}: {error}");
        let mut video = context.encoder().video().map_err(failed)?;
        video.set_width(size[0]);
        video.set_height(size[1]);
        video.set_format(Pixel::YUV420P);
        video.set_time_base(Rational(1, 25));
        let mut options = Dictionary::new();
        options.set("preset", "veryfast");
        options.set("tune", "zerolatency");
        options.set("crf", &crf.to_string());
        let mut rules = format!("keyint={key_every}:min-keyint={key_every}:scenecut=0:bframes=0");
        rules += match codec {
            Codec::H264 => ":repeat-headers=1:threads=1",
            Codec::H265 => ":repeat-headers=1:pools=none:frame-threads=1:log-level=none",
        };
        options.set(own, &rules);
        Ok(Self {
            opened: video.open_as_with(found, options).map_err(failed)?,
            size,
            next: 0,
        })
    }

    /// The frame of the next picture: red, green and blue, row by row without padding.
    ///
    /// # Errors
    /// In words, for a picture of another size, or when the encoder gives no frame.
    pub fn encode(&mut self, rgb: &[u8]) -> Result<Vec<u8>, String> {
        let [width, height] = self.size.map(|side| side as usize);
        let expected = 3 * width * height;
        if rgb.len() != expected {
            let found = rgb.len();
            return Err(format!(
                "expected a picture of {expected} B, found {found} B"
            ));
        }
        let yuv = |x: usize, y: usize| {
            let pixel = &rgb[3 * (y * width + x)..][..3];
            Colours::usual_yuv([pixel[0], pixel[1], pixel[2]])
        };
        let mut frame = frame::Video::new(Pixel::YUV420P, self.size[0], self.size[1]);
        frame.set_pts(Some(self.next));
        self.next += 1;
        let steps = [0, 1, 2].map(|plane| frame.stride(plane));
        for y in 0..height {
            for x in 0..width {
                frame.data_mut(0)[y * steps[0] + x] = yuv(x, y)[0];
            }
        }
        for (plane, step) in steps.into_iter().enumerate().skip(1) {
            for y in 0..height / 2 {
                for x in 0..width / 2 {
                    let block = [(0, 0), (1, 0), (0, 1), (1, 1)];
                    let block = block.map(|(right, down)| yuv(2 * x + right, 2 * y + down)[plane]);
                    let sum: u32 = block.into_iter().map(u32::from).sum();
                    frame.data_mut(plane)[y * step + x] = ((sum + 2) / 4) as u8;
                }
            }
        }
        let failed = |error| format!("a picture does not encode: {error}");
        self.opened.send_frame(&frame).map_err(failed)?;
        let mut packet = Packet::empty();
        self.opened.receive_packet(&mut packet).map_err(failed)?;
        Ok(packet.data().unwrap_or_default().to_vec())
    }
}
