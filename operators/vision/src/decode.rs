//! Encoded images to grey.
//!
//! OpenCV decodes straight into our own zeroed buffer. That saves a copy, and it keeps the result a function of the
//! bytes alone: OpenCV's own buffers are not initialised, so a decoder that leaves pixels out would show what the
//! memory held before.

use std::sync::OnceLock;

use imagesize::ImageType;
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, set_num_threads};
use opencv::imgcodecs::{
    IMREAD_GRAYSCALE, IMREAD_IGNORE_ORIENTATION, IMREAD_REDUCED_GRAYSCALE_2,
    IMREAD_REDUCED_GRAYSCALE_4, imdecode_to,
};

use crate::{Grey, ImageError};

/// How much smaller an image is decoded. JPEGs are then also decoded faster: the transform itself is done at the
/// smaller size.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Reduction {
    /// As it is.
    #[default]
    Full,
    /// Half as wide and high.
    Half,
    /// A quarter as wide and high.
    Quarter,
}

impl Reduction {
    /// How many times smaller.
    pub fn factor(self) -> u32 {
        match self {
            Self::Full => 1,
            Self::Half => 2,
            Self::Quarter => 4,
        }
    }

    fn flags(self) -> i32 {
        // The pixels must stay where the calibration says they are, whatever the camera's idea of "up" was.
        IMREAD_IGNORE_ORIENTATION
            | match self {
                Self::Full => IMREAD_GRAYSCALE,
                Self::Half => IMREAD_REDUCED_GRAYSCALE_2,
                Self::Quarter => IMREAD_REDUCED_GRAYSCALE_4,
            }
    }
}

/// Decodes encoded images (JPEG, PNG, WebP, BMP, TIFF, PGM and PPM, by their first bytes) to 8-bit grey.
///
/// Colour becomes luma (Rec. 601, which in a JPEG is stored as such); 16 bits become the upper 8; transparency and
/// EXIF orientation are ignored.
#[derive(Debug, Clone, Copy, Default)]
pub struct Decoder {
    reduction: Reduction,
}

impl Decoder {
    /// A decoder at full size.
    pub fn new() -> Self {
        Self::default()
    }

    /// The same, to smaller images.
    #[must_use]
    pub fn reduced(self, reduction: Reduction) -> Self {
        Self { reduction }
    }

    /// Width and height (px) that the header claims; the rest of the bytes is not looked at.
    ///
    /// # Errors
    /// [`ImageError`] for bytes that are no image, or too large a one.
    pub fn size(&self, bytes: &[u8]) -> Result<[u32; 2], ImageError> {
        let (header, factor) = (header(bytes)?, self.reduction.factor());
        Ok([header.width, header.height].map(|side| side.div_ceil(factor)))
    }

    /// The image that `bytes` encode.
    ///
    /// # Errors
    /// As [`Decoder::decode_into`].
    pub fn decode(&self, bytes: &[u8]) -> Result<Grey, ImageError> {
        let mut grey = Grey::default();
        self.decode_into(bytes, &mut grey)?;
        Ok(grey)
    }

    /// Decodes into an image whose buffer is used again. After an error the image's contents mean nothing.
    ///
    /// # Errors
    /// [`ImageError`] for bytes that are no image, too large an image, or one that is cut off or damaged so that not
    /// every row can be read. (A JPEG damaged in the middle may still decode, with some blocks wrong.)
    pub fn decode_into(&self, bytes: &[u8], grey: &mut Grey) -> Result<(), ImageError> {
        one_thread()?;
        let header = header(bytes)?;
        let factor = self.reduction.factor();
        grey.reset(
            header.width.div_ceil(factor),
            header.height.div_ceil(factor),
        )?;
        let damaged = || ImageError::Damaged {
            format: header.format,
            bytes: bytes.len(),
        };
        let (rows, columns) = (grey.height as i32, grey.width as i32);
        if header.format == "jpeg" && !ends_like_a_jpeg(bytes) {
            return Err(damaged());
        }
        let source = Mat::from_slice(bytes)?;
        let mut target = Mat::new_rows_cols_with_data_mut(rows, columns, grey.data.as_mut_slice())?;
        let own = target.data();
        imdecode_to(&source, self.reduction.flags(), &mut target).map_err(|_| damaged())?;
        if target.empty() {
            return Err(damaged());
        }
        if target.data() == own {
            return Ok(());
        }
        // The decoder saw another size than the header's first look: take what it made.
        let (width, height) = (target.cols() as u32, target.rows() as u32);
        let data = target.data_typed::<u8>()?.to_vec();
        drop(target);
        *grey = Grey {
            width,
            height,
            data,
        };
        Ok(())
    }
}

struct Header {
    format: &'static str,
    width: u32,
    height: u32,
}

/// What the first bytes say, checked against [`crate::MAX_PIXELS`] before OpenCV sees them.
fn header(bytes: &[u8]) -> Result<Header, ImageError> {
    let unknown = |found: String| ImageError::Format { found };
    let kind = imagesize::image_type(bytes).map_err(|_| unknown(first_bytes(bytes)))?;
    let format = match kind {
        ImageType::Jpeg => "jpeg",
        ImageType::Png => "png",
        ImageType::Webp => "webp",
        ImageType::Bmp => "bmp",
        ImageType::Tiff => "tiff",
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
