//! Images whose values are data, not light: labels and depth. They are read exactly as they are stored, where a
//! picture's decoder would scale 16 bits to 8 or look a palette's colours up.
//!
//! PNG is what maps and data sets hold them in; PGM (`P5`) is what raw images of a log arrive as, PFM (`Pf`) raw depth in
//! metres.

use std::io::Cursor;

use png::{BitDepth, ColorType, Limits, Transformations};

use crate::decode::{Header, PORTABLE_FLOAT_MAP, decodable};
use crate::grey::checked_pixels;
use crate::{Grey, Grey16, ImageError};

/// The values of a depth image: of 16 or fewer bits per pixel, as stored, not scaled. A palette's indices are its
/// values. Metres become millimetres: floating-point numbers (PFM), and inverse depth as
/// `compressed_depth_image_transport` stores it; 0 where nothing was measured, 65,535 beyond what 16 bits can say.
///
/// # Errors
/// [`ImageError`] for bytes that are no PNG, PGM or grey PFM, an image in colour or with transparency, one that is too
/// large, cut off or damaged.
pub fn decode_depth(bytes: &[u8]) -> Result<Grey16, ImageError> {
    if let Some(numbers) = bytes.strip_prefix(PORTABLE_FLOAT_MAP) {
        return pfm_depth(numbers, bytes.len());
    }
    let (inverse, bytes) = InverseDepth::before(bytes);
    let mut depth = decode_values(bytes)?;
    if let Some(inverse) = inverse {
        for value in &mut depth.data {
            *value = inverse.millimetres(*value);
        }
    }
    Ok(depth)
}

/// The values of an image of 16 or fewer bits per pixel, as stored, not scaled: of a palette PNG the indices.
///
/// # Errors
/// [`ImageError`] for bytes that are no PNG or PGM, an image in colour or with transparency, one that is too large, cut
/// off or damaged.
pub fn decode_values(bytes: &[u8]) -> Result<Grey16, ImageError> {
    let header = decodable(bytes)?;
    Ok(Grey16 {
        width: header.width,
        height: header.height,
        data: stored(bytes, &header)?.into_sixteen(),
    })
}

/// Depth as REP 118 has it: not a number, too near (-∞) and 0 are nothing measured, +∞ is beyond range.
fn millimetres(metres: f32) -> u16 {
    // A conversion of floating-point numbers saturates, and makes 0 of what is no number.
    (1000.0 * metres).round() as u16
}

/// A portable float map of one channel, after its first two letters, in metres: width, height, a scale below zero where
/// numbers are little endian, then rows from the lowest to the highest.
fn pfm_depth(mut rest: &[u8], length: usize) -> Result<Grey16, ImageError> {
    let damaged = || ImageError::Damaged {
        format: "pfm",
        bytes: length,
    };
    let mut size = [0; 2];
    for side in &mut size {
        (*side, rest) = pgm_number(rest).ok_or_else(damaged)?;
    }
    let [width, height] = size;
    let pixels = checked_pixels(width, height)?;
    let mut lines = rest.splitn(3, |byte| *byte == b'\n');
    let (_, scale, metres) = (lines.next(), lines.next(), lines.next());
    let metres = metres.and_then(|metres| metres.get(..4 * pixels));
    let (Some(scale), Some(metres)) = (scale, metres) else {
        return Err(damaged());
    };
    let number = match scale.starts_with(b"-") {
        true => f32::from_le_bytes,
        false => f32::from_be_bytes,
    };
    let rows = metres.chunks_exact(4 * width as usize).rev();
    let metres = rows.flat_map(|row| row.as_chunks().0);
    Ok(Grey16 {
        width,
        height,
        data: metres.map(|metres| millimetres(number(*metres))).collect(),
    })
}

/// Depth in metres as `compressed_depth_image_transport` quantises it: `a / (value - b)`, nothing measured where the value
/// is 0.
struct InverseDepth {
    a: f32,
    b: f32,
}

impl InverseDepth {
    /// From a header of 12 bytes (the method, `a` and `b`), where a PNG follows it; and the image. Where `a` is 0 nothing
    /// was quantised: the header stands before millimetres, too.
    fn before(bytes: &[u8]) -> (Option<Self>, &[u8]) {
        match bytes.split_first_chunk() {
            Some((&[_, _, _, _, a0, a1, a2, a3, b0, b1, b2, b3], png))
                if png.starts_with(b"\x89PNG\r\n\x1a\n") =>
            {
                let a = f32::from_le_bytes([a0, a1, a2, a3]);
                let b = f32::from_le_bytes([b0, b1, b2, b3]);
                ((a != 0.0).then_some(Self { a, b }), png)
            }
            _ => (None, bytes),
        }
    }

    fn millimetres(&self, value: u16) -> u16 {
        match value {
            0 => 0,
            _ => millimetres(self.a / (f32::from(value) - self.b)),
        }
    }
}

/// The values of a label image of a map, as stored: of a palette PNG the indices, of fewer than 8 bits the values
/// themselves. 16-bit values above 255 become 255, which stands for "no class"; where that is to be told, as of a log's
/// label images, [`decode_values`] has them.
///
/// # Errors
/// As [`decode_values`].
pub fn decode_labels(bytes: &[u8]) -> Result<Grey, ImageError> {
    let header = decodable(bytes)?;
    let stored = stored(bytes, &header)?;
    Ok(Grey {
        width: header.width,
        height: header.height,
        data: stored.into_eight(),
    })
}

/// An 8-bit grey PNG. Equal images give equal bytes.
///
/// # Errors
/// [`ImageError::Size`] when the image has no pixels, too many, or not as many as its size says.
pub fn encode_png(grey: &Grey) -> Result<Vec<u8>, ImageError> {
    let (width, height) = (grey.width, grey.height);
    let refused = ImageError::Size { width, height };
    if checked_pixels(width, height)? != grey.data.len() {
        return Err(refused);
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_compression(png::Compression::Balanced);
    encoder
        .write_header()
        .and_then(|mut writer| {
            writer.write_image_data(&grey.data)?;
            writer.finish()
        })
        .map_err(|_| refused)?;
    Ok(bytes)
}

/// Values in as many bytes as they are stored in.
pub(crate) enum Stored {
    Eight(Vec<u8>),
    Sixteen(Vec<u16>),
}

impl Stored {
    pub(crate) fn of(deep: bool, bytes: Vec<u8>) -> Self {
        if !deep {
            return Self::Eight(bytes);
        }
        let (values, _) = bytes.as_chunks::<2>();
        Self::Sixteen(
            values
                .iter()
                .map(|value| u16::from_be_bytes(*value))
                .collect(),
        )
    }

    fn into_sixteen(self) -> Vec<u16> {
        match self {
            Self::Eight(values) => values.into_iter().map(u16::from).collect(),
            Self::Sixteen(values) => values,
        }
    }

    /// The largest of the values of 16 bits, of so many a pixel, transparency aside; 0 where they have 8.
    pub(crate) fn largest_of_sixteen(&self, channels: usize) -> u16 {
        let Self::Sixteen(values) = self else {
            return 0;
        };
        // Grey or three colours, and transparency behind either.
        let colours = if channels < 3 { 1 } else { 3 };
        let pixels = values.chunks_exact(channels);
        let largest = pixels.filter_map(|pixel| pixel[..colours].iter().max());
        largest.copied().max().unwrap_or(0)
    }

    /// The upper eight bits.
    pub(crate) fn into_upper_eight(self) -> Vec<u8> {
        match self {
            Self::Eight(values) => values,
            Self::Sixteen(values) => values.into_iter().map(|value| (value >> 8) as u8).collect(),
        }
    }

    fn into_eight(self) -> Vec<u8> {
        match self {
            Self::Eight(values) => values,
            Self::Sixteen(values) => values
                .into_iter()
                .map(|value| u8::try_from(value).unwrap_or(u8::MAX))
                .collect(),
        }
    }
}

/// As many values as the header's size has pixels.
fn stored(bytes: &[u8], header: &Header) -> Result<Stored, ImageError> {
    match header.format {
        "png" => png_values(bytes, header),
        "pnm" => match pnm(bytes, header)? {
            (1, values) => Ok(values),
            _ => Err(ImageError::Values {
                found: "a pnm image in colour".to_owned(),
            }),
        },
        found => Err(ImageError::Values {
            found: format!("a {found} image"),
        }),
    }
}

fn png_values(bytes: &[u8], header: &Header) -> Result<Stored, ImageError> {
    let damaged = || header.damaged(bytes);
    let pixels = checked_pixels(header.width, header.height)?;
    // What a decoder may need: the filtered rows of the largest image, and as much again for tables.
    let limits = Limits {
        bytes: 4 * pixels + (1 << 20),
    };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::IDENTITY);
    decoder.ignore_checksums(false);
    let mut reader = decoder.read_info().map_err(|_| damaged())?;
    let info = reader.info();
    if (info.width, info.height) != (header.width, header.height) {
        return Err(damaged());
    }
    let (colour, depth) = reader.output_color_type();
    if !matches!(colour, ColorType::Grayscale | ColorType::Indexed) {
        return Err(ImageError::Values {
            found: format!("a png of {colour:?}"),
        });
    }
    let mut data = vec![0; reader.output_buffer_size().ok_or_else(damaged)?];
    reader.next_frame(&mut data).map_err(|_| damaged())?;
    let bits = depth as usize;
    Ok(match bits {
        8 | 16 => Stored::of(bits == 16, data),
        _ => Stored::Eight(unpacked(&data, header.width as usize, bits)),
    })
}

/// Rows of values of 1, 2 or 4 bits, the first in the highest bits; each row begins at a byte.
fn unpacked(data: &[u8], width: usize, bits: usize) -> Vec<u8> {
    let (per_byte, mask) = (8 / bits, (1_u8 << bits) - 1);
    data.chunks(width.div_ceil(per_byte))
        .flat_map(|row| {
            (0..width).map(move |u| {
                let shift = 8 - bits * (u % per_byte + 1);
                (row.get(u / per_byte).copied().unwrap_or(0) >> shift) & mask
            })
        })
        .collect()
}

/// Values a pixel, and the values, of `P5` (grey) and `P6` (red, green, blue): width, height and largest value in
/// decimals, one white space, then the values, big endian.
pub(crate) fn pnm(bytes: &[u8], header: &Header) -> Result<(usize, Stored), ImageError> {
    let damaged = || header.damaged(bytes);
    let (channels, mut rest) = match bytes {
        [b'P', b'5', rest @ ..] => (1, rest),
        [b'P', b'6', rest @ ..] => (3, rest),
        _ => {
            return Err(ImageError::Format {
                found: "a PNM image that is neither P5 nor P6".to_owned(),
            });
        }
    };
    let mut numbers = [0_u32; 3];
    for number in &mut numbers {
        (*number, rest) = pgm_number(rest).ok_or_else(damaged)?;
    }
    let [width, height, most] = numbers;
    if (width, height) != (header.width, header.height) || !(1..=65_535).contains(&most) {
        return Err(damaged());
    }
    let deep = most > 255;
    let values = channels * checked_pixels(width, height)?;
    let length = values * if deep { 2 } else { 1 };
    let data = rest.get(1..=length).ok_or_else(damaged)?;
    Ok((channels, Stored::of(deep, data.to_vec())))
}

/// The next number after white space and comments, and what follows it.
fn pgm_number(mut bytes: &[u8]) -> Option<(u32, &[u8])> {
    loop {
        match bytes.first()? {
            b'#' => {
                let end = bytes.iter().position(|byte| *byte == b'\n')?;
                bytes = &bytes[end..];
            }
            byte if byte.is_ascii_whitespace() => bytes = &bytes[1..],
            _ => break,
        }
    }
    let digits = bytes
        .iter()
        .take_while(|byte| byte.is_ascii_digit())
        .count();
    let (number, rest) = bytes.split_at(digits);
    Some((std::str::from_utf8(number).ok()?.parse().ok()?, rest))
}
