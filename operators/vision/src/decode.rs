//! Encoded images to grey and to colour.
//!
//! Images come from logs, so what reads them is Rust: a forged one can fail, but reach nothing. OpenCV's own readers
//! would also load a hundred libraries, at every start, for formats that are no camera's.

use std::io::Cursor;

use imagesize::ImageType;
use png::{BitDepth, Limits, Transformations};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::grey::{MAX_SCANS, checked_pixels};
use crate::stored::{Stored, pnm};
use crate::{Grey, ImageError, Rgb};

/// Width and height (px) that the header claims; the rest of the bytes is not looked at.
///
/// # Errors
/// [`ImageError`] for bytes that are no image, or too large a one.
pub fn image_size(bytes: &[u8]) -> Result<[u32; 2], ImageError> {
    let header = header(bytes)?;
    Ok([header.width, header.height])
}

/// Whether an image has room for colours, by what stands before its pixels: more than a channel, transparency aside. Its
/// pixels may be grey all the same.
///
/// # Errors
/// [`ImageError`] for bytes that are no image, too large a one, or a JPEG that is damaged before its pixels.
pub fn holds_colour(bytes: &[u8]) -> Result<bool, ImageError> {
    let header = header(bytes)?;
    Ok(match header.format {
        "jpeg" => {
            let decoder = jpeg_reader(bytes, &header, ColorSpace::RGB)?;
            decoder.input_colorspace() != Some(ColorSpace::Luma)
        }
        // Grey, and grey with transparency; a palette is of colours.
        "png" => !matches!(bytes.get(PNG_COLOUR), Some(0 | 4)),
        _ => !bytes.starts_with(b"P5"),
    })
}

/// Decodes an image (JPEG, PNG, PGM or PPM, by its first bytes) to 8-bit grey, into a buffer that is
/// used again. After an error its contents mean nothing.
///
/// Grey from colour is luma (Rec. 601, which in a JPEG is stored as such); 16 bits become the upper 8; transparency and
/// EXIF orientation are ignored. A picture of 16 bits whose values do not reach beyond 14 is none.
///
/// # Errors
/// [`ImageError`] for bytes that are no image, too large an image, one of fewer bits than its samples, or one that is cut off or damaged so that not
/// every row can be read. (A JPEG damaged in the middle may still decode, with some blocks wrong.)
pub fn decode_grey(bytes: &[u8], grey: &mut Grey) -> Result<(), ImageError> {
    let header = decodable(bytes)?;
    grey.reset(header.width, header.height)?;
    if header.format == "jpeg" && jpeg(bytes, &header, ColorSpace::Luma, &mut grey.data)? {
        return Ok(());
    }
    for (grey, colour) in grey
        .data
        .iter_mut()
        .zip(Pixels::of(bytes, &header)?.colours())
    {
        *grey = luma(colour);
    }
    Ok(())
}

/// As [`decode_grey`], in colour; grey images have three equal values.
///
/// # Errors
/// As [`decode_grey`].
pub fn decode_colour(bytes: &[u8], rgb: &mut Rgb) -> Result<(), ImageError> {
    let header = decodable(bytes)?;
    rgb.reset(header.width, header.height)?;
    if header.format == "jpeg" && jpeg(bytes, &header, ColorSpace::RGB, &mut rgb.data)? {
        return Ok(());
    }
    let (pixels, _) = rgb.data.as_chunks_mut();
    for (pixel, colour) in pixels.iter_mut().zip(Pixels::of(bytes, &header)?.colours()) {
        *pixel = colour;
    }
    Ok(())
}

/// Rec. 601's weights.
fn luma([red, green, blue]: [u8; 3]) -> u8 {
    let sum = 299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue);
    ((sum + 500) / 1000) as u8
}

/// Decodes a JPEG into a buffer of its size, as luma or in colour; whether it could. Luma is had of images that hold it:
/// not of those in red, green and blue.
fn jpeg(
    bytes: &[u8],
    header: &Header,
    wanted: ColorSpace,
    buffer: &mut [u8],
) -> Result<bool, ImageError> {
    let mut decoder = jpeg_reader(bytes, header, wanted)?;
    let holds_luma = matches!(
        decoder.input_colorspace(),
        Some(ColorSpace::YCbCr | ColorSpace::Luma)
    );
    if wanted == ColorSpace::Luma && !holds_luma {
        return Ok(false);
    }
    let decoded = decoder.decode_into(buffer);
    decoded.map_err(|_| header.damaged(bytes)).map(|()| true)
}

/// A JPEG of which all is read that stands before its pixels.
fn jpeg_reader<'a>(
    bytes: &'a [u8],
    header: &Header,
    wanted: ColorSpace,
) -> Result<JpegDecoder<ZCursor<&'a [u8]>>, ImageError> {
    let damaged = || header.damaged(bytes);
    let (width, height) = (header.width as usize, header.height as usize);
    let options = DecoderOptions::default()
        .set_max_width(width)
        .set_max_height(height)
        .jpeg_set_max_scans(MAX_SCANS)
        .jpeg_set_out_colorspace(wanted);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|_| damaged())?;
    if decoder.dimensions() != Some((width, height)) {
        return Err(damaged());
    }
    Ok(decoder)
}

/// Values of so many bits in samples of 16 leave at most four of the upper eight: too few grey values for a feature, and a
/// picture of a camera that fills its 16 bits is all but black with no more. (14 bits leave six.)
const FAINT_BITS: u32 = 12;

/// Values of 8 bits: grey, red, green and blue, or either with transparency behind it.
struct Pixels {
    channels: usize,
    data: Vec<u8>,
}

impl Pixels {
    fn of(bytes: &[u8], header: &Header) -> Result<Self, ImageError> {
        match header.format {
            "jpeg" => {
                let mut data = vec![0; 3 * checked_pixels(header.width, header.height)?];
                jpeg(bytes, header, ColorSpace::RGB, &mut data)?;
                Ok(Self { channels: 3, data })
            }
            "png" => png(bytes, header),
            _ => {
                let (channels, stored) = pnm(bytes, header)?;
                Self::lit(channels, stored)
            }
        }
    }

    /// The upper eight bits of values of 16, of so many a pixel, where these are more than the remains of fewer bits. An
    /// image that is black is one.
    fn lit(channels: usize, stored: Stored) -> Result<Self, ImageError> {
        let bits = u16::BITS - stored.largest_of_sixteen(channels).leading_zeros();
        match bits {
            1..=FAINT_BITS => Err(ImageError::Faint {
                most: (1 << bits) - 1,
            }),
            _ => Ok(Self {
                channels,
                data: stored.into_upper_eight(),
            }),
        }
    }

    fn colours(&self) -> impl Iterator<Item = [u8; 3]> {
        let pixels = self.data.chunks_exact(self.channels);
        pixels.map(|pixel| match pixel {
            [red, green, blue, ..] => [*red, *green, *blue],
            [grey, ..] => [*grey; 3],
            [] => [0; 3],
        })
    }
}

fn png(bytes: &[u8], header: &Header) -> Result<Pixels, ImageError> {
    let damaged = || header.damaged(bytes);
    // What a decoder may need: rows of four values of 16 bits, and as much again for tables.
    let limits = Limits {
        bytes: 8 * checked_pixels(header.width, header.height)? + (1 << 20),
    };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(|_| damaged())?;
    let info = reader.info();
    if (info.width, info.height) != (header.width, header.height) {
        return Err(damaged());
    }
    let mut data = vec![0; reader.output_buffer_size().ok_or_else(damaged)?];
    reader.next_frame(&mut data).map_err(|_| damaged())?;
    let (colour, depth) = reader.output_color_type();
    let stored = Stored::of(depth == BitDepth::Sixteen, data);
    Pixels::lit(colour.samples(), stored)
}

/// The first letters of a portable float map of one channel, as which raw images of floating point come.
pub(crate) const PORTABLE_FLOAT_MAP: &[u8] = b"Pf";

pub(crate) struct Header {
    pub(crate) format: &'static str,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl Header {
    pub(crate) fn damaged(&self, bytes: &[u8]) -> ImageError {
        ImageError::Damaged {
            format: self.format,
            bytes: bytes.len(),
        }
    }
}

/// What the first bytes say, checked against [`crate::MAX_PIXELS`] before a decoder sees them.
pub(crate) fn header(bytes: &[u8]) -> Result<Header, ImageError> {
    let unknown = |found: String| ImageError::Format { found };
    if bytes.starts_with(PORTABLE_FLOAT_MAP) {
        return Err(ImageError::Float);
    }
    let kind = imagesize::image_type(bytes).map_err(|_| unknown(first_bytes(bytes)))?;
    let format = match kind {
        ImageType::Jpeg => "jpeg",
        ImageType::Png => "png",
        ImageType::Pnm => "pnm",
        other => return Err(unknown(format!("{other:?}"))),
    };
    let size = imagesize::blob_size(bytes).map_err(|_| ImageError::Damaged {
        format,
        bytes: bytes.len(),
    })?;
    let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
    let (width, height) = (side(size.width), side(size.height));
    crate::grey::checked_pixels(width, height)?;
    Ok(Header {
        format,
        width,
        height,
    })
}

/// What the first bytes say of an image that can be decoded in time and memory.
pub(crate) fn decodable(bytes: &[u8]) -> Result<Header, ImageError> {
    let header = header(bytes)?;
    if !may_be_whole(bytes, &header) {
        return Err(header.damaged(bytes));
    }
    if header.format != "jpeg" {
        return Ok(header);
    }
    if !ends_like_a_jpeg(bytes) {
        return Err(header.damaged(bytes));
    }
    match scans(bytes) {
        found if found > MAX_SCANS => Err(ImageError::Scans { found }),
        _ => Ok(header),
    }
}

/// Whether an image has as many bytes as its pixels take at least: a JPEG a bit for each block of 8 × 8 of them, a PNG
/// what its rows compress to. (The bytes of a PNM image are counted where it is read.)
fn may_be_whole(bytes: &[u8], header: &Header) -> bool {
    let (width, height) = (u64::from(header.width), u64::from(header.height));
    let found = bytes.len() as u64;
    match header.format {
        "jpeg" => 8 * found >= width * height / 64,
        "png" => found >= height * (width * png_bits(bytes)).div_ceil(8) / DEFLATE_RATIO,
        _ => true,
    }
}

/// Deflate says at most 258 bytes by 2 bits (RFC 1951).
const DEFLATE_RATIO: u64 = 1032;

/// Where a PNG's header says the kind of its colours.
const PNG_COLOUR: usize = 25;

/// Bits of a pixel, by a PNG's header: behind its signature, the chunk's length and name, width and height stand the
/// bits of a value and the kind of colour. One where it says what no PNG has: its decoder refuses that.
fn png_bits(bytes: &[u8]) -> u64 {
    let values = match bytes.get(PNG_COLOUR - 1..=PNG_COLOUR) {
        Some([depth @ (1 | 2 | 4 | 8 | 16), 0 | 3]) => *depth,
        Some([depth @ (8 | 16), 2]) => 3 * depth,
        Some([depth @ (8 | 16), 4]) => 2 * depth,
        Some([depth @ (8 | 16), 6]) => 4 * depth,
        _ => 1,
    };
    u64::from(values)
}

/// The scans that a decoder may find in a JPEG: its markers, which what is encoded does not hold; also those of a small image
/// within the large one.
fn scans(bytes: &[u8]) -> usize {
    let next = bytes.get(1..).unwrap_or_default();
    let pairs = bytes.iter().zip(next);
    pairs.filter(|pair| *pair == (&0xff, &0xda)).count()
}

/// Decoders fill what is cut off with grey; a map must not show that. Behind the marker that begins the last scan stands
/// the one that ends the image, which what is encoded does not hold; what follows it, as cameras pad, is none of the image.
fn ends_like_a_jpeg(bytes: &[u8]) -> bool {
    let mut pairs = bytes.windows(2);
    let last_scan = pairs.rposition(|pair| pair == [0xff, 0xda]);
    let behind = last_scan.map_or(&[][..], |start| &bytes[start..]);
    behind.windows(2).any(|pair| pair == [0xff, 0xd9])
}

fn first_bytes(bytes: &[u8]) -> String {
    match bytes {
        [] => "no bytes".to_owned(),
        _ => format!("bytes that begin {:02x?}", &bytes[..bytes.len().min(4)]),
    }
}
