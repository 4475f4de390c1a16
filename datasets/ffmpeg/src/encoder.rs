//! From pictures to frames, with the rules of `foxglove.CompressedVideo`: what tests have for a camera's video.

use evermap_video::{Codec, Colours};
use ffmpeg_next::format::Pixel;
use ffmpeg_next::util::error::EAGAIN;
use ffmpeg_next::{Dictionary, Error, Packet, Rational, codec, encoder, frame};

use crate::prepare;

/// Encodes pictures of one size in order. Parameter sets stand before each key frame.
pub struct Encoder {
    opened: encoder::video::Encoder,
    size: [u32; 2],
    samples: Samples,
    next: i64,
}

/// How a camera encodes what it sees.
#[derive(Debug, Clone, Copy)]
pub struct Style {
    /// A key frame every so many frames.
    pub key_every: u32,
    /// Constant quality: 0 without loss, 51 worst.
    pub crf: u32,
    /// How many frames in a row may refer to a later one. `foxglove.CompressedVideo` forbids any.
    pub b_frames: u32,
    /// Bits of each sample of luma and chroma.
    pub samples: Samples,
}

/// Bits of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Samples {
    /// What cameras usually record.
    Eight,
    /// High dynamic range.
    Ten,
}

impl Samples {
    fn format(self) -> Pixel {
        match self {
            Self::Eight => Pixel::YUV420P,
            Self::Ten => Pixel::YUV420P10LE,
        }
    }

    /// Puts a sample of 8 bits into a plane.
    fn put(self, plane: &mut [u8], start: usize, x: usize, value: u8) {
        match self {
            Self::Eight => plane[start + x] = value,
            Self::Ten => {
                plane[start + 2 * x..][..2].copy_from_slice(&(u16::from(value) << 2).to_le_bytes());
            }
        }
    }
}

impl Style {
    /// Eight bits, and no frame refers to a later one.
    pub fn usual(key_every: u32, crf: u32) -> Self {
        Self {
            key_every,
            crf,
            b_frames: 0,
            samples: Samples::Eight,
        }
    }

    /// In the words of x264 and x265.
    fn rules(self, codec: Codec) -> String {
        let Self {
            key_every,
            b_frames,
            ..
        } = self;
        let own = match codec {
            Codec::H264 => "threads=1",
            Codec::H265 => "pools=none:frame-threads=1:log-level=none",
        };
        format!(
            "keyint={key_every}:min-keyint={key_every}:scenecut=0:bframes={b_frames}:b-adapt=0:repeat-headers=1:{own}"
        )
    }
}

impl Encoder {
    /// An encoder of pictures of `size` (width, height; even).
    ///
    /// # Errors
    /// In words, where the FFmpeg that is installed has no x264 or x265.
    pub fn new(codec: Codec, size: [u32; 2], style: Style) -> Result<Self, String> {
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
        video.set_format(style.samples.format());
        video.set_time_base(Rational(1, 25));
        let mut options = Dictionary::new();
        options.set("preset", "veryfast");
        if style.b_frames == 0 {
            options.set("tune", "zerolatency");
        }
        options.set("crf", &style.crf.to_string());
        options.set(own, &style.rules(codec));
        Ok(Self {
            opened: video.open_as_with(found, options).map_err(failed)?,
            size,
            samples: style.samples,
            next: 0,
        })
    }

    /// The frame of the next picture: red, green and blue, row by row without padding. Where frames refer to later
    /// ones, a frame of an earlier picture, or none yet.
    ///
    /// # Errors
    /// In words, for a picture of another size, or one that does not encode.
    pub fn encode(&mut self, rgb: &[u8]) -> Result<Option<Vec<u8>>, String> {
        let frame = self.frame(rgb)?;
        self.opened.send_frame(&frame).map_err(failed)?;
        self.packet()
    }

    /// The frames that are still to come, in the order in which they decode.
    ///
    /// # Errors
    /// In words, when one does not encode.
    pub fn finish(mut self) -> Result<Vec<Vec<u8>>, String> {
        self.opened.send_eof().map_err(failed)?;
        let mut frames = Vec::new();
        while let Some(frame) = self.packet()? {
            frames.push(frame);
        }
        Ok(frames)
    }

    fn packet(&mut self) -> Result<Option<Vec<u8>>, String> {
        let mut packet = Packet::empty();
        match self.opened.receive_packet(&mut packet) {
            Ok(()) => Ok(Some(packet.data().unwrap_or_default().to_vec())),
            Err(Error::Eof | Error::Other { errno: EAGAIN }) => Ok(None),
            Err(error) => Err(failed(error)),
        }
    }

    fn frame(&mut self, rgb: &[u8]) -> Result<frame::Video, String> {
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
        let samples = self.samples;
        let mut frame = frame::Video::new(samples.format(), self.size[0], self.size[1]);
        frame.set_pts(Some(self.next));
        self.next += 1;
        let steps = [0, 1, 2].map(|plane| frame.stride(plane));
        for y in 0..height {
            for x in 0..width {
                samples.put(frame.data_mut(0), y * steps[0], x, yuv(x, y)[0]);
            }
        }
        for (plane, step) in steps.into_iter().enumerate().skip(1) {
            for y in 0..height / 2 {
                for x in 0..width / 2 {
                    let block = [(0, 0), (1, 0), (0, 1), (1, 1)];
                    let block = block.map(|(right, down)| yuv(2 * x + right, 2 * y + down)[plane]);
                    let sum: u32 = block.into_iter().map(u32::from).sum();
                    let mean = ((sum + 2) / 4) as u8;
                    samples.put(frame.data_mut(plane), y * step, x, mean);
                }
            }
        }
        Ok(frame)
    }
}

fn failed(error: Error) -> String {
    format!("a picture does not encode: {error}")
}
