//! Encoded images to grey and to colour.
//!
//! OpenCV decodes straight into our own zeroed buffer. That saves a copy, and it keeps the result a function of the
//! bytes alone: OpenCV's own buffers are not initialised, so a decoder that leaves pixels out would show what the
//! memory held before.

use std::sync::OnceLock;

use imagesize::ImageType;
use opencv::core::{DataType, Mat, MatTraitConst, MatTraitConstManual, Vec3b, set_num_threads};
use opencv::imgcodecs::{IMREAD_COLOR, IMREAD_GRAYSCALE, IMREAD_IGNORE_ORIENTATION, imdecode_to};

use crate::{Grey, ImageError, Rgb};

/// Width and height (px) that the header claims; the rest of the bytes is not looked at.
///
/// # Errors
/// [`ImageError`] for bytes that are no image, or too large a one.
pub fn image_size(bytes: &[u8]) -> Result<[u32; 2], ImageError> {
    let header = header(bytes)?;
    Ok([header.width, header.height])
}

/// Decodes an image (JPEG, PNG, PGM or PPM, by its first bytes) to 8-bit grey, into a buffer that is
/// used again. After an error its contents mean nothing.
///
/// Grey from colour is luma (Rec. 601, which in a JPEG is stored as such); 16 bits become the upper 8; transparency and
/// EXIF orientation are ignored.
///
/// # Errors
/// [`ImageError`] for bytes that are no image, too large an image, or one that is cut off or damaged so that not
/// every row can be read. (A JPEG damaged in the middle may still decode, with some blocks wrong.)
pub fn decode_grey(bytes: &[u8], grey: &mut Grey) -> Result<(), ImageError> {
    let header = header(bytes)?;
    grey.reset(header.width, header.height)?;
    [grey.width, grey.height] =
        decode_onto::<u8>(bytes, &header, IMREAD_GRAYSCALE, &mut grey.data)?;
    Ok(())
}

/// As [`decode_grey`], in colour; grey images have three equal values.
///
/// # Errors
/// As [`decode_grey`].
pub fn decode_colour(bytes: &[u8], rgb: &mut Rgb) -> Result<(), ImageError> {
    let header = header(bytes)?;
    rgb.reset(header.width, header.height)?;
    [rgb.width, rgb.height] = decode_onto::<Vec3b>(bytes, &header, IMREAD_COLOR, &mut rgb.data)?;
    // OpenCV's order is blue, green, red.
    for pixel in rgb.data.chunks_exact_mut(3) {
        pixel.swap(0, 2);
    }
    Ok(())
}

/// Decodes pixels of type `P` into a buffer of the header's size; the width and height of what was decoded.
fn decode_onto<P: DataType>(
    bytes: &[u8],
    header: &Header,
    flags: i32,
    buffer: &mut Vec<u8>,
) -> Result<[u32; 2], ImageError> {
    one_thread()?;
    let (width, height) = (header.width, header.height);
    let damaged = || header.damaged(bytes);
    if header.format == "jpeg" && !ends_like_a_jpeg(bytes) {
        return Err(damaged());
    }
    let source = Mat::from_slice(bytes)?;
    let mut target =
        Mat::new_rows_cols_with_bytes_mut::<P>(height as i32, width as i32, buffer.as_mut_slice())?;
    let own = target.data();
    // The pixels must stay where the calibration says they are, whatever the camera's idea of "up" was.
    let flags = flags | IMREAD_IGNORE_ORIENTATION;
    imdecode_to(&source, flags, &mut target).map_err(|_| damaged())?;
    if target.empty() {
        return Err(damaged());
    }
    if target.data() == own {
        return Ok([width, height]);
    }
    // The decoder saw another size than the header's first look: take what it made.
    let size = [target.cols() as u32, target.rows() as u32];
    let made = target.data_bytes()?.to_vec();
    drop(target);
    *buffer = made;
    Ok(size)
}

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

/// What the first bytes say, checked against [`crate::MAX_PIXELS`] before OpenCV sees them. Images come from logs, so
/// formats whose decoders nobody fuzzes in OpenCV's own build (WebP, BMP, TIFF and others) are refused.
pub(crate) fn header(bytes: &[u8]) -> Result<Header, ImageError> {
    let unknown = |found: String| ImageError::Format { found };
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

/// libjpeg fills what is cut off with grey and only warns; a map must not show that. The end-of-image marker may be
/// followed by padding.
fn ends_like_a_jpeg(bytes: &[u8]) -> bool {
    let end = bytes
        .iter()
        .rposition(|byte| !matches!(byte, 0x00 | 0xff))
        .map_or(0, |last| last + 1);
    bytes[..end].ends_with(&[0xff, 0xd9])
}

fn first_bytes(bytes: &[u8]) -> String {
    match bytes {
        [] => "no bytes".to_owned(),
        _ => format!("bytes that begin {:02x?}", &bytes[..bytes.len().min(4)]),
    }
}

/// Turns OpenCV's own threads off, once per process.
pub(crate) fn one_thread() -> Result<(), ImageError> {
    static SET: OnceLock<Result<(), ImageError>> = OnceLock::new();
    SET.get_or_init(|| Ok(set_num_threads(1)?)).clone()
}
